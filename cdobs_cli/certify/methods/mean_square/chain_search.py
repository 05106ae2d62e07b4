"""The search for chains of quadratic functions of the last sampling intervals: floats and the solver propose."""

from __future__ import annotations

from fractions import Fraction
from itertools import islice
from math import ceil, log
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.bernstein import restriction
from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.driven import Driven
from cdobs_cli.certify.methods.mean_square.setting import EPSILONS, Setting
from cdobs_cli.certify.methods.mean_square.windows import Window
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_TIME_CONSTANTS = 3.0
LAGS = (4, 8, 10, 12)  # at most, by effort
_LARGEST = 1500  # unknowns; a third of them where corners are added as they bind
_ALL_TAILS = 2  # from this effort on
_SPLITS = (2, 6, 12, 24)  # of the window with the largest bound, by effort; half of them where corners are added
_GAIN = 0.985  # a split that leaves more of the bound is the last


def contraction(setting: Setting) -> float:
    """The largest spectral radius of J exp(A T) over constant corners and the ends of the law."""
    ends = {1.0, setting.shortest} if setting.shortest > 0 else {1.0}
    maps = np.concatenate([exponentials(setting.flows * end) for end in ends])
    return max(float(spectral_radii(J @ maps).max()) for J in setting.jumps)


def lags(radius: float, form: Shape, setting: Setting, level: int) -> int:
    """How many intervals are followed one by one: about three time constants, within what the search can bear."""
    wanted = ceil(_TIME_CONSTANTS / -log(max(radius, 1e-3)))
    largest = _LARGEST if setting.all_at_once else _LARGEST // 3
    bearable = largest // (form.count * setting.N * (setting.N + 1) // 2) - 1
    return max(1, min(max(2, wanted), LAGS[level], bearable))


@dataclass(frozen=True)
class Chain:
    """A guess: coefficients of P_0 .. P_N, (N + 1, coefficients, N, N); prices mu of the disturbances, (N + 1, pieces,
    r), and nu of the noises, of the jumps from P_1 to P_0 on, that of the tail last, (N + 1, q); the bound."""

    P: Array
    mu: Array
    nu: Array
    bound: float


@dataclass
class Search:
    """minimise the bound of one state over P_0 .. P_N, in floats and unit time; unknowns: the P_k."""

    question: Question
    setting: Setting
    form: Shape
    state: int
    lags: int
    epsilon: float = EPSILONS[1]

    def best(self, tails: list[str]) -> tuple[str, dict[Window, Chain]] | None:
        """The tail that serves the last window best, and the chains of windows that cover the clock's range: the one
        with the largest bound is split while that helps."""
        last = Window(self.form.pieces - 1, Fraction(0), Fraction(1))
        tried = ((rho, chain) for rho in tails if (chain := self.chain(last, rho)) is not None)
        met = list(tried) if self.question.level >= _ALL_TAILS else list(islice(tried, 1))
        if not met:
            return None
        rho, found = min(met, key=lambda pair: pair[1].bound)
        chains = {last: found}
        for piece in range(self.form.pieces - 1):
            window = Window(piece, Fraction(0), Fraction(1))
            chain = self.chain(window, rho)
            if chain is None:
                return None
            chains[window] = chain
        splits = _SPLITS[self.question.level]
        for _ in range(splits if self.setting.all_at_once else splits // 2):
            worst = max(chains, key=lambda window: chains[window].bound)
            parts = {half: chain for half in worst.split() if (chain := self.chain(half, rho)) is not None}
            if len(parts) < 2 or max(chain.bound for chain in parts.values()) > _GAIN * chains[worst].bound:
                break
            del chains[worst]
            chains |= parts
        return rho, dict(sorted(chains.items(), key=lambda pair: (pair[0].piece, pair[0].start)))

    def chain(self, window: Window, rho: str) -> Chain | None:
        setting, form, N = self.setting, self.form, self.lags
        driven = Driven.of(setting, self.question.plant)
        (r, q), pieces = (len(driven.d_0), len(driven.v_0)), form.pieces
        nothing = np.zeros((N + 1, setting.N, setting.N))
        until = [window.piece + 1, *[pieces] * N]
        extra = (N + 1) * (pieces * r + q)
        curves = Curves(
            form, setting.shortest, setting.flows, nothing, extra, self.epsilon, until=until,
            drive=driven.B if r else None,
        )  # fmt: skip
        curves.prices = mu = curves.last + np.arange((N + 1) * pieces * r).reshape(N + 1, pieces, r)
        nu = curves.size - (N + 1) * q + np.arange((N + 1) * q).reshape(N + 1, q)
        key = ("every time", form, N)
        curves.cuts = curves.known(self.question.memory.get(key, ()))
        z = np.eye(setting.N)[self.state] * setting.states[self.state]
        program, share = curves.program(), float(rho) ** 2
        self._require_above(curves, program, np.outer(z, z), window)
        for k in range(1, N + 1):
            curves.require_kicks(program, setting.jumps, driven.G, nu[k - 1], k - 1, k)
        curves.require_kicks(program, setting.jumps, driven.G, nu[N], N, N, share)
        cost = self._bound_row(curves, driven, window, mu, nu, share)
        x = curves.minimise(cost, program)
        self.question.memory[key] = curves.cuts
        if x is None:
            return None
        P, last = curves.coefficients(x), (window.piece + 1) * form.d
        P[0, last + 1 :] = P[0, last]  # beyond the window nothing is asked of it
        bound = float(cost @ x) * driven.unit**2
        return Chain(P, driven.flow_prices(x[mu]), driven.kick_prices(x[nu]), bound)

    def _bound_row(
        self, curves: Curves, driven: Driven, window: Window, mu: Any, nu: Any, share: float
    ) -> Array:  # fmt: skip
        """The bound as a row over the unknowns: what P_k takes in over its interval and at the sample before it."""
        N, form, cost = self.lags, self.form, np.zeros(curves.size)
        for k in range(N + 1):
            taken = np.zeros(curves.size)
            if k:
                taken += curves.sum_rows(k, driven.drift)[-1]
                taken[mu[k]] += np.array(curves.lengths)[:, None]
            else:
                taken += window.until_end(list(curves.price_rows(0, driven.drift)), form, curves.lengths, float)
                taken[mu[0]] += np.array(window.spans(curves.lengths, float))[:, None]
            taken += curves.start_row(k, driven.spread)
            taken[nu[k]] += 1.0
            cost += taken if k < N else taken / (1 - share)
        return cost

    def _require_above(self, curves: Curves, program: BlockProgram, target: Array, window: Window) -> None:
        """P_0 - z z' >= epsilon I on the window."""
        first = window.piece * self.form.d
        numbers = range(first, first + self.form.d + 1)
        columns = np.concatenate([curves.columns(0, number) for number in numbers])
        weights = np.array(restriction(self.form.d, window.start, window.end), dtype=float)
        terms = weights[:, :, None, None, None] * curves.basis
        terms = terms.reshape(len(weights), len(columns), curves.N, curves.N)
        constants = -target - self.epsilon * np.eye(curves.N)
        program.require(np.broadcast_to(columns, (len(weights), len(columns))), terms, constants)
