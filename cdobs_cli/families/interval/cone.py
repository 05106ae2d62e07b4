"""Enclosure beyond the orthant: a polyhedral cone of errors that holds every error a box of x(0) can start.

E(s) >= 0 decides for boxes of z(0); boxes of x(0) start in the smaller cone of the columns of [S^+ S^-; S^- S^+].
A cone

    K = {e >= 0 : H e >= 0}

that holds them and what disturbance and noise add, that E(T) maps into itself for every period T of the law, and
into the orthant until then, keeps z, and with it x, between its bounds for ever.
"""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from functools import lru_cache
from typing import Any, Self, TypeVar

from flint import arb

from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.interval.errors import ErrorSystem
from cdobs_cli.families.interval.held import flow, holds_between, holds_under, is_above_0, is_at_least_0, law_ends
from cdobs_cli.families.interval.method import Part, between
from cdobs_cli.families.interval.rays import extreme_rays
from cdobs_cli.families.interval.system import System
from cdobs_cli.records import dataclass

C = TypeVar("C", bound="Cone")
_MOST_STATES = 6
_WIDTH, _LONGER = Fraction(1, 50000), 4  # how closely, and how many times beyond the start, the longest is looked for
_ABOVE = Fraction(1, 10**6)  # how far above the limit of E(s) >= 0 a cone is first looked for


@dataclass(frozen=True)
class Cone(Part):
    """K = {e >= 0 : H e >= 0}, with what shows that the errors in it stay bounded.

    H: shape (rows, 2n). unit: an error u inside K that shrinks within K, omega: weights of a size omega' e that falls
    from sample to sample, also where entries of e are cut; shapes (2n, 1), None where there is none.
    """

    H: ExactMatrix
    unit: ExactMatrix | None = field(default=None, metadata={OPTIONAL: True})
    omega: ExactMatrix | None = field(default=None, metadata={OPTIONAL: True})

    name = "cone"
    rung = "positivity"
    how = "a cone of errors, ball arithmetic"

    @classmethod
    def applies(cls, question: Question) -> bool:
        is_run = question.card.tighten != "hull" and question.plant.n <= _MOST_STATES
        return is_run and System.of(question).limit.proved is not None

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """A cone that encloses the errors, with the weights of its size where they are proved too."""
        return cls._shrinking(cls._enclosing(question), question)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """Looked for from the law's own period on."""
        start = question.law.T_max
        end = search.short(float(start) * _LONGER, 12)
        cone = between(lambda T: cls._enclosing(question.at(T)), start, end, _WIDTH)
        return cls._shrinking(cone, question)

    @classmethod
    def _enclosing(cls, question: Question) -> Self | None:
        from cdobs_cli.families.interval.cone_search import likely_cones

        cones = (cls(question.law, H) for H in likely_cones(System.of(question).errors, question.law))
        return next((cone for cone in cones if cone.prove(question).holds), None)

    @staticmethod
    def _shrinking(cone: C | None, question: Question) -> C | None:
        from cdobs_cli.families.interval.cone_search import with_shrinking

        return None if cone is None else with_shrinking(System.of(question).errors, cone)

    @classmethod
    def above(cls, question: Question) -> Exact | None:
        """The period just above the limit of E(s) >= 0, where a cone is first looked for."""
        limit = System.of(question).limit.proved
        return Exact(decimal_text(limit * (1 + _ABOVE), 12)) if limit else None

    @classmethod
    def stored(cls, question: Question) -> list[Self]:
        """A cone of errors at the law, where E(s) >= 0 does not hold there, and one at the longest period found."""
        ordered = System.of(question).limit.holds_until(question.law.T_max.ball())
        own = None if ordered else cls.propose(question)
        start = cls.above(question) if own is None else question.law.T_max
        longest = None if start is None else cls.longest(question.at(start))
        return [cone for cone in (own, longest) if cone is not None]

    @property
    def rays(self) -> Matrix | None:
        """Columns whose nonnegative combinations are K; None where H is not rational or they are too many."""
        return rays_of(self.H)

    def _prove(self, question: Question) -> Proof:
        return Proof.of(self.encloses(System.of(question).errors))

    def encloses(self, errors: ErrorSystem) -> bool:
        """Whether every error that starts from a box of x(0) is proved to stay in the orthant under the law.

        Source: Efimov2016, Theorem 1
        Deviates: a cone of errors in place of the orthant.
        """
        H = self.H.balls()
        if H.shape[1] != errors.size or self.rays is None:
            return False
        return (
            is_at_least_0(H @ errors.start)
            and self._survives_cuts(errors)
            and self._holds_what_drives(errors)
            and self._stays_in_orthant(errors)
            and self.is_invariant(errors)
        )

    def shrinks(self, errors: ErrorSystem) -> bool:
        """Whether the errors in K are proved to shrink, in proportion to the time between samples, without
        disturbance and noise: with `encloses` they stay bounded for bounded data."""
        return self._shrinks_unit(errors) or self._falls(errors)

    def _shrinks_unit(self, errors: ErrorSystem) -> bool:
        """Whether u and (u - E(s) u)/s = -Phi(s) u are inside K for every period s of the law: then e <= beta u in the
        order of K at one sample gives e <= (1 - rate s) beta u at the next. Cutting e does not keep that order."""
        if errors.cut or self.unit is None or self.unit.shape != (errors.size, 1):
            return False
        u, rows = self.unit.balls(), block([[Matrix.identity(errors.size)], [self.H.balls()]])
        return is_above_0(rows @ u) and holds_under(self.law, lambda s: is_above_0(-(rows @ errors.growth(s) @ u)))

    def _falls(self, errors: ErrorSystem) -> bool:
        """Whether omega > 0 and omega' (g - E(s) g)/s = -omega' Phi(s) g > 0 for each ray g and every period s of the
        law. Cutting e only lowers omega' e."""
        G = self.rays
        if self.omega is None or G is None or self.omega.shape != (errors.size, 1):
            return False
        omega = self.omega.balls()
        return is_above_0(omega) and holds_under(self.law, lambda s: is_above_0(-(omega.T @ errors.growth(s) @ G)))

    def _survives_cuts(self, errors: ErrorSystem) -> bool:
        """Whether K holds its rays with any one entry that the measurement cuts set to 0: by convexity then with
        every entry cut to any share."""
        assert self.rays is not None
        G, H = self.rays.tolist(), self.H.balls()
        without = ([[value * (k != i) for value in row] for k, row in enumerate(G)] for i in errors.cut)
        return all(is_at_least_0(H @ Matrix.from_rows(rows)) for rows in without)

    def _holds_what_drives(self, errors: ErrorSystem) -> bool:
        """Whether exp(M r) b is in K for r in [0, T_max] and every b that disturbance and noise can add together: the
        least h exp(M r) b is reached with each of them at one of its ends."""
        H = self.H.balls()

        def holds(r: arb) -> bool:
            HE, least = H @ flow(errors.M, r), [arb(0)] * H.shape[0]
            for width, ends in errors.driven:
                for k, (one, other) in enumerate((HE @ ends).tolist()):
                    least[k] += width * arb.min(arb(one), arb(other))
            return all(value >= 0 for value in least)

        return not errors.driven or holds_between(holds, Fraction(0), law_ends(self.law)[1])

    def _stays_in_orthant(self, errors: ErrorSystem) -> bool:
        """Whether E(s) g >= 0 for every ray and s in [0, T_max]. Entries that start from 0 or are not pulled down
        cannot be the first to lose their sign: M and what is held of the others push them up."""
        assert self.rays is not None
        G = self.rays.tolist()
        rows = [i for i in errors.pulled_down if any(value != 0 for value in G[i])]
        chosen = Matrix.identity(errors.size)[rows, :]
        return not rows or self._stays_above(chosen, errors, Fraction(0), law_ends(self.law)[1], from_zero=False)

    def is_invariant(self, errors: ErrorSystem) -> bool:
        """Whether H E(s) g >= 0 for every ray and every period s of the law."""
        return self._stays_above(self.H.balls(), errors, *law_ends(self.law), from_zero=True)

    def _stays_above(self, rows: Matrix, errors: ErrorSystem, *ends: Fraction, from_zero: bool) -> bool:
        """Whether h E(s) g >= 0 is proved between the ends for all pairs (h, g), by its value in the middle of a piece
        and its slope on all of it; on a piece that begins at 0 by h g and the slope, and where h g = 0 by the slope
        alone.

            E(s) = E(c) + integral_c^s E'(r) dr,    E'(r) = exp(M r) (M + N1)

        Args:
            from_zero: whether pairs with h g = 0 are asked for.
        """
        assert self.rays is not None
        G = self.rays
        first, drift = (rows @ G).tolist(), (errors.M + errors.N1) @ G
        pairs = [(i, j) for i, row in enumerate(first) for j, value in enumerate(row) if from_zero or value != 0]

        def holds(s: arb) -> bool:
            slope = rows @ flow(errors.M, s) @ drift
            if s.lower() <= 0:
                return all(_stays_from_0(first[i][j], slope[i, j], s) for i, j in pairs)
            middle, radius = rows @ errors.at(arb(s.mid())) @ G, arb(0, s.rad())
            return all(middle[i, j] + radius * slope[i, j] >= 0 for i, j in pairs)

        return holds_between(holds, *ends)


def _stays_from_0(value: Any, slope: arb, s: arb) -> bool:
    """Whether value + r slope >= 0 for r in [0, s], at a value of 0 by the slope alone."""
    return bool(slope >= 0 if value == 0 else value + s.upper() * arb.min(slope, arb(0)) >= 0)


@lru_cache(maxsize=64)
def rays_of(H: ExactMatrix) -> Matrix | None:
    """The extreme rays of {e >= 0 : H e >= 0}; None where H is not rational or they are too many."""
    rows = [[entry.rational for entry in row] for row in H.rows]
    exact = [[value for value in row if value is not None] for row in rows]
    rays = extreme_rays(exact, H.shape[1]) if exact == rows else None
    return Matrix.from_rows(rays).T if rays else None
