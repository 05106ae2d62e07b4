"""Unknown functions P_0(tau), .., P_N(tau) in Bernstein form, their flow inequalities, and the corners that bind.

Every flow inequality is required at the corners met so far; a solution that breaks others adds the worst of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.methods.clock.form import Shape, jump_gap, lyapunov
from cdobs_cli.certify.methods.mean_square.form import instants, sample_instants, sums
from cdobs_cli.certify.methods.mean_square.setting import ALL_AT_ONCE
from cdobs_cli.certify.methods.peak.form import jump_block
from cdobs_cli.certify.svec import symmetric_basis
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 24
_FINE, _COARSE = 1e-10, 1e-4  # the solver's tolerance, and while corners are still looked for
_FEW = 0.02  # of the corners met: so few new ones end the look

Cut = tuple[int, int, int]


@dataclass
class Curves:
    """`count` unknown functions of one shape over unit time, and `extra` further unknowns behind them.

    Attributes:
        flows: the corners of the flow, (V, N, N).
        Z: what each function pays for, (count, N, N).
        sigma: its rate, over unit time.
        until: how many pieces the flow inequality of each function covers.
        epsilon: the margin asked for, of each inequality.
        drive: what a disturbance does, (N, r); prices: columns of the unknowns mu >= 0 that it is paid with, for each
            function and piece, (count, pieces, r).
        cuts: (function, coefficient of the flow inequality, corner) that are required; kept for the next search.
    """

    shape: Shape
    shortest: float
    flows: Array
    Z: Array
    extra: int
    epsilon: float
    sigma: float = 0.0
    until: list[int] | None = None
    drive: Array | None = None
    prices: Any = None
    cuts: set[Cut] = field(default_factory=set)

    @property
    def N(self) -> int:
        return int(self.flows.shape[1])

    @property
    def count(self) -> int:
        return len(self.Z)

    @cached_property
    def lengths(self) -> list[float]:
        return [float(h) for h in self.shape.lengths(self.shortest, 1.0)]

    @cached_property
    def basis(self) -> Array:
        return symmetric_basis(self.N)

    @property
    def t(self) -> int:
        return self.N * (self.N + 1) // 2

    @property
    def last(self) -> int:
        """The first column of the further unknowns."""
        return self.count * self.shape.count * self.t

    @property
    def size(self) -> int:
        return self.last + self.extra

    def program(self) -> BlockProgram:
        return BlockProgram(self.size)

    def columns(self, k: int, number: int) -> Any:
        """Of coefficient `number` of P_k, (t,)."""
        return (k * self.shape.count + number) * self.t + np.arange(self.t)

    def coefficients(self, x: Array) -> Array:
        """(count, coefficients, N, N) of a solution."""
        entries = x[: self.last].reshape(self.count, self.shape.count, self.t)
        value: Array = np.einsum("knt,tij->knij", entries, self.basis)
        return value

    def price_rows(self, k: int, M: Array) -> Array:
        """Rows over the unknowns: the Bernstein coefficients of tr(P_k M)."""
        price = np.einsum("tij,ji->t", self.basis, M)
        rows = np.zeros((self.shape.count, self.size))
        for number in range(self.shape.count):
            rows[number, self.columns(k, number)] = price
        return rows

    def sum_rows(self, k: int, M: Array) -> Array:
        """Rows over the unknowns: the Bernstein coefficients of int_0^tau tr(P_k M), as `sums` numbers them."""
        return np.array(sums(list(self.price_rows(k, M)), self.shape, self.lengths))

    def start_row(self, k: int, M: Array) -> Array:
        """tr(P_k(0) M) as a row over the unknowns."""
        row: Array = self.price_rows(k, M)[0]
        return row

    @cached_property
    def sampled(self) -> list[int]:
        """The coefficients of `sums` that cover [T_min, T_max]."""
        return list(sample_instants(self.shape))

    @cached_property
    def times(self) -> Array:
        return np.array(instants(self.shape, self.lengths))

    def require_jumps(self, program: BlockProgram, jumps: Array, after: int, before: int, share: float = 1.0) -> None:
        """share P_before(tau) - J'P_after(0)J >= epsilon I on [T_min, T_max], at each corner of J."""
        zero = np.zeros((self.N, self.N))
        new = np.array([jump_gap(zero, P, zero) for P in self.basis]) * share
        for J in jumps:
            old = np.array([jump_gap(P, zero, J) for P in self.basis])
            numbers = range(self.shape.jump_from, self.shape.count)
            columns = np.array([[*self.columns(after, 0), *self.columns(before, number)] for number in numbers])
            terms = np.broadcast_to(np.concatenate([old, new]), (len(columns), 2 * self.t, self.N, self.N))
            program.require(columns, terms, -self.epsilon * np.eye(self.N))

    def require_kicks(
        self, program: BlockProgram, jumps: Array, G: Array, nu: Any, after: int, before: int, share: float = 1.0
    ) -> None:
        """[[share P_before(tau) - J'P_after(0)J, -J'P_after(0)G], [., diag nu - G'P_after(0)G]] >= epsilon I on
        [T_min, T_max], at each corner of J; nu: its columns."""
        n, q = self.N, len(nu)
        if not q:
            return self.require_jumps(program, jumps, after, before, share)
        zero, nothing = np.zeros((n, n)), np.zeros((q, q))
        for J in jumps:
            terms = [jump_block(zero, P, J, G, nothing) for P in self.basis]
            terms += [jump_block(P * share, zero, J, G, nothing) for P in self.basis]
            terms += [jump_block(zero, zero, J, G, np.diag(row)) for row in np.eye(q)]
            numbers = range(self.shape.jump_from, self.shape.count)
            columns = np.array([[*self.columns(after, 0), *self.columns(before, number), *nu] for number in numbers])
            stack = np.broadcast_to(np.array(terms), (len(columns), len(terms), n + q, n + q))
            program.require(columns, stack, -self.epsilon * np.eye(n + q))
        return None

    def require_above(self, program: BlockProgram, k: int, numbers: Any, M: Array) -> None:
        """P_k - M >= 0 at these coefficients."""
        columns = np.array([self.columns(k, number) for number in numbers])
        program.require(columns, np.broadcast_to(self.basis, (len(columns), *self.basis.shape)), -M)

    def minimise(self, cost: Array, program: BlockProgram, rounds: int = _ROUNDS) -> Array | None:
        """The solution of least cost over all corners, as far as floats tell; None where there is none."""
        met = self.minimise_with_multipliers(cost, program, rounds)
        return None if met is None else met[0]

    def minimise_with_multipliers(
        self, cost: Array, program: BlockProgram, rounds: int = _ROUNDS
    ) -> tuple[Array, Array] | None:
        """The same with the multipliers of what was required of it, `with_flow` of the program."""
        corners = range(len(self.flows))
        if not self.cuts:
            first = corners if len(corners) <= ALL_AT_ONCE else (0, len(corners) - 1)
            self.cuts = {(k, c, v) for k, c in self._places for v in first}
        met, tolerance = None, _FINE if len(corners) <= ALL_AT_ONCE else _COARSE
        for _ in range(rounds):
            met = self.with_flow(program).minimise_with_multipliers(cost, tolerance)
            if met is None:
                return None
            new = self._broken(met[0], tolerance) - self.cuts
            if not new and tolerance == _FINE:
                break
            if len(new) <= _FEW * len(self.cuts):
                tolerance = _FINE
            self.cuts |= new
        return met

    def with_flow(self, program: BlockProgram) -> BlockProgram:
        """The program with the flow inequalities at the cuts."""
        asked = program.copy()
        self._require_flow(asked)
        return asked

    @cached_property
    def _operators(self) -> tuple[Array, Array, Any, Any]:
        """Weights of derivative and value for each flow coefficient, times the piece's length, and its piece."""
        shape = self.shape
        G = np.array(derivative(shape.d, shape.D), dtype=float)
        E = np.array(elevation(shape.d, shape.D), dtype=float)
        g, e = np.concatenate([G] * shape.pieces), np.concatenate([E * h for h in self.lengths])
        piece = np.repeat(np.arange(shape.pieces), shape.D + 1)
        return g, e, piece, np.array(self.lengths)[piece]

    @cached_property
    def _images(self) -> Array:
        """P A + A'P + 2 sigma P of each basis matrix at each corner, (V, t, N, N)."""
        return np.array([[lyapunov(P, A, self.sigma) for P in self.basis] for A in self.flows])

    @property
    def _places(self) -> list[tuple[int, int]]:
        until = self.until or [self.shape.pieces] * self.count
        return [(k, c) for k in range(self.count) for c in range(until[k] * (self.shape.D + 1))]

    def known(self, cuts: Iterable[Cut]) -> set[Cut]:
        """Those of another search that are about places of this one."""
        places = set(self._places)
        kept = {cut for cut in cuts if cut[:2] in places}
        missing = places - {cut[:2] for cut in kept}
        return kept | {(k, c, v) for k, c in missing for v in (0, len(self.flows) - 1)} if kept else kept

    @property
    def _height(self) -> int:
        return self.N + (0 if self.drive is None else int(self.drive.shape[1]))

    def _require_flow(self, program: BlockProgram) -> None:
        """-(Pdot + P A + A'P + 2 sigma P + Z) >= epsilon I, or its block with the disturbance, at the cuts."""
        g, e, piece, length = self._operators
        cuts = np.array(sorted(self.cuts))
        k, c, v = cuts.T
        N, M, t, d = self.N, self._height, self.t, self.shape.d
        terms: Array = np.zeros((len(cuts), d + 1, t, M, M))
        values = g[c][:, :, None, None, None] * self.basis + e[c][:, :, None, None, None] * self._images[v][:, None]
        terms[..., :N, :N] = -values
        if self.drive is not None:
            crossing = -e[c][:, :, None, None, None] * (self.basis @ self.drive)
            terms[..., :N, N:], terms[..., N:, :N] = crossing, np.swapaxes(crossing, -1, -2)
        terms = terms.reshape(len(cuts), (d + 1) * t, M, M)
        first = (k * self.shape.count + piece[c] * d) * t
        columns = first[:, None] + np.arange((d + 1) * t)
        constants = np.zeros((len(cuts), M, M))
        constants[:, :N, :N] = -self.Z[k] * length[c][:, None, None]
        constants -= self.epsilon * length[c][:, None, None] * np.eye(M)
        if self.drive is not None:
            r = M - N
            units = np.zeros((r, M, M))
            units[np.arange(r), N + np.arange(r), N + np.arange(r)] = 1.0
            terms = np.concatenate([terms, units * length[c][:, None, None, None]], axis=1)
            columns = np.concatenate([columns, self.prices[k, piece[c]]], axis=1)
        program.require(columns, terms, constants)

    def _broken(self, x: Array, tolerance: float) -> set[Cut]:
        """For each flow coefficient the corner at which a solution leaves least, where that is too little."""
        g, e, piece, length = self._operators
        places = np.array(self._places)
        k, c = places.T
        P, N = self.coefficients(x), self.N
        numbers = piece[c][:, None] * self.shape.d + np.arange(self.shape.d + 1)
        local = P[k[:, None], numbers]
        slope, value = np.einsum("pk,pkij->pij", g[c], local), np.einsum("pk,pkij->pij", e[c], local)
        products = value[:, None] @ self.flows
        gaps = -(slope + 2 * self.sigma * value + self.Z[k] * length[c][:, None, None])[:, None] - products
        gaps = gaps - np.swapaxes(products, -1, -2)
        if self.drive is not None:
            whole = np.zeros((*gaps.shape[:2], self._height, self._height))
            crossing = -(value @ self.drive)[:, None]
            whole[..., :N, :N] = gaps
            whole[..., :N, N:], whole[..., N:, :N] = crossing, np.swapaxes(crossing, -1, -2)
            mu = x[self.prices[k, piece[c]]] * length[c][:, None]
            whole[..., N + np.arange(mu.shape[1]), N + np.arange(mu.shape[1])] = mu[:, None]
            gaps = whole
        least = np.linalg.eigvalsh(gaps)[..., 0]
        worst = least.argmin(axis=1)
        left = least[np.arange(len(places)), worst]
        broken = left < (0.2 * self.epsilon if tolerance == _FINE else -tolerance) * length[c]
        return {(int(a), int(b), int(w)) for (a, b), w in zip(places[broken], worst[broken], strict=True)}
