"""The mean square of one error at every time, under white noise and a white disturbance.

A chain P_0, .., P_N: P_0 is for the interval of the time asked about, P_k for the k-th before it. If

    Pdot_k + P_k A_v + A_v'P_k < 0         on [0, T_max] (P_0: until the end of the window), all corners v,
    P_k(tau) - J'P_(k-1)(0)J > 0           on [T_min, T_max], k = 1..N, all corners of J,
    rho^2 P_N(tau) - J'P_N(0)J > 0         on [T_min, T_max], rho < 1,
    P_0(tau) - z z' > 0                    on the window,

then with q_k = tr(R G'P_k(0)G) + int tr(P_k B Q B') (P_0: until the end of the window)

    limsup E (z'e(t))^2 <= q_0 + .. + q_(N-1) + q_N / (1 - rho^2)    over all t with the clock in the window.

Downwards: E e'P_(k-1)(0)e just after a sample is at most E e'P_k e just before it and what v_k adds, E e'P_k e grows by
the integral at most; P_k >= 0 follows from P_0 >= z z'. Intervals are counted backwards from t, so T_k must not depend
on noise and disturbance: where it does, the bound may fail (the average form holds).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from math import ceil, floor, log
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.bernstein import restriction
from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.clock.form import Shape, combination
from cdobs_cli.certify.methods.mean_square.average import EPSILONS
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.form import sums
from cdobs_cli.certify.methods.mean_square.polynomial import (
    Proved,
    Texts,
    matrices,
    positive,
    shape_of,
    shape_texts,
    texts,
    unit_texts,
)
from cdobs_cli.certify.methods.mean_square.setting import Setting, errors_only, shape
from cdobs_cli.certify.methods.mean_square.signals import is_white, noise_floats, takes
from cdobs_cli.certify.texts import rational
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_TIME_CONSTANTS = 3.0
_LAGS = (4, 8, 10, 12)  # at most, by effort
_LARGEST = 1500  # unknowns; a third of them where corners are added as they bind
_TAILS = (0.25, 0.5, 0.1, 0.75)  # rho between the radius and 1: the first that serves, or the best of all
_ALL_TAILS = 2  # from this effort on
_SPLITS = (2, 6, 12, 24)  # of the window with the largest bound, by effort; half of them where corners are added
_GAIN = 0.985  # a split that leaves more of the bound is the last


@dataclass(frozen=True)
class EveryTime(Method):
    """state: which error, from 0; shape, units: as of the average; rho: of the tail; windows: where each ends, in
    pieces; P: for each window the chain P_0 .. P_N."""

    state: str
    shape: list[str]
    units: list[str]
    rho: str
    windows: list[str]
    P: list[list[Texts]]

    name: ClassVar[str] = "mean_square_at_every_time"
    rung: ClassVar[str] = "mean_square_at_every_time"
    source: ClassVar[str] = "chain of clock-dependent quadratic functions, adapted slopes"
    how: ClassVar[str] = "exact Bernstein coefficients"
    statement: ClassVar[str] = (
        "A chain of functions e'P_k(tau)e bounds E e_i^2 at every time, for sampling instants that do not depend on "
        "noise and disturbance"
    )
    reach: ClassVar[Reach] = "mean square"
    nonlinear_outputs: ClassVar[bool] = True
    of_one_state: ClassVar[bool] = True

    def quantity(self, plant: Plant) -> str:
        """Which bound `Proof.error` is: the root of E e_i^2 at the worst time. Raises: ValueError, IndexError."""
        return f"rms.{plant.states[int(self.state)]}"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_white(question.plant) and takes(question)

    @classmethod
    def each(cls, question: Question) -> list[Self]:
        """One certificate for each state that has one."""
        met = (cls.propose(question.of_state(i)) for i in range(question.plant.n))
        return [one for one in met if one is not None]

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The certificate of the least bound met for the error of the question's state."""
        state = question.state
        if state is None or not cls.applies(question):
            return None
        Z = errors_only(question.inclusion, np.eye(question.plant.n)[state])
        setting = Setting.of(question, Z)
        radius = 1.0 if setting is None else contraction(setting)
        if setting is None or not radius < 1:
            return None
        form = shape(question, setting, 1 + _LAGS[question.level])
        search = Search(question, setting, form, state, lags(radius, form, setting, question.level))
        tails = [decimal_text(min(radius + (1 - radius) * share, 0.9999), 6) for share in _TAILS]
        for epsilon in EPSILONS[1:]:
            search.epsilon = epsilon
            met = search.best(tails)
            if met is None:
                continue
            rho, parts = met
            ends = [fraction_text(window.piece + window.end) for window in parts]
            P = [[texts(one) for one in chain.P] for chain in parts.values()]
            made = cls(question.law, str(state), shape_texts(form), unit_texts(setting.states), rho, ends, P)
            if made.prove(question).holds:
                return made
        return None

    def _prove(self, question: Question) -> Proof:
        rho = rational(self.rho)
        if not self.applies(question) or not 0 < rho < 1 or not 0 <= int(self.state) < question.plant.n:
            return NOTHING
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        most = arb(0)
        for window, texts_of_chain in zip(windows(proved.shape, self.windows), self.P, strict=True):
            chain = [matrices(one, proved.shape, proved.N) for one in texts_of_chain]
            if not self._holds(proved, chain, window, rho):
                return NOTHING
            most = most.max(_bound(proved, chain, window, rho))
        return Proof(True, error=most.upper().sqrt().upper()) if most.is_finite() else NOTHING

    def _holds(self, proved: Proved, chain: list[list[Matrix]], window: Window, rho: Fraction) -> bool:
        """Whether the inequalities of one chain are proved."""
        N = len(chain) - 1
        if N < 1:
            return False
        target = proved.weight(_square(int(self.state), proved.N))
        return (
            all(positive(P - target) for P in window.inside(chain[0], proved.shape))
            and all(proved.falls(chain[k - 1][0], chain[k]) for k in range(1, N + 1))
            and proved.falls(chain[N][0], chain[N], rho * rho)
            and all(proved.flows(P, until=None if k else window.piece + 1) for k, P in enumerate(chain))
        )


@dataclass(frozen=True)
class Window:
    """A part [start, end] of a piece of the clock's range; the piece is [0, 1]."""

    piece: int
    start: Fraction
    end: Fraction

    def inside(self, P: list[Any], form: Shape, number: Callable[[Fraction], Any] = Fraction) -> list[Any]:
        """The Bernstein coefficients of P on the window, with weights of this kind."""
        local = P[self.piece * form.d : (self.piece + 1) * form.d + 1]
        rows = restriction(form.d, self.start, self.end)
        return [combination(tuple(map(number, weights)), local) for weights in rows]

    def until_end(
        self, q: list[Any], form: Shape, lengths: list[Any], number: Callable[[Fraction], Any] = Fraction
    ) -> Any:
        """int q from tau = 0 to the end of the window."""
        first = Window(self.piece, Fraction(0), self.end).inside(q, form, number)
        part = sum(first[1:], first[0]) * lengths[self.piece] * number(self.end / (form.d + 1))
        return sums(q, form, lengths)[self.piece * (form.d + 1)] + part

    def split(self) -> tuple[Window, Window]:
        middle = (self.start + self.end) / 2
        return Window(self.piece, self.start, middle), Window(self.piece, middle, self.end)


def windows(form: Shape, ends: list[str]) -> list[Window]:
    """The windows that end there; together they cover the pieces. Raises: ValueError where they do not."""
    made: list[Window] = []
    last = Fraction(0)
    for end in map(rational, ends):
        piece = floor(last)
        if not last < end <= piece + 1:
            raise ValueError("windows are parts of one piece each, one behind the other")
        made.append(Window(piece, last - piece, end - piece))
        last = end
    if last != form.pieces:
        raise ValueError("windows cover all of the clock's range")
    return made


def _bound(proved: Proved, chain: list[list[Matrix]], window: Window, rho: Fraction) -> arb:
    """q_0 + .. + q_(N-1) + q_N / (1 - rho^2)."""
    total, N = arb(0), len(chain) - 1
    for k, P in enumerate(chain):
        q = proved.traces(P, proved.drift)
        drifted = proved.sums(q)[-1] if k else window.until_end(q, proved.shape, proved.lengths)
        added = arb((P[0] @ proved.spread).trace()) + arb(drifted.trace())
        total += added if k < N else added / (1 - fraction_ball(rho * rho))
    return total


def _square(state: int, N: int) -> Matrix:
    """z z' with z the unit vector of a state."""
    return Matrix.from_rows([[int(i == j == state) for j in range(N)] for i in range(N)])


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
    return max(1, min(max(2, wanted), _LAGS[level], bearable))


@dataclass(frozen=True)
class Chain:
    """A guess: coefficients of P_0 .. P_N, (N + 1, coefficients, N, N), and the bound that they give."""

    P: Array
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
        nothing = np.zeros((N + 1, setting.N, setting.N))
        until = [window.piece + 1, *[form.pieces] * N]
        curves = Curves(form, setting.shortest, setting.flows, nothing, 0, self.epsilon, until=until)
        key = ("every time", form, N)
        curves.cuts = curves.known(self.question.memory.get(key, ()))
        z = np.eye(setting.N)[self.state] * setting.states[self.state]
        program, share = curves.program(), float(rho) ** 2
        self._require_above(curves, program, np.outer(z, z), window)
        for k in range(1, N + 1):
            curves.require_jumps(program, setting.jumps, k - 1, k)
        curves.require_jumps(program, setting.jumps, N, N, share)
        R, Q = noise_floats(self.question.plant)
        spread, drift = setting.kick @ R @ setting.kick.T, setting.drive @ Q @ setting.drive.T / setting.T
        costs = [curves.start_row(k, spread) + curves.sum_rows(k, drift)[-1] for k in range(N + 1)]
        q = list(curves.price_rows(0, drift))
        costs[0] = curves.start_row(0, spread) + window.until_end(q, form, curves.lengths, float)
        costs[N] = costs[N] / (1 - share)
        cost = np.sum(costs, axis=0)
        x = curves.minimise(cost, program)
        self.question.memory[key] = curves.cuts
        if x is None:
            return None
        P, last = curves.coefficients(x), (window.piece + 1) * form.d
        P[0, last + 1 :] = P[0, last]  # beyond the window nothing is asked of it
        return Chain(P, float(cost @ x))

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
