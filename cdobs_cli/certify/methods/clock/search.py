"""The search behind the clock certificate: one function, and the jump to its beginning.

The unknowns besides its coefficients are those of W, where the gain is free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.lmi import Cone
from cdobs_cli.certify.methods.clock.flow_search import FlowSearch, Outline, Solution, Static
from cdobs_cli.certify.methods.clock.form import (
    Shape,
    erases_the_rest,
    jump_gap,
    kept_states,
    mean_block,
    mean_gap,
)
from cdobs_cli.certify.svec import full_basis, svec, triangle
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

__all__ = ["Search", "Solution"]


@dataclass
class Search(FlowSearch):
    """One clock problem: maps in scaled states and unit time (T_max = 1), the shape of P, and the cuts met so far.

    Attributes:
        C: the output matrix where the jump I - K C is free, at each of its corners; None where the jumps are given.
        from_zero: the jump holds from tau = 0: J = diag(I, j), and P(0) is block diagonal alike.
        lost: the probability of a sample to be lost.
        cuts: (coefficient of the flow inequality, corner) pairs imposed; carried from one period to the next.
    """

    shape: Shape
    T_min: float
    N: int
    C: list[Array] | None
    from_zero: bool
    lost: float = 0.0
    cuts: set[tuple[int, int]] = field(default_factory=set)
    crossing: Array = field(init=False, repr=False)

    @property
    def outline(self) -> Outline:
        return self.shape

    @property
    def lengths(self) -> list[float]:
        return self.shape.lengths(self.T_min, 1.0)

    @property
    def free(self) -> int:
        return 0 if self.C is None else self.N * int(self.C[0].shape[0])

    def _exactly(self, P: list[Array]) -> list[Array]:
        return [np.where(self.crossing, 0.0, P[0]), *P[1:]] if self.from_zero else P

    def _shaped(self, free: Array) -> Array | None:
        return None if self.C is None else free.reshape(self.N, -1)

    def _static(self, jumps: list[Array]) -> Static:
        """Trace, block structure of P(0), P(0) on the range of J, and the jump inequality at every corner of J."""
        from cdobs_cli.exact.matrix import Matrix

        rows: list[Array] = []
        right: list[float] = []
        cones: list[Cone] = []
        exact = [Matrix.from_floats(J) for J in jumps]
        kept = kept_states(exact[0]) if self.C is None else []
        erased = len(exact) == 1 and bool(kept) and erases_the_rest(exact[0], kept)
        positive = kept if erased else list(range(self.N))
        trace = np.zeros((1, self._size))
        trace[0, self._unknown(0)] = svec(np.diag([float(i in positive) for i in range(self.N)]))
        rows.append(trace)
        right.append(1.0)
        cones.append(("zero", 1))
        if self.from_zero:
            if any(kept_states(J) != kept for J in exact):  # no block structure serves them all
                kept = []
            lost = [i for i in range(self.N) if i not in kept]
            is_kept = np.isin(np.arange(self.N), kept)
            self.crossing = is_kept[:, None] != is_kept[None, :]
            crossing = np.flatnonzero(self.crossing[triangle(self.N)])
            if len(crossing):
                structure = np.zeros((len(crossing), self._size))
                structure[np.arange(len(crossing)), crossing] = 1.0
                rows.append(structure)
                right.extend([0.0] * len(crossing))
                cones.append(("zero", len(crossing)))
            for J in jumps if lost else ():
                corner = J[np.ix_(lost, lost)]
                gaps = np.array([jump_gap(P, P, corner) for P in self.basis[:, lost][:, :, lost]])
                rows.append(self._semidefinite({0: svec(gaps)}, len(lost)))
                right.extend([0.0] * (len(lost) * (len(lost) + 1) // 2))
                cones.append(("psd", len(lost)))
        if self.C is None:
            rows.append(self._semidefinite({0: svec(self.basis[:, positive][:, :, positive])}, len(positive)))
            right.extend([0.0] * (len(positive) * (len(positive) + 1) // 2))
            cones.append(("psd", len(positive)))
        blocks = list(self._given_jumps(jumps) if self.C is None else self._free_jumps(self.C))
        for number in self.shape.jumps:
            if number == 0 and self.from_zero:
                continue
            for old, new, W, dimension in blocks:
                parts = {0: old + new} if number == 0 else {0: old, number: new}
                parts |= {} if W is None else {-1: W}
                rows.append(self._semidefinite(parts, dimension))
                right.extend([0.0] * (dimension * (dimension + 1) // 2))
                cones.append(("psd", dimension))
        return rows, right, cones

    def _given_jumps(self, jumps: list[Array]) -> Iterator[tuple[Array, Array, Array | None, int]]:
        """P(tau) - J'P(0)J as coefficients of P(0) and of P(tau), and its dimension."""
        zero = np.zeros((self.N, self.N))
        for J in jumps:
            old = svec(np.array([mean_gap(P, zero, J, self.lost) for P in self.basis]))
            new = svec(np.array([mean_gap(zero, P, J, self.lost) for P in self.basis]))
            yield old, new, None, self.N

    def _free_jumps(self, corners: list[Array]) -> Iterator[tuple[Array, Array, Array | None, int]]:
        """[[P(0), P(0) - W C], [., P(tau)]] alike, and of W, one for all corners of C."""
        zero = np.zeros((self.N, self.N))
        for C in corners:
            p = C.shape[0]
            none = np.zeros((self.N, p))
            old = svec(np.array([mean_block(P, none, C, zero, self.lost) for P in self.basis]))
            new = svec(np.array([mean_block(zero, none, C, P, self.lost) for P in self.basis]))
            W = svec(np.array([mean_block(zero, unit, C, zero, self.lost) for unit in full_basis(self.N, p)]))
            yield old, new, W, 2 * self.N

    def _semidefinite(self, parts: dict[int, Array], dimension: int) -> Array:
        """Rows of `sum of parts - margin I` in the cone; key -1 is W."""
        rows = np.zeros((dimension * (dimension + 1) // 2, self._size))
        for number, coefficients in parts.items():
            columns = slice(self.shape.count * self._t, self._size - 1) if number == -1 else self._unknown(number)
            rows[:, columns] -= coefficients.T
        rows[:, -1] = svec(np.eye(dimension))
        return rows
