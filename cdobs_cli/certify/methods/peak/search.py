"""The search for a chain: one semidefinite program, cones assembled directly, corners added only where they bind.

Unknowns x = (svec of every P_k,c; mu by lag, piece and column; nu by lag and column, the tail's last) in scaled states,
unit time (T_max = 1) and signals of size 1, so that b^2 is linear in x. Every block is kept eps above 0, for what
rounding takes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, product
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.lmi import Cone, SparseColumns, ask_clarabel
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.peak.form import flow_block, jump_block
from cdobs_cli.hybrid import ErrorMaps

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 8
_ALL_AT_ONCE = 4  # so many corners are imposed from the start
_ITERATIONS = 80


@dataclass(frozen=True)
class Found:
    """b^2 as the solver has it, P by lag and coefficient, mu by lag, piece and column, nu by lag and column."""

    bound_squared: float
    P: list[Array]
    mu: list[Array]
    nu: Array


@dataclass
class Search:
    """One chain: maps in scaled states and unit time, B and G for unit signals.

    first, others: shapes of lag 0 and of the others; T_min and window in unit time. cuts: (flow coefficient, corner)
    pairs imposed, kept from one program to the next.
    """

    maps: ErrorMaps[Array]
    B: Array
    G: Array
    first: Shape
    others: Shape
    lags: int
    T_min: float
    window: tuple[float, float]
    eps: float
    cuts: set[tuple[int, int]] = field(default_factory=set)

    @cached_property
    def shapes(self) -> list[Shape]:
        return [self.first, *[self.others] * self.lags]

    @cached_property
    def lengths(self) -> list[Array]:
        """Of the pieces, by lag."""
        others = np.array(self.others.lengths(self.T_min, 1.0))
        return [np.array(self.first.lengths(*self.window)), *[others] * self.lags]

    @cached_property
    def _svec(self) -> _Svec:
        return _Svec(self.maps.base.shape[0])

    @cached_property
    def _starts(self) -> tuple[list[int], list[int], int, int]:
        """Where each lag's P and mu begin, where nu begins, and how many unknowns there are."""
        t, q, p = self._svec.length, int(self.B.shape[1]), int(self.G.shape[1])
        P = list(accumulate((shape.count * t for shape in self.shapes), initial=0))
        mu = list(accumulate((shape.pieces * q for shape in self.shapes), initial=P[-1]))
        return P[:-1], mu[:-1], mu[-1], mu[-1] + (self.lags + 1) * p

    @property
    def _size(self) -> int:
        return self._starts[-1]

    def _P(self, lag: int, number: int) -> int:
        return self._starts[0][lag] + number * self._svec.length

    def _mu(self, lag: int, piece: int) -> int:
        return self._starts[1][lag] + piece * int(self.B.shape[1])

    def _nu(self, lag: int) -> int:
        """Of lag 1 .. N, and of the tail as lag N + 1."""
        return self._starts[2] + (lag - 1) * int(self.G.shape[1])

    def least(self, z: Array, rho: float) -> Found | None:
        """The chain of least b^2 for this combination of errors and tail; None where there is none."""
        corners = np.array(list(product(*zip(self.maps.lower, self.maps.upper, strict=True))))
        flows = np.array([self.maps.flow(tuple(v)) for v in corners])
        count = len(self._coefficients[0])
        if len(corners) <= _ALL_AT_ONCE:
            self.cuts = {(c, v) for c in range(count) for v in range(len(corners))}
        elif not self.cuts:
            self.cuts = {(c, v) for c in range(count) for v in (0, len(corners) - 1)}
        fixed = self._jumps_and_target(z, rho)
        for _ in range(_ROUNDS):
            x = self._ask(flows, fixed, self._cost(rho))
            if x is None:
                return None
            violated = self._violated(x, flows) - self.cuts
            if not violated:
                return self._found(x, rho)
            self.cuts |= violated
        return None

    @cached_property
    def _coefficients(self) -> tuple[Any, Any, Any, Any, Any]:
        """Of every flow coefficient: derivative and value weights (d + 1,), the first P of its piece, its lag and
        piece."""
        d, D = self.first.d, self.first.D
        G, E = np.array(derivative(d, D), dtype=float), np.array(elevation(d, D), dtype=float)
        g, e, first, lags, pieces = [], [], [], [], []
        for lag, lengths in enumerate(self.lengths):
            for piece, h in enumerate(lengths):
                g.append(G)
                e.append(E * h)
                first += [self._P(lag, piece * d)] * (D + 1)
                lags += [lag] * (D + 1)
                pieces += [piece] * (D + 1)
        return np.concatenate(g), np.concatenate(e), np.array(first), np.array(lags), np.array(pieces)

    def _cost(self, rho: float) -> Array:
        """b^2 = M + sum D_k + sum nu_k."""
        cost, share = np.zeros(self._size), 1 / (1 - rho * rho)
        q, p = self.B.shape[1], self.G.shape[1]
        for lag, lengths in enumerate(self.lengths):
            weights = lengths * (share if lag == self.lags else 1)  # D_N, and rho^2 D_N of M
            cost[self._mu(lag, 0) : self._mu(lag, len(lengths))] = np.repeat(weights, q)
        cost[self._nu(1) :] = np.repeat([*[1.0] * self.lags, share], p)
        return cost

    def _jumps_and_target(self, z: Array, rho: float) -> _Rows:
        rows, basis, last = _Rows(self._size), self._svec.basis, self.lags
        N, p = self.G.shape
        zero, none = np.zeros((N, N)), np.zeros((p, p))
        wide, narrow = _Svec(N + p), self._svec
        for number in range(self.first.jump_from, self.first.count):
            rows.add(N, {self._P(0, number): narrow.of(basis)}, -narrow.of(z @ z.T) - self.eps * narrow.unit)
        weights = wide.diagonal(N)
        for J in self.maps.jumps():
            new = wide.of(np.array([jump_block(P, zero, J, self.G, none) for P in basis]))
            old = wide.of(np.array([jump_block(zero, P, J, self.G, none) for P in basis]))
            for lag in range(1, last + 2):
                share = rho * rho if lag > last else 1.0
                for number in range(self.others.jump_from, self.others.count):
                    parts = {self._P(min(lag, last), number): new * share, self._nu(lag): weights}
                    after = self._P(lag - 1, 0)
                    parts[after] = parts.get(after, 0) + old
                    rows.add(N + p, parts, -self.eps * wide.unit)
        return rows

    def _ask(self, flows: Array, fixed: _Rows, cost: Array) -> Array | None:
        rows, basis = fixed.copy(), self._svec.basis
        N, q = self.B.shape
        zero, none = np.zeros((N, N)), np.zeros((q, q))
        wide = _Svec(N + q)
        slopes = wide.of(np.array([flow_block(P, zero, zero, self.B, none) for P in basis]))
        weights = wide.diagonal(N)
        used = sorted({v for _, v in self.cuts})
        values = {v: wide.of(np.array([flow_block(zero, P, flows[v], self.B, none) for P in basis])) for v in used}
        g, e, first, lags, pieces = self._coefficients
        for c, v in sorted(self.cuts):
            h = self.lengths[lags[c]][pieces[c]]
            local = g[c][:, None, None] * slopes + e[c][:, None, None] * values[v]  # (d + 1, t, rows)
            parts = {first[c]: local.reshape(-1, wide.length)}
            parts[self._mu(lags[c], pieces[c])] = weights * h
            rows.add(N + q, parts, -self.eps * h * wide.unit)
        A, b = rows.columns()
        x, record = ask_clarabel(cost, A, b, rows.cones, 1e-9, _ITERATIONS)
        usable = record.status in ("Solved", "AlmostSolved") and bool(np.all(np.isfinite(x)))
        return x if usable else None

    def _violated(self, x: Array, flows: Array) -> set[tuple[int, int]]:
        """The corners that a guess fails at, the worst of each coefficient."""
        g, e, first, lags, pieces = self._coefficients
        t, (N, q) = self._svec.length, self.B.shape
        violated = set()
        for c in range(len(g)):
            local = self._svec.matrices(x[first[c] : first[c] + len(g[c]) * t].reshape(-1, t))
            slope, value = np.einsum("k,kij->ij", g[c], local), np.einsum("k,kij->ij", e[c], local)
            h = self.lengths[lags[c]][pieces[c]]
            products = value @ flows
            blocks = np.zeros((len(flows), N + q, N + q))
            blocks[:, :N, :N] = -(slope + products + products.transpose(0, 2, 1))
            blocks[:, :N, N:] = -(value @ self.B)
            blocks[:, N:, :N] = blocks[0, :N, N:].T
            mu = self._mu(lags[c], pieces[c])
            blocks[:, N:, N:] = np.diag(x[mu : mu + q] * h)
            least = np.linalg.eigvalsh(blocks)[:, 0]
            if least.min() < self.eps * h / 2:
                violated.add((c, int(least.argmin())))
        return violated

    def _found(self, x: Array, rho: float) -> Found:
        t, q = self._svec.length, self.B.shape[1]
        P, mu, nu, _ = self._starts
        matrices = [
            self._svec.matrices(x[start : start + shape.count * t].reshape(-1, t))
            for start, shape in zip(P, self.shapes, strict=True)
        ]
        weights = [
            x[start : start + shape.pieces * q].reshape(-1, q) for start, shape in zip(mu, self.shapes, strict=True)
        ]
        return Found(float(self._cost(rho) @ x), matrices, weights, x[nu:].reshape(self.lags + 1, -1))


class _Svec:
    """Symmetric matrices of one size as vectors: a triangle by columns, off-diagonals times sqrt 2."""

    def __init__(self, size: int) -> None:
        self.j, self.i = np.tril_indices(size)
        self.scale = np.where(self.i == self.j, 1.0, np.sqrt(2.0))
        self.size, self.length = size, len(self.i)
        self.unit = self.of(np.eye(size))

    def of(self, matrices: Array) -> Array:
        """(.., size, size) to (.., length)."""
        return matrices[..., self.i, self.j] * self.scale

    def matrices(self, vectors: Array) -> Array:
        """(k, length) to (k, size, size)."""
        full = np.zeros((len(vectors), self.size, self.size))
        full[:, self.i, self.j] = full[:, self.j, self.i] = vectors / self.scale
        return full

    def diagonal(self, start: int) -> Array:
        """The vectors of the units of the diagonal from `start` on."""
        return self.of(np.array([np.diag(row) for row in np.eye(self.size)[start:]]).reshape(-1, self.size, self.size))

    @property
    def basis(self) -> Array:
        """The matrices whose vectors are unit vectors."""
        return self.matrices(np.eye(self.length))


class _Rows:
    """Blocks sum_k x_k F_k + F_0 in semidefinite cones, as rows b - A x."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.cones: list[Cone] = []
        self.right: list[Array] = []
        self.entries: list[tuple[Any, Any, Any]] = []
        self.height = 0

    def copy(self) -> _Rows:
        other = _Rows(self.size)
        other.cones, other.right, other.entries = list(self.cones), list(self.right), list(self.entries)
        other.height = self.height
        return other

    def add(self, dimension: int, parts: dict[int, Array], constant: Array) -> None:
        """A block: of the unknowns from each start on what they add, (unknowns, length), and what is there without."""
        for start, coefficients in parts.items():
            k, row = np.nonzero(coefficients)
            self.entries.append((self.height + row, start + k, -coefficients[k, row]))
        self.cones.append(("psd", dimension))
        self.right.append(constant)
        self.height += len(constant)

    def columns(self) -> tuple[SparseColumns, Array]:
        rows, columns, data = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        order = np.lexsort((rows, columns))
        pointers = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=self.size))])
        A = SparseColumns(data[order], rows[order], pointers, (self.height, self.size))
        return A, np.concatenate(self.right)
