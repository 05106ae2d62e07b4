"""The search for a bound from T_min = 0: one semidefinite program for each sigma tried, the least bound kept.

Unknowns x = (svec of every P_c; mu by piece; nu; c) in scaled states, unit time and signals of size 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape, jump_gap
from cdobs_cli.certify.methods.peak.cones import Rows, Svec
from cdobs_cli.certify.methods.peak.flows import Cut, Flows, coefficients
from cdobs_cli.certify.methods.peak.form import target_block
from cdobs_cli.certify.methods.peak.sizes import float_signals, sizes
from cdobs_cli.certify.methods.peak.split import Split
from cdobs_cli.certify.texts import upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 13
_DEGREE, _ELEVATED = 4, 5
_PIECES = (2, 3, 4, 6)  # by effort
_SHARE, _LESS = 0.35, 0.4  # of the decay rate: the first sigma; of it, the next where there is none
_SOLVES = (1, 3, 5, 8)  # values of sigma, by effort; two more where nothing is known of it
_CURVATURE = 0.35  # of ln b^2 over u near its least
_STEP = 1.5  # of u
_DIFFERENCE = 1e-4  # of sigma: the rows are nearly linear in it
_ENOUGH = 1e-3  # of b^2: what is left to gain
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


def proposals(question: Question, i: int, split: Split, first: list[Matrix]) -> Iterator[Found]:
    """The least bound met for the error of state i; again with more room where it is not proved.

    Args:
        first: what the shifted error may be just after the first sample, where a transient is asked for; else empty.
    """
    law, S, T = question.law, split.S.floats, float(question.law.T_max)
    B, G = float_signals(question.inclusion)
    sized = sizes(question.inclusion.floats, B, G, sorted({max(float(law.T_min), T * _SHORT), T}))
    if sized is None or not sized.radius < 1:
        return
    # Of what is shifted: what signals do to the coordinates of the basis, of the errors' own size.
    scale = np.abs(np.linalg.inv(S)) @ sized.errors
    vertices = np.array([x.floats[:, 0] for x in first]) if first else None
    if vertices is not None:
        scale = np.maximum(scale, np.abs(vertices[:, : split.N]).max(axis=0))
    scale = np.array([2.0 ** round(np.log2(x)) if x > 0 else 1.0 for x in scale])
    s0, d0 = (np.array([_float(size) for size in sizes]) for sizes in (split.s0, split.d0))
    change, m = np.concatenate([scale, s0]), len(s0)
    maps = split.maps
    unit_time = ErrorMaps(
        maps.base.floats * change / change[:, None] * T,
        tuple(part.floats * change / change[:, None] * T for part in maps.parts),
        tuple(map(_float, maps.lower)), tuple(map(_float, maps.upper)), maps.jump.floats * change / change[:, None],
    )  # fmt: skip
    B, z = split.B.floats * d0 / change[:, None] * T, split.target(i).floats * change[:, None]
    reach = float(np.abs(z).max())
    size = 2.0 ** round(np.log2(reach)) if reach > 0 else 1.0
    pieces, share = _PIECES[question.level], float(law.T_min) / T
    before = max(1, round(pieces * share)) if share else 0
    shape = Shape(_DEGREE, _ELEVATED, before, max(1, pieces - before))
    for eps in _ROOM:
        cuts = question.memory.setdefault(("peak from zero", shape), set())
        started = None if vertices is None else vertices / change
        search = _Search(unit_time, B, z / size, m, shape, share, eps, cuts, started)
        met = _scanned(search, sized.rate * T, question)
        if met is None:
            return
        sigma, x = met
        yield search.written(x, sigma, size, scale, (s0, d0), T)


def _float(value: Any) -> float:
    return float(arb(value).mid())


def _scanned(search: _Search, rate: float, question: Question) -> tuple[float, Array] | None:
    """sigma, in unit time, and x of the least bound, which has one valley: from the sigma of another state where one is
    known, down by its slope."""
    known = question.memory.get("peak sigma")
    tried: dict[float, _Least] = {}
    sigma = rate * _SHARE if known is None else known
    for _ in range(_SOLVES[question.level] + (2 if known is None else 0)):
        sigma = float(decimal_text(sigma, 4))
        if sigma in tried:
            break
        least = search.least(sigma)
        if least is not None:
            tried[sigma] = least
        elif tried:  # beyond what decays
            sigma = (sigma + min(tried, key=lambda one: tried[one].bound)) / 2
            continue
        sigma = _downhill(tried, rate) if tried else sigma * _LESS
        if not sigma > 0:
            break
    if not tried:
        return None
    sigma = min(tried, key=lambda one: tried[one].bound)
    question.memory["peak sigma"] = _downhill(tried, rate) or sigma
    return sigma, tried[sigma].x


def _downhill(tried: dict[float, _Least], rate: float) -> float:
    """Where the slope is 0, by the two values nearest to there, or by a usual curvature; 0 where little is left to
    gain. b^2 falls as 1 / sigma from 0 and is infinite at the rate: looked at over u = ln(sigma / (rate - sigma))."""

    def u(sigma: float) -> float:
        return float(np.log(sigma / max(rate - sigma, 1e-3 * rate)))

    def slope(sigma: float) -> float:
        return float(np.clip(tried[sigma].slope, -1, 1)) * max(1 - sigma / rate, 1e-3)

    best = min(tried, key=lambda one: tried[one].bound)
    beyond = [one for one in tried if (one - best) * slope(best) < 0]
    beside = beyond or [one for one in tried if one != best]
    curvature = _CURVATURE
    if beside:
        other = min(beside, key=lambda one: abs(one - best))
        curvature = max((slope(other) - slope(best)) / (u(other) - u(best)), _CURVATURE / 8)
    if slope(best) ** 2 / (2 * curvature) < _ENOUGH:
        return 0.0
    return rate / (1 + float(np.exp(-u(best) + np.clip(slope(best) / curvature, -_STEP, _STEP))))


@dataclass(frozen=True)
class _Least:
    """The unknowns of least b^2 for one sigma, b^2, and d ln b^2 / d ln sigma."""

    x: Array
    bound: float
    slope: float


@dataclass
class _Search:
    """In scaled coordinates (x, s), s of size 1: maps (N + m), B (N + m, q) for unit signals, z the error looked at
    over its size; m of the states are s. first (V, N + m): vertices of the start of a transient."""

    maps: ErrorMaps[Array]
    B: Array
    z: Array
    m: int
    shape: Shape
    T_min: float
    eps: float
    cuts: set[Cut] = field(default_factory=set)
    first: Array | None = None

    @cached_property
    def lengths(self) -> Array:
        return np.array(self.shape.lengths(self.T_min, 1.0))

    @cached_property
    def _svec(self) -> Svec:
        return Svec(len(self.z))

    @property
    def _q(self) -> int:
        """Weights of a piece."""
        return int(self.B.shape[1]) + self.m

    @cached_property
    def _starts(self) -> tuple[int, int, int]:
        """Where mu, nu and c stand."""
        mu = self.shape.count * self._svec.length
        nu = mu + self.shape.pieces * self._q
        return mu, nu, nu + self.m

    @property
    def _size(self) -> int:
        """For a transient one more: the larger of c / (2 sigma) and the start."""
        return self._starts[-1] + 1 + (self.first is not None)

    def _cost(self, sigma: float) -> Array:
        _, nu, c = self._starts
        cost = np.zeros(self._size)
        cost[nu:c] = 1.0
        if self.first is None:
            cost[c] = 1 / (2 * sigma)
        else:
            cost[-1] = 1.0
        return cost

    def least(self, sigma: float) -> _Least | None:
        """Of least b^2 for this sigma."""
        if not self.cuts:
            self.cuts |= self._flows(sigma).start
        for _ in range(_ROUNDS):
            rows, cost = self._rows(sigma), self._cost(sigma)
            met = rows.least_with_multipliers(cost)
            if met is None:
                return None
            x, z = met
            violated = self._flows(sigma).violated(x) - self.cuts
            if not violated:
                b_squared = float(cost @ x)
                step = sigma * _DIFFERENCE
                moved = (self._cost(sigma + step) - cost) @ x + z @ (self._rows(sigma + step).image(x) - rows.image(x))
                return _Least(x, b_squared, float(moved) / _DIFFERENCE / b_squared if b_squared > 0 else 0.0)
            self.cuts |= violated
        return None

    def _flows(self, sigma: float) -> Flows:
        A = np.array(list(self.maps.corners()))
        every = coefficients(self.shape, self.lengths, 0, self._svec.length, self._starts[0], self._q)
        return Flows(A, self.B, every, self.eps, sigma, self.m)

    def _rows(self, sigma: float) -> Rows:
        rows = self._fixed.copy()
        if self.first is not None:
            self._from_start(rows, sigma)
        self._flows(sigma).impose(rows, self.cuts)
        return rows

    @cached_property
    def _fixed(self) -> Rows:
        """Target, jump, how P(0) begins, and c at least what each piece feeds."""
        size, svec, t = len(self.z), self._svec, self._svec.length
        mu, nu, c = self._starts
        rows, J, zero = Rows(self._size), self.maps.jump, np.zeros((size, size))
        for number in range(self.shape.count):
            parts = {number * t: np.eye(t), nu: svec.diagonal(size - self.m)}
            rows.add(size, parts, svec.of(target_block(zero, self.z)) - self.eps * svec.unit)
        old = svec.of(np.array([jump_gap(P, zero, J) for P in svec.basis]))
        new = svec.of(np.array([jump_gap(zero, P, J) for P in svec.basis]))
        for number in range(max(self.shape.jump_from, int(self.T_min == 0)), self.shape.count):
            rows.add(size, {0: old, number * t: new}, -self.eps * svec.unit)
        none = np.flatnonzero(self._none[svec.i, svec.j])
        rows.equate({0: np.eye(t)[:, none]}, np.zeros(len(none)))
        if self.T_min == 0:
            self._gap_at_zero(rows)
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

    def _gap_at_zero(self, rows: Rows) -> None:
        """Q - j'Q j >= eps."""
        lost = np.flatnonzero(np.logical_not(self._kept[: len(self.z) - self.m]))
        if len(lost):
            corner, narrow = self.maps.jump[np.ix_(lost, lost)], Svec(len(lost))
            gaps = [jump_gap(P, P, corner) for P in self._svec.basis[:, lost][:, :, lost]]
            rows.add(len(lost), {0: narrow.of(np.array(gaps))}, -self.eps * narrow.unit)

    @cached_property
    def _kept(self) -> Array:
        rows = np.abs(self.maps.jump - np.eye(len(self.z)))
        kept: Array = (rows.max(axis=0) == 0) & (rows.max(axis=1) == 0)
        return kept

    @cached_property
    def _none(self) -> Any:
        """Where P(0) is 0: on s, and from T_min = 0 between what J keeps and the rest."""
        size = len(self.z)
        of_s = np.arange(size) >= size - self.m
        none = of_s[:, None] | of_s[None, :]
        return none | (self._kept[:, None] != self._kept[None, :]) if self.T_min == 0 else none

    def written(
        self, x: Array, sigma: float, size: float, scale: Array, signals: tuple[Array, Array], T: float
    ) -> Found:
        """In the user's units: time in T, coordinates in `scale`, the error looked at in `size`."""
        t, (mu, nu, c), (s0, d0) = self._svec.length, self._starts, signals
        P = self._svec.matrices(x[:mu].reshape(-1, t))
        P[0] = np.where(self._none, 0.0, P[0])  # the equations hold exactly, not to the solver's tolerance
        back = 1 / np.concatenate([scale, s0])
        weights = x[mu:nu].reshape(self.shape.pieces, self._q) * size**2 / np.concatenate([s0, d0]) ** 2 / T
        return Found(
            float(np.sqrt(max(float(self._cost(sigma) @ x), 0.0))) * size, self.shape, sigma / T,
            [upper_texts(one * size**2 * back * back[:, None], _DIGITS) for one in P],
            [_texts(piece) for piece in weights], _texts(x[nu:c] * size**2 / s0**2),
        )  # fmt: skip


def _texts(values: Array) -> list[str]:
    return [decimal_text(float(value), _DIGITS) for value in values]
