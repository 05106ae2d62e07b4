"""The search behind the clock certificate: cones assembled directly, corners added only where they bind.

In coordinates x = (svec P_0, .., svec P_last, W, margin) every inequality is a stack of rows; a flow row block
is kron(g, I) + kron(e, Lyapunov operator), so nothing is rebuilt from formulas between periods or corners.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.lmi import Cone, SparseColumns, ask_with_multipliers
from cdobs_cli.certify.methods.clock.form import (
    Shape,
    erases_the_rest,
    jump_gap,
    kept_states,
    lyapunov,
    mean_block,
    mean_gap,
)
from cdobs_cli.certify.svec import full_basis, svec, symmetric_basis, triangle, unsvec
from cdobs_cli.hybrid import ErrorMaps

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 12
_ALL_AT_ONCE = 4  # so many corners are imposed from the start
_SLACK = 0.1  # of the margin: how far below it a corner that is not imposed may be
_TOLERANCE = 1e-8


@dataclass
class Solution:
    """What a search returns: coefficients, W (or None), the margin over all corners, and of the flow inequalities that
    were imposed the coefficient, the corner, and the multiplier Z (k, N, N)."""

    P: list[Array]
    W: Array | None
    margin: float
    coefficients: Array
    corners: Array
    Z: Array


@dataclass
class Search:
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

    @cached_property
    def basis(self) -> Array:
        """(t, N, N): the symmetric matrices whose svec are unit vectors."""
        return symmetric_basis(self.N)

    @cached_property
    def operators(self) -> tuple[Array, Array, Any]:
        """g (derivative) and e (value) weights per flow coefficient, and the first P of each one's piece."""
        shape = self.shape
        G = np.array(derivative(shape.d, shape.D), dtype=float)
        E = np.array(elevation(shape.d, shape.D), dtype=float)
        lengths = shape.lengths(self.T_min, 1.0)
        g = np.concatenate([G] * shape.pieces)
        e = np.concatenate([E * h for h in lengths])
        first = np.repeat(np.arange(shape.pieces) * shape.d, shape.D + 1)
        return g, e, first

    def solve(self, maps: ErrorMaps[Array], jumps: list[Array], sigma: float) -> Solution | None:
        """The certificate of largest margin met, or None where the relaxation with the cuts has none.

        The margin returned is over all corners; positive means found (in floats)."""
        flows = self._begin(maps)
        if flows is None:
            return None
        L, static, count = self._lyapunov(flows, sigma), self._static(jumps), len(self.operators[0])
        best: Solution | None = None
        for _ in range(_ROUNDS):
            solution = self._ask(L, static)
            if solution is None or solution.margin <= 0:
                return best
            violation, worst = self._worst(solution.P, flows, sigma)
            true_margin = min(solution.margin, float(-violation.max()))
            if best is None or true_margin > best.margin:
                best = replace(solution, margin=true_margin)
            if true_margin > 0.1 * solution.margin:
                return best
            new = {(c, int(worst[c])) for c in range(count) if violation[c] > -0.5 * solution.margin} - self.cuts
            if not new:
                return best
            self.cuts |= new
        return best

    def tight(self, maps: ErrorMaps[Array], jumps: list[Array], sigma: float) -> Solution | None:
        """The largest margin over all corners, of either sign, but for a part of it: cuts are added until the others
        are met. None where the solver gives nothing."""
        flows = self._begin(maps)
        if flows is None:
            return None
        L, static, count = self._lyapunov(flows, sigma), self._static(jumps), len(self.operators[0])
        solution = None
        for _ in range(_ROUNDS):
            solution = self._ask(L, static)
            if solution is None or len(flows) <= _ALL_AT_ONCE:
                break
            violation, worst = self._worst(solution.P, flows, sigma)
            least = solution.margin - _SLACK * abs(solution.margin)
            new = {(c, int(worst[c])) for c in range(count) if -violation[c] < least} - self.cuts
            if not new:
                break
            self.cuts |= new
        return solution

    def _begin(self, maps: ErrorMaps[Array]) -> Array | None:
        """The flow at every corner, the first cuts imposed; None where one is not finite."""
        corners = np.array(list(product(*zip(maps.lower, maps.upper, strict=True))))
        flows = np.array([maps.flow(tuple(v)) for v in corners])
        count = len(self.operators[0])
        if len(corners) <= _ALL_AT_ONCE:
            self.cuts = {(c, v) for c in range(count) for v in range(len(corners))}
        elif not self.cuts:
            self.cuts = {(c, v) for c in range(count) for v in (0, len(corners) - 1)}
        return flows if np.all(np.isfinite(flows)) else None

    def values(self, P: list[Array]) -> Array:
        """h P of every coefficient of the flow inequality, h the length of its piece."""
        _, e, first = self.operators
        local = np.array([[P[f + k] for k in range(self.shape.d + 1)] for f in first])
        weighted: Array = np.einsum("ck,ckij->cij", e, local)
        return weighted

    def _lyapunov(self, flows: Array, sigma: float) -> Array:
        """(corners, t, t): svec of P A + A' P + 2 sigma P on the svec of P, transposed into rows."""
        images = np.array([[lyapunov(P, A, sigma) for P in self.basis] for A in flows])
        return svec(images).transpose(0, 2, 1)

    def _worst(self, P: list[Array], flows: Array, sigma: float) -> tuple[Array, Array]:
        """For each flow coefficient the largest eigenvalue over all corners, and its corner."""
        g, _, first = self.operators
        local = np.array([[P[f + k] for k in range(self.shape.d + 1)] for f in first])
        slope, value = np.einsum("ck,ckij->cij", g, local), self.values(P)
        products = value[:, None] @ flows[None]
        matrices = slope[:, None] + products + products.transpose(0, 1, 3, 2) + 2 * sigma * value[:, None]
        top = np.linalg.eigvalsh(matrices)[..., -1]
        worst = top.argmax(axis=1)
        return top[np.arange(len(top)), worst], worst

    # Rows of A in b - A x in the cones; columns: coefficients, W, margin.

    @property
    def _t(self) -> int:
        return self.N * (self.N + 1) // 2

    @property
    def _free(self) -> int:
        return 0 if self.C is None else self.N * int(self.C[0].shape[0])

    @property
    def _size(self) -> int:
        return self.shape.count * self._t + self._free + 1

    def _unknown(self, number: int) -> slice:
        return slice(number * self._t, (number + 1) * self._t)

    def _static(self, jumps: list[Array]) -> tuple[list[Array], list[float], list[Cone]]:
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

    def _ask(self, L: Array, static: tuple[list[Array], list[float], list[Cone]]) -> Solution | None:
        t, size = self._t, self._size
        g, e, first = self.operators
        cuts = sorted(self.cuts)
        c = np.array([cut[0] for cut in cuts])
        v = np.array([cut[1] for cut in cuts])
        # (cuts, t, d + 1, t): what each P of the piece contributes to each row.
        values = g[c][:, None, :, None] * np.eye(t)[None, :, None, :] + e[c][:, None, :, None] * L[v][:, :, None, :]
        cut, row, which, column = np.nonzero(values)
        rows = cut * t + row
        columns = (first[c][cut] + which) * t + column
        data = values[cut, row, which, column]
        unit = svec(np.eye(self.N))
        diagonal = np.flatnonzero(unit)
        margin_rows = (np.arange(len(cuts))[:, None] * t + diagonal).reshape(-1)
        rows = np.concatenate([rows, margin_rows])
        columns = np.concatenate([columns, np.full(len(margin_rows), size - 1)])
        data = np.concatenate([data, np.ones(len(margin_rows))])
        dense, right, cones = static
        top = np.vstack(dense)
        fixed_rows, fixed_columns = np.nonzero(top)
        rows = np.concatenate([fixed_rows, rows + len(top)])
        columns = np.concatenate([fixed_columns, columns])
        data = np.concatenate([top[fixed_rows, fixed_columns], data])
        height = len(top) + len(cuts) * t
        A = SparseColumns.of(rows, columns, data, (height, size))
        b = np.zeros(height)
        b[: len(right)] = right
        flow: Cone = ("psd", self.N)
        cost = np.zeros(size)
        cost[-1] = -1.0
        x, z, _ = ask_with_multipliers(cost, A, b, [*cones, *[flow] * len(cuts)], _TOLERANCE, 100)
        if not np.all(np.isfinite(x)):
            return None
        P = list(np.einsum("nk,kij->nij", x[: self.shape.count * t].reshape(-1, t), self.basis))
        if self.from_zero:  # the equations hold exactly, not to the solver's tolerance
            P[0] = np.where(self.crossing, 0.0, P[0])
        W = None if self.C is None else x[self.shape.count * t : -1].reshape(self.N, -1)
        return Solution(P, W, float(x[-1]), c, v, unsvec(z[len(top) :].reshape(-1, t), self.N))
