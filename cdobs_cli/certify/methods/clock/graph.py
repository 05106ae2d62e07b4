"""The clock-dependent certificate over a timed graph: sensors with periods of their own, a quadratic function for each
node.

An edge from q to r, its guard and its jump e+ = J e tell what a sample may do (J = I where nothing arrives). For edot
in Co{A_v} e, if for P_q piecewise polynomial and continuous on [0, T_q], T_q the longest that the clock runs in q,

    Pdot_q + P_q A_v + A_v' P_q + 2 sigma P_q < 0    on [0, T_q], all corners v,          (flow)
    P_q(tau) - J' P_r(0) J > 0                       on the guard, all corners of J,      (jump)
    P_q(0) > 0,

then V = e'P_q(tau)e falls along every flow and does not rise at samples: every error decays at rate sigma, whichever
way the run takes. P_q(tau) > 0 since a guard is ahead of every clock. In Bernstein form each inequality is a finite
list of matrices.

Source: cdobs, certificates over timed graphs
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Self

from flint import arb

from cdobs_cli.certify.definite import eigenvalue_range, has_positive_pivots
from cdobs_cli.certify.levels import Level
from cdobs_cli.certify.linear import is_linear
from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.clock.certificate import ClockFunction, is_small, largest_states, least_eigenvalue
from cdobs_cli.certify.methods.clock.form import GraphShape, flow_coefficients, in_basis, jump_gap, lyapunov
from cdobs_cli.certify.texts import rate_of, upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.graph import Edge
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import MAX_PHASES

_P_DIGITS = 12
# (d, D, pieces on the longest period of a sensor), coarse to fine, and the unknowns allowed for each, by effort.
_SCHEDULE = ((2, 3, 1), (3, 4, 2), (4, 5, 4), (5, 6, 6))
_LARGEST = ((2000, 0, 0, 0), (2500, 1200, 800, 0), (4000, 4000, 2000, 1000), (6000, 6000, 4000, 3000))


@dataclass(frozen=True)
class ClockGraph(ClockFunction):
    """pieces: of each node between its breaks; P: of one P_q after the other."""

    pieces: list[list[str]]

    name: ClassVar[str] = "clock_graph"
    source: ClassVar[str] = "clock-dependent Lyapunov functions"
    statement: ClassVar[str] = "A clock-dependent e'P_q(tau)e decreases along flows and does not grow at any sample"
    multirate: ClassVar[bool] = True
    by_graph: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        """What the spectral radius decides better is left to it."""
        return question.law.has_sensors and not is_linear(question.inclusion)

    @classmethod
    def shapes(cls, question: Question) -> Iterator[GraphShape]:
        return shapes(question)

    @classmethod
    def guess(cls, question: Question, shape: GraphShape) -> Self | None:
        from cdobs_cli.certify.methods.clock.graph_search import pose

        posed = pose(question, shape, given=True)
        solution = None if posed is None else posed.solve(question)
        if posed is None or solution is None:
            return None
        texts = [[fraction_text(value) for value in row] for row in posed.S]
        P, pieces = [upper_texts(P, _P_DIGITS) for P in solution.P], [list(map(str, one)) for one in shape.pieces_of]
        return cls(question.law, str(shape.d), str(shape.D), pieces, fraction_text(question.rate), texts, P)

    @cached_property
    def shape(self) -> GraphShape:
        return GraphShape(int(self.degree), int(self.elevated), tuple(tuple(map(int, one)) for one in self.pieces))

    def _prove(self, question: Question) -> Proof:
        shape, sigma, P, graph = self.shape, rate_of(self.sigma), self.coefficients, self.law.graph
        if not is_small(question.inclusion) or not _well_posed(shape, self.law):
            return NOTHING
        phases = self._phases(question)
        size = phases[0].base.shape
        if len(P) != shape.count or any(matrix.shape != size for matrix in P):
            return NOTHING
        if not all(_positive(P[start]) for start in shape.starts):
            return NOTHING
        if not all(self._falls_on(edge, phases) for edge in graph.edges):
            return NOTHING
        breaks = [[(self.law.base * Exact(end)).scalar for end in ends] for ends in graph.breaks]
        for slope, value in flow_coefficients(P, shape, shape.lengths(breaks)):
            if not all(_positive(-(slope + lyapunov(value, A, sigma))) for A in phases[0].corners()):
                return NOTHING
        return Proof.of(True, sigma)

    def _phases(self, question: Question) -> list[ErrorMaps[Matrix]]:
        back = self.S.inverse()
        return [in_basis(maps, self.S, back) for maps in question.inclusion.phases_balls]

    def _falls_on(self, edge: Edge, phases: list[ErrorMaps[Matrix]]) -> bool:
        P, new = self.coefficients, self.coefficients[self.shape.starts[edge.target]]
        numbers = self.shape.under(edge, self.law.graph)
        if edge.reading is None:
            return all(_positive(P[number] - new) for number in numbers)
        return all(_positive(jump_gap(new, P[number], J)) for J in phases[edge.reading].jumps() for number in numbers)

    def level(self, question: Question) -> Level | None:
        """V = e'P_q(tau)e never rises, from what it is just after the first sample."""
        if not self.prove(question).holds:
            return None
        n, back = question.plant.n, self.S.inverse()
        reach = largest_states(self._pieces(self.coefficients), self.S, n)
        if reach is None:
            return None
        node, reading = self.law.graph.start
        V = back.T @ self.coefficients[self.shape.starts[node]] @ back
        return Level(tuple(J.T @ V @ J for J in question.inclusion.phases_balls[reading].jumps()), tuple(reach))

    def factor(self, question: Question) -> float | None:
        """factor^2 = lambda_max(J'P_q(0)J) of the first sample over the least eigenvalue of all P_q(tau)."""
        back = self.S.inverse()
        P = [back.T @ one @ back for one in self.coefficients]
        least = least_eigenvalue(self._pieces(P))
        if least is None:
            return None
        node, reading = self.law.graph.start
        first = P[self.shape.starts[node]]
        forms = (J.T @ first @ J for J in question.inclusion.phases_balls[reading].jumps())
        largest = max(eigenvalue_range(form, smallest=False).high for form in forms)
        quotient = arb(largest) / Exact(least).ball()
        return float(quotient.sqrt().upper()) if quotient.is_finite() else None

    def _pieces(self, P: list[Matrix]) -> Iterator[list[Matrix]]:
        d = self.shape.d
        return (P[first : first + d + 1] for first in self.shape.firsts)


def _well_posed(shape: GraphShape, law: SamplingLaw) -> bool:
    """Pieces cover each node, and a guard is ahead of every clock."""
    graph = law.graph
    fits = [len(counts) == len(ends) - 1 for counts, ends in zip(shape.pieces_of, graph.breaks, strict=True)]
    ahead = [max(edge.high for edge in graph.leaving(q)) >= node.length for q, node in enumerate(graph.nodes)]
    least = min((count for counts in shape.pieces_of for count in counts), default=0)
    return all(fits) and all(ahead) and least > 0 and 1 <= shape.d <= shape.D and law.base.sign() == 1


def _positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def shapes(question: Question) -> Iterator[GraphShape]:
    """The schedule of shapes for this question, coarse to fine; none twice."""
    law = question.law
    if not 0 < unit(law) < 1e12 or not is_small(question.inclusion):
        return
    N, seen, breaks = question.inclusion.floats.base.shape[0], set[GraphShape](), law.graph.breaks
    longest = min(max(one.every for one in law.sensors), law.graph.longest * MAX_PHASES)
    for (d, D, pieces), largest in zip(_SCHEDULE, _LARGEST[question.level], strict=True):
        parts = (tuple(max(1, round(pieces * (b - a) / longest)) for a, b in pairwise(ends)) for ends in breaks)
        shape = GraphShape(d, D, tuple(parts))
        if shape.count * N * (N + 1) // 2 > largest:
            return
        if shape not in seen:
            seen.add(shape)
            yield shape


def unit(law: SamplingLaw) -> float:
    """Of time, in a search: the hyperperiod, or the longest time between two samples."""
    return float(law.hyperperiod if law.is_multirate else law.T_max)
