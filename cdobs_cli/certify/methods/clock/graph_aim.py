"""Functions over a timed graph that let as little noise and disturbance through as may be.

With L_q L_q' the second moment of the noise of what sample q reads, Q that of the disturbance per unit of time, and P_q
as in the certificate over a timed graph,

    minimise  sum_q tr(L_q' K_q' P_q(0) K_q L_q) + integral of tr(P Q)    over all samples and nodes

with  Pdot + P A_v + A_v' P + 2 sigma P < -Z  (of sensors in step the mean over time of E e'Z e is at most that sum over
a hyperperiod), or with  P > z z'  (|z'e|^2 <= V). Where gains are looked for the first sum is one of tr X_q,

    [[X_q, L_q' W'], [., P_q(0)]] > 0,    of a shared gain    [[X_q, L_q' W'], [., G + G' - P_q(0)]] > 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import GraphShape
from cdobs_cli.certify.methods.clock.graph import unit
from cdobs_cli.certify.methods.clock.graph_search import Block, FreeGain, GraphSearch, Posed, Scaled, fields_of
from cdobs_cli.certify.svec import full_basis, svec, symmetric_basis
from cdobs_cli.records import dataclass
from cdobs_cli.sensors import Reading

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_MARGIN = 1e-6  # of inequalities in which P is of size 1


@dataclass(frozen=True)
class GraphAim:
    """In the plant's states and outputs: R (p, p) and Q (n, n); Z of the flow, or z z' that P is above, (n, n): one of
    them is 0."""

    R: Array
    Q: Array
    Z: Array
    floor: Array


@dataclass
class AimedSearch(GraphSearch):
    """Further attributes, in the coordinates of the search: noise, L_q of each sample; kicks, K_q L_q where gains are
    given; Q, Z, floor."""

    noise: tuple[Array, ...] = ()
    kicks: tuple[Array, ...] = ()
    Q: Array = field(default_factory=lambda: np.zeros((0, 0)))
    Z: Array = field(default_factory=lambda: np.zeros((0, 0)))
    floor: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def drain(self) -> Array | None:
        return self.Z if self.Z.any() else None

    @property
    def free(self) -> int:
        return super().free + sum(_triangle(L) for L in self.noise if self.gains)

    def _normal(self) -> Array:
        """The margin is not looked for."""
        row = np.zeros((1, self._size))
        row[0, -1] = 1 / _MARGIN
        return row

    def _cost(self, size: int) -> Array:
        cost = np.zeros(size)
        pieces = zip(self.shape.firsts, self.lengths, strict=True)
        for first, length in pieces:  # the mean of the coefficients is that of the polynomial
            for k in range(self.shape.d + 1):
                cost[self._unknown(first + k)] += svec(self.Q) * length / (self.shape.d + 1)
        for q, kick in enumerate(self.kicks):
            cost[self._unknown(self._start(q))] += svec(kick @ kick.T)
        for q, L in enumerate(self.noise if self.gains else ()):
            cost[self._X(q)] += svec(np.eye(L.shape[1]))
        top = float(np.abs(cost).max())
        scaled: Array = cost / top if top > 0 else cost
        return scaled

    def _start(self, q: int) -> int:
        """Where P(0) stands after reading q."""
        return self.shape.starts[self.graph.into(q).target]

    def _X(self, q: int) -> slice:
        """Where the triangle of X_q stands."""
        first = self.shape.count * self._t + super().free + sum(map(_triangle, self.noise[:q]))
        return slice(first, first + _triangle(self.noise[q]))

    def _blocks(self, jumps: list[list[Array]]) -> Iterator[Block]:
        yield from super()._blocks(jumps)
        for gain in self.gains:
            noisy = [q for q in gain.readings if self.noise[q].shape[1]]
            yield from ((self._noisy(gain, q), self.N + self.noise[q].shape[1]) for q in noisy)

    def _static(self, jumps: list[list[Array]]) -> Any:
        """With P above the floor, coefficient by coefficient."""
        rows, right, cones = super()._static(jumps)
        if self.floor.any():
            for number in range(self.shape.count):
                rows.append(self._semidefinite([(self._unknown(number), svec(self.basis))], self.N))
                right += (-svec(self.floor)).tolist()
                cones.append(("psd", self.N))
        return rows, right, cones

    def _noisy(self, gain: FreeGain, q: int) -> list[tuple[slice, Array]]:
        """[[X_q, L'W'], [., P_q(0)]], or with G + G' - P_q(0)."""
        N, L, sign = self.N, self.noise[q], -1.0 if gain.is_shared else 1.0
        m = L.shape[1]

        def placed(X: Array | None = None, W: Array | None = None, P: Array | None = None) -> Array:
            whole = np.zeros((m + N, m + N))
            if X is not None:
                whole[:m, :m] = X
            if P is not None:
                whole[m:, m:] = P
            if W is not None:
                whole[m:, :m], whole[:m, m:] = W @ L, (W @ L).T
            return whole

        X = svec(np.array([placed(X=one) for one in symmetric_basis(m)]))
        P = svec(np.array([placed(P=sign * one) for one in self.basis]))
        columns, units = gain.columns(self.reads[q]), full_basis(N, len(gain.outputs))
        W = svec(np.array([placed(W=unit[:, columns]) for unit in units]))
        first = self._first(gain)
        parts = [(self._X(q), X), (self._unknown(self._start(q)), P), (slice(first, first + len(units)), W)]
        if gain.is_shared:
            G = svec(np.array([placed(P=one + one.T) for one in full_basis(N, N)]))
            parts.append((slice(first + len(units), first + len(units) + N * N), G))
        return parts


def _triangle(L: Array) -> int:
    return int(L.shape[1] * (L.shape[1] + 1) // 2)


def aimed(question: Question, shape: GraphShape, aim: GraphAim, *, given: bool) -> Posed | None:
    """The search for an aim; None as `pose`."""
    scaled = Scaled.of(question, given=given)
    if scaled is None:
        return None
    back, change, H = np.linalg.inv(scaled.change), scaled.change, unit(question.law)
    noise = tuple(_factor(aim.R, one) for one in question.law.readings)
    kicks: tuple[Array, ...] = ()
    if given:
        maps = question.inclusion.phases_noise_floats
        reads = [list(one.outputs) for one in question.law.readings]
        kicks = tuple(back @ one.kick[:, k] @ L for one, k, L in zip(maps, reads, noise, strict=True))
    Z = change.T @ aim.Z @ change * H
    size = max(float(np.abs(Z).max()), float(np.abs(change.T @ aim.floor @ change).max()))
    search = AimedSearch(
        **fields_of(question.law, shape, scaled), noise=noise, kicks=kicks, Q=back @ aim.Q @ back.T * H,
        Z=Z / size, floor=change.T @ aim.floor @ change / size,
    )  # fmt: skip
    return Posed(search, scaled.flow, scaled.jumps, scaled.S)


def _factor(R: Array, reading: Reading) -> Array:
    """L with L L' = R of what is read, in order; of no noise no column."""
    read = list(reading.outputs)
    values, vectors = np.linalg.eigh(R[np.ix_(read, read)])
    kept = values > 1e-14 * max(float(values.max(initial=0.0)), 1e-300)
    L: Array = vectors[:, kept] * np.sqrt(values[kept])
    return L
