"""The search behind clock certificates: cones assembled directly, corners added only where they bind.

In coordinates x = (svec P_0, .., svec P_last, free unknowns, margin) every inequality is a stack of rows; a flow row
block is kron(g, I) + kron(e, Lyapunov operator), so nothing is rebuilt from formulas between periods or corners.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.lmi import Cone, SparseColumns, ask_with_multipliers
from cdobs_cli.certify.methods.clock.form import lyapunov
from cdobs_cli.certify.svec import svec, symmetric_basis, unsvec
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 12
_ALL_AT_ONCE = 4  # so many corners are imposed from the start
_SLACK = 0.1  # of the margin: how far below it a corner that is not imposed may be
_TOLERANCE = 1e-8
Static = tuple[list["Array"], list[float], list[Cone]]


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


class Outline(Protocol):
    """What the flow inequalities ask of a shape."""

    @property
    def d(self) -> int: ...

    @property
    def D(self) -> int: ...

    @property
    def pieces(self) -> int: ...

    @property
    def count(self) -> int: ...

    @property
    def firsts(self) -> list[int]: ...


class FlowSearch(ABC):
    """One clock problem: maps in scaled states and unit time, and the cuts met so far.

    Attributes:
        N: the size of the error; free: how many unknowns there are besides the coefficients and the margin.
        cuts: (coefficient of the flow inequality, corner) pairs imposed; carried from one period to the next.
    """

    N: int
    cuts: set[tuple[int, int]]

    @property
    @abstractmethod
    def outline(self) -> Outline:
        """Where P has coefficients."""

    @property
    @abstractmethod
    def lengths(self) -> list[float]:
        """Of the pieces, in parts of the unit of time."""

    @property
    @abstractmethod
    def free(self) -> int: ...

    @abstractmethod
    def _static(self, jumps: Any) -> Static:
        """Rows, right sides and cones of all that is not flow."""

    @abstractmethod
    def _shaped(self, free: Array) -> Array | None:
        """What is wanted of the free unknowns."""

    @property
    def drain(self) -> Array | None:
        """Z, where Pdot + P A + A' P + 2 sigma P < -Z is asked for."""
        return None

    def _cost(self, size: int) -> Array:
        """What is minimised over the unknowns: minus the margin."""
        cost = np.zeros(size)
        cost[-1] = -1.0
        return cost

    def _exactly(self, P: list[Array]) -> list[Array]:
        """With its equations exact, not to the solver's tolerance."""
        return P

    @cached_property
    def basis(self) -> Array:
        """(t, N, N): the symmetric matrices whose svec are unit vectors."""
        return symmetric_basis(self.N)

    @cached_property
    def operators(self) -> tuple[Array, Array, Any]:
        """g (derivative) and e (value) weights per flow coefficient, and the first P of each one's piece."""
        shape = self.outline
        G = np.array(derivative(shape.d, shape.D), dtype=float)
        E = np.array(elevation(shape.d, shape.D), dtype=float)
        g = np.concatenate([G] * shape.pieces)
        e = np.concatenate([E * h for h in self.lengths])
        first = np.repeat(shape.firsts, shape.D + 1)
        return g, e, first

    def solve(self, maps: ErrorMaps[Array], jumps: Any, sigma: float) -> Solution | None:
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

    def tight(self, maps: ErrorMaps[Array], jumps: Any, sigma: float) -> Solution | None:
        """The largest margin over all corners, of either sign, but for a part of it: cuts are added until the others
        are met. None where the solver gives nothing."""
        flows = self._begin(maps)
        if flows is None:
            return None
        L, static, count = self._lyapunov(flows, sigma), self._static(jumps), len(self.operators[0])
        solution = None  # a step of a climb: what is kept is solved for anew
        for _ in range(_ROUNDS):
            solution = self._ask(L, static, refined=False)
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
        local = np.array([[P[f + k] for k in range(self.outline.d + 1)] for f in first])
        weighted: Array = np.einsum("ck,ckij->cij", e, local)
        return weighted

    def _lyapunov(self, flows: Array, sigma: float) -> Array:
        """(corners, t, t): svec of P A + A' P + 2 sigma P on the svec of P, transposed into rows."""
        images = np.array([[lyapunov(P, A, sigma) for P in self.basis] for A in flows])
        return svec(images).transpose(0, 2, 1)

    def _worst(self, P: list[Array], flows: Array, sigma: float) -> tuple[Array, Array]:
        """For each flow coefficient the largest eigenvalue over all corners, and its corner."""
        g, _, first = self.operators
        local = np.array([[P[f + k] for k in range(self.outline.d + 1)] for f in first])
        slope, value = np.einsum("ck,ckij->cij", g, local), self.values(P)
        products = value[:, None] @ flows[None]
        matrices = slope[:, None] + products + products.transpose(0, 1, 3, 2) + 2 * sigma * value[:, None]
        if self.drain is not None:
            matrices = matrices + np.repeat(self.lengths, self.outline.D + 1)[:, None, None, None] * self.drain
        top = np.linalg.eigvalsh(matrices)[..., -1]
        worst = top.argmax(axis=1)
        return top[np.arange(len(top)), worst], worst

    # Rows of A in b - A x in the cones; columns: coefficients, free unknowns, margin.

    @property
    def _t(self) -> int:
        return self.N * (self.N + 1) // 2

    @property
    def _size(self) -> int:
        return self.outline.count * self._t + self.free + 1

    def _unknown(self, number: int) -> slice:
        return slice(number * self._t, (number + 1) * self._t)

    def _ask(self, L: Array, static: Static, *, refined: bool = True) -> Solution | None:
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
        if self.drain is not None:
            b[len(top) :] -= (np.repeat(self.lengths, self.outline.D + 1)[c][:, None] * svec(self.drain)).reshape(-1)
        flow: Cone = ("psd", self.N)
        cones = [*cones, *[flow] * len(cuts)]
        x, z, _ = ask_with_multipliers(self._cost(size), A, b, cones, _TOLERANCE, 100, refined=refined)
        if not np.all(np.isfinite(x)):
            return None
        P = list(np.einsum("nk,kij->nij", x[: self.outline.count * t].reshape(-1, t), self.basis))
        W = self._shaped(x[self.outline.count * t : -1])
        return Solution(self._exactly(P), W, float(x[-1]), c, v, unsvec(z[len(top) :].reshape(-1, t), self.N))
