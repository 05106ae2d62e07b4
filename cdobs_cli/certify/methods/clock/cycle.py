"""The clock-dependent certificate over a cycle: sensors with periods of their own, a quadratic function for each sample
of their common pattern.

Sample q comes with its own jump e+ = J_q e, and the next one g_q later. For edot in Co{A_v} e, if for P_q piecewise
polynomial and continuous on [0, g_q], q = 0 .. Q - 1 (and q + 1 = 0 after the last),

    Pdot_q + P_q A_v + A_v' P_q + 2 sigma P_q < 0    on [0, g_q], all corners v,          (flow)
    P_q(g_q) - J_(q+1)' P_(q+1)(0) J_(q+1) > 0       all corners of J,                    (jump)
    P_q(0) > 0,

then V = e'P_q(tau)e falls along every flow and does not rise at samples: every error decays at rate sigma.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

from flint import arb

from cdobs_cli.certify.definite import eigenvalue_range, has_positive_pivots
from cdobs_cli.certify.levels import Level
from cdobs_cli.certify.linear import is_linear
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.clock.certificate import is_small, largest_states, least_eigenvalue
from cdobs_cli.certify.methods.clock.form import CycleShape, flow_coefficients, in_basis, jump_gap, lyapunov
from cdobs_cli.certify.texts import rate_of, rationals, symmetric_from_upper, upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import hyperperiod

_P_DIGITS = 12
# (d, D, pieces on the longest period of a sensor), coarse to fine, and the unknowns allowed for each, by effort.
_SCHEDULE = ((2, 3, 1), (3, 4, 2), (4, 5, 4), (5, 6, 6))
_LARGEST = ((2000, 0, 0, 0), (2500, 1200, 800, 0), (4000, 4000, 2000, 1000), (6000, 6000, 4000, 3000))


@dataclass(frozen=True)
class ClockCycle(Method):
    """degree d of the P_q and elevated degree D of the inequalities; pieces of each; sigma; basis: S in e = S z;
    P: the upper triangles of the Bernstein coefficients of z'P_q(tau)z, one P_q after the other."""

    degree: str
    elevated: str
    pieces: list[str]
    sigma: str
    basis: list[list[str]]
    P: list[list[list[str]]]

    name: ClassVar[str] = "clock_cycle"
    rung: ClassVar[str] = "clock"
    source: ClassVar[str] = "clock-dependent Lyapunov functions"
    how: ClassVar[str] = "exact Bernstein coefficients"
    statement: ClassVar[str] = "A clock-dependent e'P_q(tau)e decreases along flows and does not grow at any sample"
    nonlinear_outputs: ClassVar[bool] = True
    multirate: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        """What the spectral radius decides better is left to it."""
        return question.law.is_multirate and not is_linear(question.inclusion)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """Of the first shape of the schedule, up to the effort, that gives one."""
        if not cls.applies(question):
            return None
        for shape in shapes(question):
            proposal = cls.guess(question, shape)
            if proposal is not None and proposal.prove(question).holds:
                return proposal
        return None

    @classmethod
    def guess(cls, question: Question, shape: CycleShape) -> Self | None:
        """What the solver proposes for this gain and shape: not proved."""
        from cdobs_cli.certify.methods.clock.cycle_search import pose

        posed = pose(question, shape, given=True)
        solution = None if posed is None else posed.solve(question)
        if posed is None or solution is None:
            return None
        texts = [[fraction_text(value) for value in row] for row in posed.S]
        P, pieces = [upper_texts(P, _P_DIGITS) for P in solution.P], [str(count) for count in shape.pieces_of]
        return cls(question.law, str(shape.d), str(shape.D), pieces, fraction_text(question.rate), texts, P)

    @cached_property
    def shape(self) -> CycleShape:
        return CycleShape(int(self.degree), int(self.elevated), tuple(map(int, self.pieces)))

    @cached_property
    def S(self) -> Matrix:
        return rationals(self.basis)

    @cached_property
    def coefficients(self) -> list[Matrix]:
        return [symmetric_from_upper(rows) for rows in self.P]

    def _prove(self, question: Question) -> Proof:
        shape, sigma, P = self.shape, rate_of(self.sigma), self.coefficients
        if not is_small(question.inclusion) or not _well_posed(shape, self.law):
            return NOTHING
        phases = self._phases(question)
        size = phases[0].base.shape
        if len(P) != shape.count or any(matrix.shape != size for matrix in P):
            return NOTHING
        if not all(_positive(P[start]) for start in shape.starts) or not self._falls_at_samples(phases):
            return NOTHING
        lengths = shape.lengths([gap.scalar for gap in self.law.gaps])
        for slope, value in flow_coefficients(P, shape, lengths):
            if not all(_positive(-(slope + lyapunov(value, A, sigma))) for A in phases[0].corners()):
                return NOTHING
        return Proof.of(True, sigma)

    def _phases(self, question: Question) -> list[ErrorMaps[Matrix]]:
        back = self.S.inverse()
        return [in_basis(maps, self.S, back) for maps in question.inclusion.phases_balls]

    def _falls_at_samples(self, phases: list[ErrorMaps[Matrix]]) -> bool:
        P, starts, ends = self.coefficients, self.shape.starts, self.shape.ends
        return all(
            _positive(jump_gap(P[starts[q]], P[ends[q - 1]], J))
            for q, maps in enumerate(phases)
            for J in maps.jumps()
        )  # fmt: skip

    def level(self, question: Question) -> Level | None:
        """V = e'P_q(tau)e never rises, from what it is just after the first sample."""
        if not self.prove(question).holds:
            return None
        n, back = question.plant.n, self.S.inverse()
        reach = largest_states(self._pieces(self.coefficients), self.S, n)
        if reach is None:
            return None
        V = back.T @ self.coefficients[0] @ back
        return Level(tuple(J.T @ V @ J for J in question.inclusion.phases_balls[0].jumps()), tuple(reach))

    def factor(self, question: Question) -> float | None:
        """factor^2 = lambda_max(J_0'P_0(0)J_0) over the least eigenvalue of all P_q(tau)."""
        back = self.S.inverse()
        P = [back.T @ one @ back for one in self.coefficients]
        least = least_eigenvalue(self._pieces(P))
        if least is None:
            return None
        forms = (J.T @ P[0] @ J for J in question.inclusion.phases_balls[0].jumps())
        largest = max(eigenvalue_range(form, smallest=False).high for form in forms)
        quotient = arb(largest) / Exact(least).ball()
        return float(quotient.sqrt().upper()) if quotient.is_finite() else None

    def _pieces(self, P: list[Matrix]) -> Iterator[list[Matrix]]:
        d = self.shape.d
        return (P[first : first + d + 1] for first in self.shape.firsts)


def _well_posed(shape: CycleShape, law: SamplingLaw) -> bool:
    """Pieces cover the time after each sample."""
    fits = len(shape.pieces_of) == len(law.phases) > 0 and min(shape.pieces_of) > 0
    return fits and 1 <= shape.d <= shape.D and law.T_min.sign() == 1


def _positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def shapes(question: Question) -> Iterator[CycleShape]:
    """The schedule of shapes for this question, coarse to fine; none twice."""
    law = question.law
    if not 0 < float(hyperperiod(law.sensors)) * float(law.base) < 1e12 or not is_small(question.inclusion):
        return
    N, seen = question.inclusion.floats.base.shape[0], set[CycleShape]()
    longest = max(one.every for one in law.sensors)
    for (d, D, pieces), largest in zip(_SCHEDULE, _LARGEST[question.level], strict=True):
        shape = CycleShape(d, D, tuple(max(1, round(pieces * phase.gap / longest)) for phase in law.phases))
        if shape.count * N * (N + 1) // 2 > largest:
            return
        if shape not in seen:
            seen.add(shape)
            yield shape
