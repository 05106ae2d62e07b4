"""Enclosure beyond the orthant: a polyhedral cone of errors that holds every error a box of x(0) can start.

    e = (z - z_lower, z_upper - z),    e(0) = [S^+ S^-; S^- S^+] (x - x_lower, x_upper - x),    e(t_k + s) = E(s) e(t_k) + ..

E(s) >= 0 decides for boxes of z(0); boxes of x(0) start in the smaller cone of the columns of that matrix. A cone

    K = {e >= 0 : H e >= 0}

that holds them and what disturbance and noise add, that E(T) maps into itself for every period T of the law, and
into the orthant until then, keeps z, and with it x, between its bounds for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from flint import arb

from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.held_loop import growth, holds_on, law_ends
from cdobs_cli.families.interval.parts import negative_part, positive_part
from cdobs_cli.families.interval.rays import extreme_rays
from cdobs_cli.families.interval.theorems import Coordinates, error_flow, error_held
from cdobs_cli.sampling import SamplingLaw

_PIECES = 256


def both_sides(M: Any) -> Any:
    """[M^+ M^-; M^- M^+]: distances from both ends of a box of v, as distances of M v from both ends of its box."""
    plus, minus = positive_part(M), negative_part(M)
    return block([[plus, minus], [minus, plus]])


@dataclass(frozen=True)
class ErrorSystem:
    """What the errors of one design obey, in balls.

    M, N1: flow and held part, shapes (2n, 2n); start: columns that generate the errors a box of x(0) starts; driven:
    pairs (width, two columns) of what one disturbance or noise adds to the flow, between its two ends; cut: rows of
    e that the intersection with y may shrink at samples.
    """

    M: Matrix
    N1: Matrix
    start: Matrix
    driven: tuple[tuple[arb, Matrix], ...]
    cut: tuple[int, ...] = ()

    @staticmethod
    def of(z: Coordinates[Matrix], disturbance: Matrix, noise: Matrix, measured: tuple[int, ...] = ()) -> ErrorSystem:
        """Widths of disturbance and noise have shapes (n, 1) and (p, 1); measured: rows of z cut at samples."""
        n = z.S.shape[0]
        start = both_sides(z.S)
        driven = [*_pairs(start, disturbance), *_pairs(both_sides(z.SL), noise)]
        return ErrorSystem(error_flow(z.Q0), error_held(z.Q1), start, tuple(driven), tuple(i + side for side in (0, n) for i in measured))

    @property
    def size(self) -> int:
        return self.M.shape[0]

    @cached_property
    def pulled_down(self) -> tuple[int, ...]:
        """Rows whose own injection may be negative: no other entry of e can be the first to lose its sign."""
        return tuple(i for i in range(self.size) if not arb(self.N1[i, i]) >= 0)

    def growth(self, s: arb) -> Matrix:
        """Phi(s) with E(s) = I + s Phi(s)."""
        return growth(self.M, self.M + self.N1, s)

    def at(self, s: arb) -> Matrix:
        """E(s)."""
        E: Matrix = Matrix.identity(self.size) + self.growth(s) * s
        return E

    def flow(self, s: arb) -> Matrix:
        """exp(M s) for every s of a ball."""
        flow: Matrix = (self.M * s.mid()).exp() @ (self.M * arb(0, s.rad())).exp()
        return flow


def _pairs(columns: Matrix, widths: Matrix) -> list[tuple[arb, Matrix]]:
    count = widths.shape[0]
    return [(arb(widths[k, 0]), columns[:, [k, count + k]]) for k in range(count) if not arb(widths[k, 0]).is_zero()]


@dataclass(frozen=True)
class Cone:
    """K = {e >= 0 : H e >= 0}, with what shows that the errors in it stay bounded.

    H: shape (rows, 2n). unit: an error u inside K that shrinks within K, omega: weights of a size omega' e that falls
    from sample to sample, also where entries of e are cut; shapes (2n, 1), None where there is none.
    """

    H: ExactMatrix
    unit: ExactMatrix | None = None
    omega: ExactMatrix | None = None

    def document(self) -> dict[str, Any]:
        return {name: None if rows is None else rows.texts() for name, rows in (("H", self.H), ("unit", self.unit), ("omega", self.omega))}

    @staticmethod
    def from_document(document: dict[str, Any]) -> Cone:
        """Raises: KeyError, ValueError, TypeError, ExpressionError on what `document` did not write."""
        unit, omega = (None if document[name] is None else ExactMatrix(document[name]) for name in ("unit", "omega"))
        return Cone(ExactMatrix(document["H"]), unit, omega)

    @cached_property
    def rays(self) -> Matrix | None:
        """Columns whose nonnegative combinations are K; None where H is not rational or they are too many."""
        rows = [[entry.rational for entry in row] for row in self.H.rows]
        exact = [[value for value in row if value is not None] for row in rows]
        if not exact or any(len(row) != self.H.shape[1] for row in exact):
            return None
        found = extreme_rays(exact, self.H.shape[1])
        return None if not found else Matrix.from_rows(found).T

    def proves_enclosure(self, errors: ErrorSystem, law: SamplingLaw, effort: int = 1) -> bool:
        """Whether every error that starts from a box of x(0) is proved to stay in the orthant under the law.

        Source: Efimov2016, Theorem 1
        Deviates: a cone of errors in place of the orthant.
        """
        G, H = self.rays, self.H.balls()
        if G is None or H.shape[1] != errors.size:
            return False
        return (
            _all_at_least_0(H @ errors.start)
            and self._survives_cuts(errors, G)
            and _holds_what_drives(H, errors, law, effort)
            and _stays_in_orthant(G, errors, law, effort)
            and _is_invariant(H, G, errors, law, effort)
        )

    def proves_boundedness(self, errors: ErrorSystem, law: SamplingLaw, effort: int = 1) -> bool:
        """Whether the errors in K are proved to shrink, in proportion to the time between samples, without
        disturbance and noise: with `proves_enclosure` they stay bounded for bounded data."""
        return self._shrinks_unit(errors, law, effort) or self._falls(errors, law, effort)

    def _shrinks_unit(self, errors: ErrorSystem, law: SamplingLaw, effort: int) -> bool:
        """Whether u and (u - E(s) u)/s = -Phi(s) u are inside K for every period s of the law: then e <= beta u in the
        order of K at one sample gives e <= (1 - rate s) beta u at the next. Cutting e does not keep that order."""
        if errors.cut or self.unit is None or self.unit.shape != (errors.size, 1):
            return False
        u, rows = self.unit.balls(), block([[Matrix.identity(errors.size)], [self.H.balls()]])
        if not _all_above_0(rows @ u):
            return False
        low, high = law_ends(law)
        return holds_on(lambda s: _all_above_0(-(rows @ errors.growth(s) @ u)), low, high, _PIECES * 2**effort)

    def _falls(self, errors: ErrorSystem, law: SamplingLaw, effort: int) -> bool:
        """Whether omega > 0 and omega' (g - E(s) g)/s = -omega' Phi(s) g > 0 for each ray g and every period s of the
        law. Cutting e only lowers omega' e."""
        if self.omega is None or self.rays is None or self.omega.shape != (errors.size, 1):
            return False
        omega, G = self.omega.balls(), self.rays
        if not _all_above_0(omega):
            return False
        low, high = law_ends(law)
        return holds_on(lambda s: _all_above_0(-(omega.T @ errors.growth(s) @ G)), low, high, _PIECES * 2**effort)

    def _survives_cuts(self, errors: ErrorSystem, G: Matrix) -> bool:
        """Whether K holds its rays with any one entry that the measurement cuts set to 0: by convexity then with
        every entry cut to any share."""
        H = self.H.balls()
        return all(_all_at_least_0(H @ _without(G, i)) for i in errors.cut)


def _without(G: Matrix, i: int) -> Matrix:
    """G with row i set to 0."""
    return Matrix.from_rows([[value * 0 if k == i else value for value in row] for k, row in enumerate(G.tolist())])


def _all_at_least_0(values: Matrix) -> bool:
    return all(arb(value) >= 0 for row in values.tolist() for value in row)


def _all_above_0(values: Matrix) -> bool:
    return all(arb(value) > 0 for row in values.tolist() for value in row)


def _holds_what_drives(H: Matrix, errors: ErrorSystem, law: SamplingLaw, effort: int) -> bool:
    """Whether exp(M r) b is in K for r in [0, T_max] and every b that disturbance and noise can add together: the
    least h exp(M r) b is reached with each of them at one of its ends."""
    if not errors.driven:
        return True
    high = law_ends(law)[1]

    def holds(r: arb) -> bool:
        flow = H @ errors.flow(r)
        least = [arb(0)] * H.shape[0]
        for width, ends in errors.driven:
            for k, (one, other) in enumerate((flow @ ends).tolist()):
                least[k] += width * arb.min(arb(one), arb(other))
        return all(value >= 0 for value in least)

    return holds_on(holds, Fraction(0), high, _PIECES * 2**effort)


def _stays_in_orthant(G: Matrix, errors: ErrorSystem, law: SamplingLaw, effort: int) -> bool:
    """Whether E(s) g >= 0 for every ray and s in [0, T_max]. Entries that start from 0 or are not pulled down
    cannot be the first to lose their sign: M and what is held of the others push them up."""
    rows = [i for i in errors.pulled_down if any(value != 0 for value in G.tolist()[i])]
    if not rows:
        return True
    chosen = Matrix.identity(errors.size)[rows, :]
    return _stays_above(chosen, G, errors, Fraction(0), law_ends(law)[1], effort, from_zero=False)


def _is_invariant(H: Matrix, G: Matrix, errors: ErrorSystem, law: SamplingLaw, effort: int) -> bool:
    """Whether H E(s) g >= 0 for every ray and every period s of the law."""
    return _stays_above(H, G, errors, *law_ends(law), effort, from_zero=True)


def _stays_above(
    rows: Matrix, G: Matrix, errors: ErrorSystem, low: Fraction, high: Fraction, effort: int, *, from_zero: bool
) -> bool:  # fmt: skip
    """Whether h E(s) g >= 0 is proved on [low, high] for all pairs (h, g), by its value in the middle of a piece and its
    slope on all of it; on a piece that begins at 0 by h g and the slope, and where h g = 0 by the slope alone.

        E(s) = E(c) + integral_c^s E'(r) dr,    E'(r) = exp(M r) (M + N1)

    Args:
        from_zero: whether pairs with h g = 0 are asked for.
    """
    first, drift = (rows @ G).tolist(), (errors.M + errors.N1) @ G
    pairs = [(i, j) for i, row in enumerate(first) for j, value in enumerate(row) if from_zero or value != 0]

    def holds(s: arb) -> bool:
        slope = rows @ errors.flow(s) @ drift
        if s.lower() <= 0:
            return all(
                slope[i, j] >= 0 if first[i][j] == 0 else first[i][j] + s.upper() * arb.min(slope[i, j], arb(0)) >= 0 for i, j in pairs
            )
        middle, radius = rows @ errors.at(arb(s.mid())) @ G, arb(0, s.rad())
        return all(middle[i, j] + radius * slope[i, j] >= 0 for i, j in pairs)

    return holds_on(holds, low, high, _PIECES * 2**effort)
