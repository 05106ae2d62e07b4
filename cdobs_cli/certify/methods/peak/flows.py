"""The flow inequality of many functions at many corners, of which few bind: cutting planes."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.peak.cones import Rows, Svec
from cdobs_cli.certify.methods.peak.form import flow_block
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

Cut = tuple[int, int]  # number of a coefficient, number of a corner
_ALL_AT_ONCE = 4  # so many corners are imposed from the start
_MORE = 3  # so many are added to a coefficient at a time


@dataclass(frozen=True)
class Coefficient:
    """One Bernstein coefficient of the flow inequality on a piece of length h.

    g, e: weights (d + 1,) of the derivative and of h times the value; first, mu: where the piece's P and mu begin among
    the unknowns.
    """

    g: Array
    e: Array
    h: float
    first: int
    mu: int


def coefficients(shape: Shape, lengths: Array, P: int, t: int, mu: int, q: int) -> list[Coefficient]:
    """Those of one function whose P and mu begin at these unknowns; t entries a P, q a mu."""
    G, E = np.array(derivative(shape.d, shape.D), dtype=float), np.array(elevation(shape.d, shape.D), dtype=float)
    return [
        Coefficient(g, e * h, float(h), P + piece * shape.d * t, mu + piece * q)
        for piece, h in enumerate(lengths)
        for g, e in zip(G, E, strict=True)
    ]


@dataclass(frozen=True)
class Flows:
    """[[diag(0, mu_s) - (P' + P A + A'P + 2 sigma P), -P B], [., mu_d]] >= eps at every coefficient and corner.

    A (corners, N, N), B (N, q), in unit time; the weights of a piece are (mu_s, mu_d), mu_s those of the last `held` of
    the N states.
    """

    A: Array
    B: Array
    coefficients: list[Coefficient]
    eps: float
    sigma: float = 0.0
    held: int = 0

    @property
    def start(self) -> set[Cut]:
        """All cuts where there are few corners, else those of two corners."""
        corners = range(len(self.A)) if len(self.A) <= _ALL_AT_ONCE else (0, len(self.A) - 1)
        return {(c, v) for c in range(len(self.coefficients)) for v in corners}

    @cached_property
    def _svecs(self) -> tuple[Svec, Svec]:
        N, q = self.B.shape
        return Svec(N), Svec(N + q)

    def impose(self, rows: Rows, cuts: set[Cut]) -> None:
        """The blocks of these cuts."""
        narrow, wide = self._svecs
        N, q = self.B.shape
        zero, none, basis = np.zeros((N, N)), np.zeros((q, q)), narrow.basis
        slopes = wide.of(np.array([flow_block(P, zero, zero, self.B, none) for P in basis]))
        weights = wide.diagonal(N - self.held)
        values = {
            v: wide.of(np.array([flow_block(zero, P, self.A[v], self.B, none, self.sigma) for P in basis]))
            for v in {v for _, v in cuts}
        }
        for number, v in sorted(cuts):
            c = self.coefficients[number]
            local = c.g[:, None, None] * slopes + c.e[:, None, None] * values[v]  # (d + 1, t, rows)
            parts = {c.first: local.reshape(-1, wide.length), c.mu: weights * c.h}
            rows.add(N + q, parts, -self.eps * c.h * wide.unit)

    def violated(self, x: Array) -> set[Cut]:
        """The corners that a guess fails at, the worst ones of each coefficient."""
        narrow, _ = self._svecs
        N, q = self.B.shape
        blocks, violated = np.zeros((len(self.A), N + q, N + q)), set()
        fed = np.arange(N - self.held, N + q)
        for number, c in enumerate(self.coefficients):
            local = narrow.matrices(x[c.first : c.first + len(c.g) * narrow.length].reshape(-1, narrow.length))
            slope, value = np.einsum("k,kij->ij", c.g, local), np.einsum("k,kij->ij", c.e, local)
            products = value @ self.A
            blocks[:, :N, :N] = -(slope + products + products.transpose(0, 2, 1) + 2 * self.sigma * value)
            blocks[:, :N, N:] = -(value @ self.B)
            blocks[:, N:, :N] = blocks[:, :N, N:].transpose(0, 2, 1)
            blocks[:, N:, N:] = 0.0
            blocks[:, fed, fed] += x[c.mu : c.mu + len(fed)] * c.h
            least = np.linalg.eigvalsh(blocks)[:, 0]
            worst = np.argsort(least)[:_MORE]
            violated |= {(number, int(v)) for v in worst if least[v] < self.eps * c.h / 2}
        return violated
