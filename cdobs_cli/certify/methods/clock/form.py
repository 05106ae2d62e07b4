"""The inequalities of the clock certificate, each one pure function, and the piecewise polynomial they are about."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, TypeVar

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.graph import Edge, Graph
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass

M_ = TypeVar("M_")


def lyapunov(P: Any, A: Any, sigma: Any) -> Any:
    """P A + A' P + 2 sigma P."""
    return P @ A + A.T @ P + P * (2 * sigma)


def jump_gap(P_0: Any, P: Any, J: Any) -> Any:
    """P - J' P(0) J."""
    return P - J.T @ P_0 @ J


def mean_gap(P_0: Any, P: Any, J: Any, p: Any) -> Any:
    """P - (1 - p) J' P(0) J - p P(0): where the sample is lost with probability p."""
    return P - J.T @ P_0 @ J * (1 - p) - P_0 * p


def jump_block(P_0: Any, W: Any, C: Any, P: Any) -> Any:
    """[[P(0), P(0) - W C], [., P]] with W = P(0) K: definite exactly where `jump_gap` is, for J = I - K C."""
    B = P_0 - W @ C
    return block([[P_0, B], [B.T, P]])


def mean_block(P_0: Any, W: Any, C: Any, P: Any, p: float) -> Any:
    """[[P(0), r (P(0) - W C)], [., P - p P(0)]], r^2 = 1 - p: definite exactly where `mean_gap` is."""
    B = (P_0 - W @ C) * (1 - p) ** 0.5
    return block([[P_0, B], [B.T, P - P_0 * p]])


def shared_block(G: Any, P_0: Any, W: Any, C: Any, P: Any) -> Any:
    """[[G + G' - P(0), G - W C], [., P]] with W = G K: where it is definite, so is `jump_gap` for J = I - K C, since
    G + G' - P(0) <= G P(0)^-1 G'. One G serves jumps to several P(0)."""
    B = G - W @ C
    return block([[G + G.T - P_0, B], [B.T, P]])


@dataclass(frozen=True)
class Shape:
    """Degree d of P, degree D of the inequalities, and pieces: so many on [0, T_min], so many on [T_min, T_max];
    points: at how many multiples of T_min the jump may come, 0 where anywhere in [T_min, T_max].

    Coefficients are numbered through: piece j has those from j d to (j + 1) d, ends shared."""

    d: int
    D: int
    before: int
    after: int
    points: int = 0

    @property
    def pieces(self) -> int:
        return self.before + self.after

    @property
    def count(self) -> int:
        """Number of coefficient matrices."""
        return self.pieces * self.d + 1

    @property
    def firsts(self) -> list[int]:
        """Number of the first coefficient of each piece."""
        return [j * self.d for j in range(self.pieces)]

    @property
    def jump_from(self) -> int:
        """Number of the first coefficient on which the jump is imposed."""
        return self.d * self.before

    @property
    def jumps(self) -> list[int]:
        """Numbers of the coefficients on which the jump is imposed: those at the points, or all from T_min on."""
        multiples = [self.jump_from * k for k in range(1, self.points + 1)]
        return multiples or list(range(self.jump_from, self.count))

    def lengths(self, T_min: Any, T_max: Any) -> list[Any]:
        """Length of each piece."""
        first = [T_min / self.before] * self.before if self.before else []
        return first + ([(T_max - T_min) / self.after] * self.after if self.after else [])


@dataclass(frozen=True)
class GraphShape:
    """Degree d of each P_q, degree D of the inequalities, and of each node the pieces between its breaks (0, the ends
    of guards, its length).

    Coefficients are numbered through, node by node: those of two nodes are apart."""

    d: int
    D: int
    pieces_of: tuple[tuple[int, ...], ...]

    @property
    def pieces(self) -> int:
        return sum(map(sum, self.pieces_of))

    @property
    def count(self) -> int:
        """Number of coefficient matrices."""
        return self.pieces * self.d + len(self.pieces_of)

    @cached_property
    def starts(self) -> list[int]:
        """Of each node the number of P_q(0)."""
        totals = list(accumulate(map(sum, self.pieces_of), initial=0))
        return [pieces * self.d + q for q, pieces in enumerate(totals[:-1])]

    @cached_property
    def firsts(self) -> list[int]:
        """Number of the first coefficient of each piece."""
        places = zip(self.starts, self.pieces_of, strict=True)
        return [start + j * self.d for start, counts in places for j in range(sum(counts))]

    def lengths(self, breaks: Sequence[Sequence[Any]]) -> list[Any]:
        """Length of each piece, of nodes with these breaks."""
        return [
            (high - low) / count
            for ends, counts in zip(breaks, self.pieces_of, strict=True)
            for (low, high), count in zip(pairwise(ends), counts, strict=True)
            for _ in range(count)
        ]

    def under(self, edge: Edge, graph: Graph) -> range:
        """Numbers of the coefficients that an edge's inequality is asked of: all over its guard."""
        breaks, counts = graph.breaks[edge.source], self.pieces_of[edge.source]
        first, last = (
            self.starts[edge.source] + self.d * sum(counts[: breaks.index(end)]) for end in (edge.low, edge.high)
        )
        return range(first, last + 1)


def flow_coefficients(P: list[Any], shape: Shape | GraphShape, lengths: list[Any]) -> Iterator[tuple[Any, Any]]:
    """(h Pdot, h P) of every Bernstein coefficient of the flow inequality, piece by piece, h the piece's length."""
    G, E = derivative(shape.d, shape.D), elevation(shape.d, shape.D)
    for first, h in zip(shape.firsts, lengths, strict=True):
        local = P[first : first + shape.d + 1]
        for g, e in zip(G, E, strict=True):
            yield combination(g, local), combination(e, local) * h


def combination(weights: tuple[Fraction, ...], matrices: list[Any]) -> Any:
    """sum_k weights_k matrices_k."""
    terms = [matrix * weight for weight, matrix in zip(weights, matrices, strict=True) if weight]
    total = terms[0] if terms else matrices[0] * 0
    for term in terms[1:]:
        total = total + term
    return total


def kept_states(J: Matrix) -> list[int]:
    """The states that J keeps and does not couple with others: rows and columns of the identity, exactly so."""
    rows, N = J.tolist(), J.shape[0]
    # `==` is certain for balls, `!=` is not its opposite.
    return [i for i in range(N) if all(rows[i][j] == int(i == j) and rows[j][i] == int(i == j) for j in range(N))]


def erases_the_rest(J: Matrix, kept: list[int]) -> bool:
    """Whether J is 0, exactly so, on the states that are not kept."""
    rows = J.tolist()
    lost = [i for i in range(J.shape[0]) if i not in kept]
    return all(rows[i][j] == 0 for i in lost for j in lost)


def in_basis(maps: ErrorMaps[M_], S: M_, inverse: M_) -> ErrorMaps[M_]:
    """The maps of z, with e = S z."""
    left: Any = inverse

    def similar(M: M_) -> M_:
        return left @ M @ S  # type: ignore[no-any-return]

    return maps.mapped(similar, similar)
