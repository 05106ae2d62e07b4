"""The search for a bound from T_min = 0: one semidefinite program for each sigma tried, the least bound kept.

Unknowns x = (svec of every P_c; mu by piece and column; nu; c) in scaled states, unit time and signals of size 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape, in_basis, jump_gap
from cdobs_cli.certify.methods.peak.cones import Rows, Svec
from cdobs_cli.certify.methods.peak.flows import Cut, Flows, coefficients
from cdobs_cli.certify.methods.peak.form import offset_target_block
from cdobs_cli.certify.methods.peak.sizes import float_signals, signal_sizes, sizes
from cdobs_cli.certify.texts import upper_texts
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.hybrid import ErrorMaps

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 13
_DEGREE, _ELEVATED = 4, 5
_PIECES = (2, 3, 4, 6)  # by effort
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.7)  # of the decay rate, for sigma
_REFINEMENTS = (0, 2, 4, 6)  # further values of sigma, by effort
_ROUNDS = 8
_ROOM = (1e-7, 1e-6, 1e-5)
_SHORT = 1 / 16  # of T_max: a period that stands for those near 0


@dataclass(frozen=True)
class Found:
    """A bound in texts, in the user's units. error: b, as the solver says it."""

    error: float
    shape: Shape
    sigma: float
    P: list[list[list[str]]]
    mu: list[list[str]]
    nu: list[str]


def proposals(question: Question, i: int, S: Array, first: Array | None) -> Iterator[Found]:
    """The least bound met for the error of state i, in the basis S; again with more room where it is not proved.

    Args:
        first: (V, N), what the shifted error may be just after the first sample, where a transient is asked for.
    """
    law, maps = question.law, question.inclusion.floats
    T = float(law.T_max)
    B, G = float_signals(question.inclusion)
    sized = sizes(maps, B, G, sorted({max(float(law.T_min), T * _SHORT), T}))
    if sized is None or not sized.radius < 1:
        return
    back = np.linalg.inv(S)
    # Of what is shifted: what signals do to the coordinates of the basis, of the errors' own size.
    scale = np.abs(back) @ sized.errors
    if first is not None:
        scale = np.maximum(scale, np.abs(first).max(axis=0))
    scale = np.array([2.0 ** round(np.log2(x)) if x > 0 else 1.0 for x in scale])
    change = S * scale
    maps = in_basis(maps, change, np.linalg.inv(change))
    unit_time = maps.mapped(lambda flow: flow * T, lambda J: np.round(J, 9))
    reach = float(np.abs(change[i]).max())
    size = 2.0 ** round(np.log2(reach)) if reach > 0 else 1.0
    m, share = _PIECES[question.level], float(law.T_min) / T
    before = max(1, round(m * share)) if share else 0
    shape = Shape(_DEGREE, _ELEVATED, before, max(1, m - before))
    into = np.linalg.inv(change)
    for eps in _ROOM:
        search = _Search(
            unit_time, into @ B * T, into @ G, change[[i]].T / size, shape, share, eps,
            question.memory.setdefault(("peak from zero", shape), set()), None if first is None else first / scale,
        )  # fmt: skip
        met = _scanned(search, sized.rate * T, question)
        if met is None:
            return
        sigma, x = met
        yield search.written(x, sigma, size, scale, signal_sizes(question.inclusion), T)


def _scanned(search: _Search, rate: float, question: Question) -> tuple[float, Array] | None:
    """sigma, in unit time, and x of the least bound: a grid, then the middles beside the best."""
    tried: dict[float, tuple[float, Array]] = {}

    def ask(sigma: float) -> None:
        sigma = float(decimal_text(sigma, 4))
        x = search.least(sigma) if sigma not in tried else None
        if x is not None:
            tried[sigma] = search.bound(x, sigma), x

    known = question.memory.get("peak sigma")
    for share in _SHARES if known is None else (known / rate / 1.3, known / rate, known / rate * 1.3):
        ask(rate * share)
    if not tried:
        return None
    for _ in range(_REFINEMENTS[question.level]):
        grid = sorted(tried)
        k = min(range(len(grid)), key=lambda k: tried[grid[k]][0])
        below, above = grid[k - 1] if k else grid[k] / 2, grid[k + 1] if k + 1 < len(grid) else grid[k] * 1.3
        wide = below if np.log(grid[k] / below) > np.log(above / grid[k]) else above
        ask(float(np.sqrt(grid[k] * wide)))
    sigma = min(tried, key=lambda sigma: tried[sigma][0])
    question.memory["peak sigma"] = sigma
    return sigma, tried[sigma][1]


@dataclass
class _Search:
    """In scaled coordinates of the basis: B, G for unit signals, z (N, 1) the error looked at over its size."""

    maps: ErrorMaps[Array]
    B: Array
    G: Array
    z: Array
    shape: Shape
    T_min: float
    eps: float
    cuts: set[Cut] = field(default_factory=set)
    first: Array | None = None

    @cached_property
    def g(self) -> Array:
        """(p, 1), of no rows where it is 0."""
        g = self.G.T @ self.z
        return g if np.abs(g).max(initial=0.0) > 1e-12 else g[:0]

    @cached_property
    def lengths(self) -> Array:
        return np.array(self.shape.lengths(self.T_min, 1.0))

    @cached_property
    def _svec(self) -> Svec:
        return Svec(self.maps.base.shape[0])

    @property
    def _q(self) -> int:
        return int(self.B.shape[1] + self.G.shape[1])

    @cached_property
    def _starts(self) -> tuple[int, int, int]:
        """Where mu, nu and c stand."""
        mu = self.shape.count * self._svec.length
        nu = mu + self.shape.pieces * self._q
        return mu, nu, nu + len(self.g)

    @property
    def _size(self) -> int:
        """For a transient one more: the larger of c / (2 sigma) and the start."""
        return self._starts[-1] + 1 + (self.first is not None)

    def bound(self, x: Array, sigma: float) -> float:
        """b^2."""
        return float(self._cost(sigma) @ x)

    def _cost(self, sigma: float) -> Array:
        _, nu, c = self._starts
        cost = np.zeros(self._size)
        cost[nu:c] = 1.0
        if self.first is None:
            cost[c] = 1 / (2 * sigma)
        else:
            cost[-1] = 1.0
        return cost

    def least(self, sigma: float) -> Array | None:
        """The unknowns of least b^2 for this sigma."""
        A = np.array(list(self.maps.corners()))
        into = A @ self.G
        B = np.concatenate([np.broadcast_to(self.B, (len(A), *self.B.shape)), into], axis=2)
        mu, *_ = self._starts
        every = coefficients(self.shape, self.lengths, 0, self._svec.length, mu, self._q)
        flows = Flows(A, B, every, self.eps, sigma)
        if not self.cuts:
            self.cuts |= flows.start
        fixed = self._fixed()
        if self.first is not None:
            self._from_start(fixed, sigma)
        for _ in range(_ROUNDS):
            rows = fixed.copy()
            flows.impose(rows, self.cuts)
            x = rows.least(self._cost(sigma))
            if x is None:
                return None
            violated = flows.violated(x) - self.cuts
            if not violated:
                return x
            self.cuts |= violated
        return None

    def _fixed(self) -> Rows:
        """Target, jump, and c at least what each piece feeds."""
        N, t, basis = len(self.z), self._svec.length, self._svec.basis
        mu, nu, c = self._starts
        rows, J, zero = Rows(self._size), self.maps.jump, np.zeros((N, N))
        wide, none = Svec(N + len(self.g)), np.zeros((len(self.g),) * 2)
        constant = wide.of(offset_target_block(zero, self.z, self.g, none)) - self.eps * wide.unit
        of_P = wide.of(np.array([offset_target_block(P, self.z * 0, self.g, none + self.g @ self.g.T) for P in basis]))
        for number in range(self.shape.count):
            parts = {number * t: of_P}
            if len(self.g):
                parts[nu] = wide.diagonal(N)
            rows.add(wide.size, parts, constant)
        old = self._svec.of(np.array([jump_gap(P, zero, J) for P in basis]))
        new = self._svec.of(np.array([jump_gap(zero, P, J) for P in basis]))
        for number in range(max(self.shape.jump_from, int(self.T_min == 0)), self.shape.count):
            rows.add(N, {0: old, number * t: new}, -self.eps * self._svec.unit)
        if self.T_min == 0:
            self._begin_apart(rows)
        for piece in range(self.shape.pieces):
            fed = {mu + piece * self._q: -np.ones((self._q, 1)), c: np.ones((1, 1))}
            rows.add(1, fed, np.zeros(1))
        return rows

    def _from_start(self, rows: Rows, sigma: float) -> None:
        """The last unknown is at least c / (2 sigma), and x'P(0)x at each vertex."""
        assert self.first is not None
        c, last, one = self._starts[-1], self._size - 1, np.ones((1, 1))
        rows.add(1, {c: -one / (2 * sigma), last: one}, np.zeros(1))
        forms = np.einsum("vi,kij,vj->vk", self.first, self._svec.basis, self.first)
        for form in np.unique(forms.round(12), axis=0):
            rows.add(1, {0: -form[:, None], last: one}, np.zeros(1))

    def _begin_apart(self, rows: Rows) -> None:
        """P(0) = diag(P_11, Q), Q - j'Q j >= eps."""
        crossing = np.flatnonzero(self._crossing[self._svec.i, self._svec.j])
        rows.equate({0: np.eye(self._svec.length)[:, crossing]}, np.zeros(len(crossing)))
        lost = np.flatnonzero(np.logical_not(self._kept))
        if len(lost):
            corner, narrow = self.maps.jump[np.ix_(lost, lost)], Svec(len(lost))
            gaps = [jump_gap(P, P, corner) for P in self._svec.basis[:, lost][:, :, lost]]
            rows.add(len(lost), {0: narrow.of(np.array(gaps))}, -self.eps * narrow.unit)

    @cached_property
    def _kept(self) -> Array:
        identity = np.eye(len(self.z))
        rows = np.abs(self.maps.jump - identity)
        kept: Array = (rows.max(axis=0) == 0) & (rows.max(axis=1) == 0)
        return kept

    @cached_property
    def _crossing(self) -> Array:
        crossing: Array = self._kept[:, None] != self._kept[None, :]
        return crossing

    def written(
        self, x: Array, sigma: float, size: float, scale: Array, signals: tuple[Array, Array], T: float
    ) -> Found:
        """In the user's units: time in T, coordinates in `scale`, the error looked at in `size`."""
        t, (mu, nu, c) = self._svec.length, self._starts
        P = self._svec.matrices(x[:mu].reshape(-1, t))
        if self.T_min == 0:  # the equations hold exactly, not to the solver's tolerance
            P[0] = np.where(self._crossing, 0.0, P[0])
        u0, back = np.concatenate(signals), 1 / scale
        weights = x[mu:nu].reshape(self.shape.pieces, self._q) * size**2 / u0**2 / T
        offsets = x[nu:c] * size**2 / signals[1] ** 2 if len(self.g) else x[nu:c]
        return Found(
            float(np.sqrt(max(self.bound(x, sigma), 0.0))) * size, self.shape, sigma / T,
            [upper_texts(one * size**2 * back * back[:, None], _DIGITS) for one in P],
            [[decimal_text(float(value), _DIGITS) for value in piece] for piece in weights],
            [decimal_text(float(value), _DIGITS) for value in offsets],
        )  # fmt: skip
