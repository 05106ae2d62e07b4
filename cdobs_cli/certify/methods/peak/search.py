"""The search for a chain: one semidefinite program, cones assembled directly, corners added only where they bind.

Unknowns x = (svec of every P_k,c; mu by lag, piece and column; nu by lag and column, the tail's last) in scaled states,
unit time (T_max = 1) and signals of size 1, so that b^2 is linear in x; for a transient one more, the largest of its
terms. Every block is kept eps above 0, for what rounding takes.
"""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.peak.cones import Rows, Svec
from cdobs_cli.certify.methods.peak.flows import Cut, Flows, coefficients
from cdobs_cli.certify.methods.peak.form import jump_block
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 8


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
    pairs imposed, kept from one program to the next. vertices (V, N): what the error may be just after the first
    sample, where a transient is asked for.
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
    cuts: set[Cut] = field(default_factory=set)
    vertices: Array | None = None

    @cached_property
    def shapes(self) -> list[Shape]:
        return [self.first, *[self.others] * self.lags]

    @cached_property
    def lengths(self) -> list[Array]:
        """Of the pieces, by lag."""
        others = np.array(self.others.lengths(self.T_min, 1.0))
        return [np.array(self.first.lengths(*self.window)), *[others] * self.lags]

    @cached_property
    def _svec(self) -> Svec:
        return Svec(self.maps.base.shape[0])

    @cached_property
    def _starts(self) -> tuple[list[int], list[int], int, int]:
        """Where each lag's P and mu begin, where nu begins, and how many unknowns there are."""
        t, q, p = self._svec.length, int(self.B.shape[1]), int(self.G.shape[1])
        P = list(accumulate((shape.count * t for shape in self.shapes), initial=0))
        mu = list(accumulate((shape.pieces * q for shape in self.shapes), initial=P[-1]))
        return P[:-1], mu[:-1], mu[-1], mu[-1] + (self.lags + 1) * p

    @property
    def _size(self) -> int:
        return self._starts[-1] + (self.vertices is not None)

    def _P(self, lag: int, number: int) -> int:
        return self._starts[0][lag] + number * self._svec.length

    def _mu(self, lag: int, piece: int) -> int:
        return self._starts[1][lag] + piece * int(self.B.shape[1])

    def _nu(self, lag: int) -> int:
        """Of lag 1 .. N, and of the tail as lag N + 1."""
        return self._starts[2] + (lag - 1) * int(self.G.shape[1])

    def least(self, z: Array, rho: float, below: float = np.inf) -> Found | None:
        """The chain of least b^2 for this combination of errors and tail; None where there is none below the given."""
        flows = self._flows
        if not self.cuts:
            self.cuts |= flows.start
        fixed, cost = self._jumps_and_target(z, rho), self._cost(rho)
        for _ in range(_ROUNDS):
            rows = fixed.copy()
            flows.impose(rows, self.cuts)
            x = rows.least(cost)
            if x is None or not cost @ x < below:  # with the cuts so far it is too low, if anything
                return None
            violated = flows.violated(x) - self.cuts
            if not violated:
                return self._found(x, rho)
            self.cuts |= violated
        return None

    @cached_property
    def _flows(self) -> Flows:
        A = np.array(list(self.maps.corners()))
        t, q, (P, mu, *_) = self._svec.length, int(self.B.shape[1]), self._starts
        lags = zip(self.shapes, self.lengths, P, mu, strict=True)
        every = [c for shape, lengths, at, weights in lags for c in coefficients(shape, lengths, at, t, weights, q)]
        return Flows(A, self.B, every, self.eps)

    def _cost(self, rho: float) -> Array:
        """b^2 itself, or the largest term of a transient."""
        if self.vertices is None:
            return self._bound(rho)
        cost = np.zeros(self._size)
        cost[-1] = 1.0
        return cost

    def _bound(self, rho: float) -> Array:
        """M + sum_(k <= N) D_k + sum nu_k."""
        share, last = 1 / (1 - rho * rho), self.lags
        return self._spent(last) + share * (rho * rho * self._fed(last) + self._kicked(last + 1))

    def _spent(self, last: int) -> Array:
        """sum_(k <= last) D_k + sum_(1 <= k <= last) nu_k."""
        total: Array = sum((self._fed(k) for k in range(last + 1)), np.zeros(self._size))
        return sum((self._kicked(k) for k in range(1, last + 1)), total)

    def _fed(self, lag: int) -> Array:
        """D_k."""
        row, start = np.zeros(self._size), self._mu(lag, 0)
        weights = np.repeat(self.lengths[lag], self.B.shape[1])
        row[start : start + len(weights)] = weights
        return row

    def _kicked(self, lag: int) -> Array:
        """sum_j nu_kj."""
        row, start = np.zeros(self._size), self._nu(lag)
        row[start : start + self.G.shape[1]] = 1.0
        return row

    def _transient(self, rows: Rows, rho: float) -> None:
        """t >= x'P_q(0)x + what q intervals spend, at each vertex and q = 0 .. N, and t >= b^2."""
        assert self.vertices is not None
        t, basis = np.zeros(self._size), self._svec.basis
        t[-1] = 1.0
        forms = np.einsum("vi,kij,vj->vk", self.vertices, basis, self.vertices)  # (V, svec)
        rows.add(1, {0: (t - self._bound(rho))[:, None]}, np.zeros(1))
        for q in range(self.lags + 1):
            at, spent = self._P(q, 0), t - self._spent(q)
            for form in np.unique(forms.round(12), axis=0):
                row = spent.copy()
                row[at : at + len(form)] -= form
                rows.add(1, {0: row[:, None]}, np.zeros(1))

    def _jumps_and_target(self, z: Array, rho: float) -> Rows:
        rows, basis, last = Rows(self._size), self._svec.basis, self.lags
        if self.vertices is not None:
            self._transient(rows, rho)
        N, p = self.G.shape
        zero, none = np.zeros((N, N)), np.zeros((p, p))
        wide, narrow = Svec(N + p), self._svec
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

    def _found(self, x: Array, rho: float) -> Found:
        t, q = self._svec.length, self.B.shape[1]
        P, mu, nu, end = self._starts
        matrices = [
            self._svec.matrices(x[start : start + shape.count * t].reshape(-1, t))
            for start, shape in zip(P, self.shapes, strict=True)
        ]
        weights = [
            x[start : start + shape.pieces * q].reshape(shape.pieces, q)
            for start, shape in zip(mu, self.shapes, strict=True)
        ]
        return Found(float(self._cost(rho) @ x), matrices, weights, x[nu:end].reshape(self.lags + 1, self.G.shape[1]))
