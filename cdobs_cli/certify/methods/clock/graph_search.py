"""The search behind the certificate over a timed graph: the flow of `flow_search`, with the jumps of its edges.

Gains are given, or free: K of edges into one node r by W = P_r(0) K, and one gain for edges into several nodes by
W = G K with a free matrix G, of which each of them uses the columns of what it reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cdobs_cli.certify.lmi import Cone
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import basis
from cdobs_cli.certify.methods.clock.flow_search import FlowSearch, Outline, Solution, Static
from cdobs_cli.certify.methods.clock.form import GraphShape, in_basis, jump_block, jump_gap, shared_block
from cdobs_cli.certify.methods.clock.graph import unit
from cdobs_cli.certify.svec import full_basis, svec
from cdobs_cli.graph import Edge, Graph
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import groups

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# Coefficients of the unknowns in a matrix that is to be positive, and its dimension.
Block = tuple[list[tuple[slice, "Array"]], int]


@dataclass(frozen=True)
class FreeGain:
    """A gain that is looked for: of which readings it is, the outputs that its columns are for, and the first of its
    unknowns among the free ones: those of W, then of G where it is shared, by edges into several nodes."""

    readings: tuple[int, ...]
    outputs: tuple[int, ...]
    first: int
    is_shared: bool

    def size(self, N: int) -> int:
        return N * (len(self.outputs) + (N if self.is_shared else 0))

    def columns(self, read: Sequence[int]) -> list[int]:
        """Those of the gain for the outputs that a sample reads."""
        return [self.outputs.index(k) for k in read]


@dataclass
class GraphSearch(FlowSearch):
    """Maps in scaled states and unit time, and the shape of the P_q.

    Attributes:
        breaks: of each node, in that unit. reads: the outputs of each reading.
        C: the output matrix at each of its corners where gains are looked for; None where they are given.
    """

    shape: GraphShape
    N: int
    graph: Graph
    breaks: tuple[tuple[float, ...], ...]
    reads: tuple[tuple[int, ...], ...]
    C: list[Array] | None
    gains: tuple[FreeGain, ...]
    cuts: set[tuple[int, int]] = field(default_factory=set)

    @property
    def outline(self) -> Outline:
        return self.shape

    @property
    def lengths(self) -> list[float]:
        return self.shape.lengths(self.breaks)

    @property
    def free(self) -> int:
        return sum(gain.size(self.N) for gain in self.gains)

    def _shaped(self, free: Array) -> Array | None:
        return free if self.gains else None

    def _static(self, jumps: list[list[Array]]) -> Static:
        """One equation, and all inequalities of samples."""
        rows, right, cones = [self._normal()], [1.0], list[Cone]([("zero", 1)])
        for parts, dimension in self._blocks(jumps):
            rows.append(self._semidefinite(parts, dimension))
            right += [0.0] * (dimension * (dimension + 1) // 2)
            cones.append(("psd", dimension))
        return rows, right, cones

    def _normal(self) -> Array:
        """The mean trace of the P_q(0) is 1."""
        trace = np.zeros((1, self._size))
        for start in self.shape.starts:
            trace[0, self._unknown(start)] = svec(np.eye(self.N)) / len(self.shape.starts)
        return trace

    def _blocks(self, jumps: list[list[Array]]) -> Iterator[Block]:
        """P_q(0) > 0, and the jump inequality of each edge, at every corner of its jump."""
        yield from self._given(jumps) if self.C is None else self._sought(self.C)

    def _given(self, jumps: list[list[Array]]) -> Iterator[Block]:
        """P_q(0), and P_q - J'P_r(0)J over the guards, as coefficients of the unknowns, with their dimension."""
        new = svec(self.basis)
        for number in self.shape.starts:
            yield [(self._unknown(number), new)], self.N
        for edge in self.graph.edges:
            if edge.reading is None:
                yield from self._silent(edge)
                continue
            start, zero = self._unknown(self.shape.starts[edge.target]), np.zeros((self.N, self.N))
            for J in jumps[edge.reading]:
                old = svec(np.array([jump_gap(P, zero, J) for P in self.basis]))
                yield from (([(start, old), (self._unknown(place), new)], self.N) for place in self._places(edge))

    def _silent(self, edge: Edge) -> Iterator[Block]:
        """P_q - P_r(0), where nothing arrives."""
        new, start = svec(self.basis), self._unknown(self.shape.starts[edge.target])
        yield from (([(start, -new), (self._unknown(place), new)], self.N) for place in self._places(edge))

    def _places(self, edge: Edge) -> range:
        return self.shape.under(edge, self.graph)

    def _sought(self, corners: list[Array]) -> Iterator[Block]:
        """The jump inequality of edges whose gain is looked for, at every corner of C."""
        for edge in self.graph.edges:
            if edge.reading is None:
                yield from self._silent(edge)
        for gain in self.gains:
            for reading in gain.readings:
                edge, read = self.graph.into(reading), self.reads[reading]
                start = self._unknown(self.shape.starts[edge.target])
                for C, place in product(corners, self._places(edge)):
                    yield self._block(gain, C[list(read)], read, start, self._unknown(place)), 2 * self.N

    def _block(
        self, gain: FreeGain, C: Array, read: tuple[int, ...], start: slice, end: slice
    ) -> list[tuple[slice, Array]]:
        """Of a sample's own gain [[P_q(0), P_q(0) - W C], [., P]], of a shared one [[G + G' - P_q(0), G - W C],
        [., P]]."""
        N, zero = self.N, np.zeros((self.N, self.N))
        entries = np.zeros((N, len(gain.outputs), N, len(read)))  # of W, in the columns that are read
        for place, column in enumerate(gain.columns(read)):
            entries[np.arange(N), column, np.arange(N), place] = 1.0
        units: Array = entries.reshape(-1, N, len(read))
        W = slice(self._first(gain), self._first(gain) + len(units))
        none = np.zeros((N, len(read)))
        new = svec(np.array([jump_block(zero, none, C, P) for P in self.basis]))
        if not gain.is_shared:
            old = svec(np.array([jump_block(P, none, C, zero) for P in self.basis]))
            moved = svec(np.array([jump_block(zero, unit, C, zero) for unit in units]))
            return [(start, old), (end, new), (W, moved)]
        old = svec(np.array([shared_block(zero, P, none, C, zero) for P in self.basis]))
        moved = svec(np.array([shared_block(zero, zero, unit, C, zero) for unit in units]))
        free = svec(np.array([shared_block(unit, zero, none, C, zero) for unit in full_basis(N, N)]))
        return [(start, old), (end, new), (W, moved), (slice(W.stop, W.stop + N * N), free)]

    def _first(self, gain: FreeGain) -> int:
        return self.shape.count * self._t + gain.first

    def _semidefinite(self, parts: list[tuple[slice, Array]], dimension: int) -> Array:
        """Rows of `sum of parts - margin I` in the cone."""
        rows = np.zeros((dimension * (dimension + 1) // 2, self._size))
        for columns, coefficients in parts:
            rows[:, columns] -= coefficients.T
        rows[:, -1] = svec(np.eye(dimension))
        return rows

    def found(self, solution: Solution) -> list[Array]:
        """Of each reading its K, (N, outputs read). Raises: LinAlgError."""
        assert solution.W is not None
        K: list[Array] = [np.zeros((self.N, len(read))) for read in self.reads]
        for gain in self.gains:
            width = self.N * len(gain.outputs)
            W = solution.W[gain.first : gain.first + width].reshape(self.N, -1)
            G = solution.W[gain.first + width : gain.first + gain.size(self.N)]
            for q in gain.readings:
                own = solution.P[self.shape.starts[self.graph.into(q).target]]
                by = G.reshape(self.N, self.N) if gain.is_shared else own
                K[q] = np.asarray(np.linalg.solve(by, W[:, gain.columns(self.reads[q])]), dtype=float)
        return K


class Posed(NamedTuple):
    """A problem as the search takes it: in the coordinates z, e = S z, and unit time."""

    search: GraphSearch
    maps: ErrorMaps[Array]
    jumps: list[list[Array]]
    S: list[list[Fraction]]

    def solve(self, question: Question) -> Solution | None:
        """The solver's answer at the question's rate; None where it has none of a positive margin."""
        sigma = float(question.rate) * unit(question.law)
        solution = self.search.solve(self.maps, self.jumps, sigma)
        return solution if solution is not None and solution.margin > 0 else None

    def gains(self, solution: Solution) -> list[Array]:
        """Of each reading, in the plant's states; empty where one is not finite."""
        try:
            found = self.search.found(solution)
        except np.linalg.LinAlgError:
            return []
        gains: list[Array] = [np.array(self.S, dtype=float) @ K for K in found]
        return gains if all(np.all(np.isfinite(K)) for K in gains) else []


@dataclass(frozen=True)
class Scaled:
    """The error system in the coordinates z, e = S z, and unit time: its flow, where gains are given the jumps of each
    reading, else C at its corners."""

    S: list[list[Fraction]]
    flow: ErrorMaps[Array]
    jumps: list[list[Array]]
    C: list[Array] | None

    @property
    def change(self) -> Array:
        return np.array(self.S, dtype=float)

    @staticmethod
    def of(question: Question, *, given: bool) -> Scaled | None:
        """None where a map is not finite. given: whether the question's gain is meant, or gains are looked for."""
        law, inclusion = question.law, question.inclusion
        H = unit(law)
        S = basis(inclusion, min(H, float(law.base) * float(max(one.longest for one in law.sensors))))
        change = np.array(S, dtype=float)
        back = np.linalg.inv(change)
        phases = [in_basis(maps, change, back) for maps in inclusion.phases_floats] if given else []
        flow = (phases[0] if given else in_basis(inclusion.floats, change, back)).mapped(lambda A: A * H, lambda J: J)
        jumps = [list(maps.jumps()) for maps in phases]
        finite = (flow.base, *flow.parts, *(J for corners in jumps for J in corners))
        if not all(np.all(np.isfinite(part)) for part in finite):
            return None
        return Scaled(S, flow, jumps, None if given else [C @ change for C in inclusion.view_floats.output_corners()])


def pose(question: Question, shape: GraphShape, *, given: bool) -> Posed | None:
    """None where a map is not finite. given: whether the question's gain is meant, or gains are looked for."""
    scaled = Scaled.of(question, given=given)
    if scaled is None:
        return None
    search = GraphSearch(**fields_of(question.law, shape, scaled))
    search.cuts = question.memory.setdefault((shape, given), set())
    return Posed(search, scaled.flow, scaled.jumps, scaled.S)


def fields_of(law: SamplingLaw, shape: GraphShape, scaled: Scaled) -> dict[str, Any]:
    """Of a search."""
    N, base = scaled.flow.base.shape[0], float(law.base) / unit(law)
    breaks = tuple(tuple(base * float(end) for end in ends) for ends in law.graph.breaks)
    reads, gains = tuple(one.outputs for one in law.readings), () if scaled.C is None else free_gains(law, N)
    return {
        "shape": shape, "N": N, "graph": law.graph, "breaks": breaks, "reads": reads, "C": scaled.C, "gains": gains
    }  # fmt: skip


def in_common(gains: Sequence[Array], law: SamplingLaw) -> Iterator[list[Array]]:
    """Gains of readings made alike where the law has one for several of them: in each column that of the first, of the
    last, and the mean of all that read the output."""
    reads, pick = [one.outputs for one in law.readings], (lambda one: one[0], lambda one: one[-1], _mean)
    for chosen in pick:
        alike = [np.array(K) for K in gains]
        for gain in free_gains(law, len(gains[0])):
            for k in gain.outputs:
                readers = [q for q in gain.readings if k in reads[q]]
                column = chosen([gains[q][:, reads[q].index(k)] for q in readers])
                for q in readers:
                    alike[q][:, reads[q].index(k)] = column
        yield alike


def _mean(columns: list[Array]) -> Array:
    mean: Array = np.mean(columns, axis=0)
    return mean


def free_gains(law: SamplingLaw, N: int) -> tuple[FreeGain, ...]:
    """The gains that the law tells apart."""
    numbers, read = groups(law.readings, law.gains), law.readings
    gains: list[FreeGain] = []
    for number in sorted(set(numbers)):
        own = tuple(q for q, one in enumerate(numbers) if one == number)
        outputs = tuple(sorted({k for q in own for k in read[q].outputs}))
        first = gains[-1].first + gains[-1].size(N) if gains else 0
        targets = {law.graph.into(q).target for q in own}
        gains.append(FreeGain(own, outputs, first, len(targets) > 1))
    return tuple(gains)
