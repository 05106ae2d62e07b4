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

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, log
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.average import EPSILONS
from cdobs_cli.certify.methods.mean_square.curves import Curves
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
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_TIME_CONSTANTS = 3.0
_LAGS = (4, 8, 10, 12)  # at most, by effort
_LARGEST = 1500  # unknowns
_TAILS = ((0.5,), (0.5, 0.25), (0.5, 0.25, 0.75), (0.5, 0.25, 0.75, 0.1))  # rho between the radius and 1, by effort


@dataclass(frozen=True)
class EveryTime(Method):
    """state: which error, from 0; shape, units: as of the average; rho: of the tail; windows: the piece at which each
    ends, the last ends with the last piece; P: for each window the chain P_0 .. P_N."""

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

    def quantity(self, plant: Plant) -> str:
        """Which bound `Proof.error` is: the root of E e_i^2 at the worst time. Raises: ValueError, IndexError."""
        return f"rms.{plant.states[int(self.state)]}"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_white(question.plant) and takes(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """Of the first state; `each` has one of every state."""
        return cls.of_state(question, 0)

    @classmethod
    def each(cls, question: Question) -> list[Self]:
        """One certificate for each state that has one."""
        met = (cls.of_state(question, i) for i in range(question.plant.n))
        return [one for one in met if one is not None]

    @classmethod
    def of_state(cls, question: Question, state: int) -> Self | None:
        """The certificate of the least bound met for one error."""
        if not cls.applies(question):
            return None
        Z = errors_only(question.inclusion, np.eye(question.plant.n)[state])
        setting = Setting.of(question, Z)
        radius = 1.0 if setting is None else contraction(setting)
        if setting is None or not radius < 1:
            return None
        form = shape(question, 1 + _LAGS[question.level])
        windows = list(range(1, form.pieces + 1))
        N = lags(radius, form, setting.N, question.level)
        best: tuple[float, Self] | None = None
        for share in _TAILS[question.level]:
            rho = decimal_text(min(radius + (1 - radius) * share, 0.9999), 6)
            made = cls._at(question, setting, form, state, windows, N, rho)
            error = None if made is None else made.prove(question).error
            if made is not None and error is not None and (best is None or float(error) < best[0]):
                best = float(error), made
        return None if best is None else best[1]

    @classmethod
    def _at(
        cls, question: Question, setting: Setting, form: Shape, state: int, windows: list[int], N: int, rho: str
    ) -> Self | None:
        z = np.zeros(setting.N)
        z[state] = setting.states[state]
        for epsilon in EPSILONS[1:]:
            chains: list[list[Texts]] = []
            for place, end in enumerate(windows):
                start = windows[place - 1] if place else 0
                search = ChainSearch.of(question, setting, form, N, (start, end), epsilon)
                P = search.solve(np.outer(z, z), float(rho), question.memory)
                if P is None:
                    return None
                chains.append([texts(one) for one in P])
            ends = [str(end) for end in windows]
            made = cls(
                question.law, str(state), shape_texts(form), unit_texts(setting.states), rho, ends, chains
            )  # fmt: skip
            if made.prove(question).holds:
                return made
        return None

    def _prove(self, question: Question) -> Proof:
        rho, ends = rational(self.rho), [int(end) for end in self.windows]
        if not self.applies(question) or not 0 < rho < 1 or not 0 <= int(self.state) < question.plant.n:
            return NOTHING
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        starts = [0, *ends[:-1]]
        if ends != sorted(set(ends)) or ends[:1] < [1] or ends[-1] != proved.shape.pieces or len(self.P) != len(ends):
            return NOTHING
        most = arb(0)
        for start, end, chain in zip(starts, ends, self.P, strict=True):
            bound = self._bound(proved, [matrices(one, proved.shape, proved.N) for one in chain], start, end, rho)
            if bound is None or not bound.is_finite():
                return NOTHING
            most = most.max(bound)
        return Proof(True, error=most.upper().sqrt().upper())

    def _bound(
        self, proved: Proved, chain: list[list[Matrix]], start: int, end: int, rho: Fraction
    ) -> arb | None:  # fmt: skip
        """The bound of E (z'e)^2 for the clock in one window; None where it is not proved."""
        shape, N = proved.shape, len(chain) - 1
        if N < 1:
            return None
        target = proved.weight(_square(int(self.state), proved.N))
        window = range(start * shape.d, end * shape.d + 1)
        if not all(positive(chain[0][number] - target) for number in window):
            return None
        if not all(proved.falls(chain[k - 1][0], chain[k]) for k in range(1, N + 1)):
            return None
        if not proved.falls(chain[N][0], chain[N], rho * rho):
            return None
        if not all(proved.flows(P, until=shape.pieces if k else end) for k, P in enumerate(chain)):
            return None
        total = arb(0)
        for k, P in enumerate(chain):
            drifted = proved.drifted(P)[(shape.pieces if k else end) * (shape.d + 1)]
            q = arb((P[0] @ proved.spread).trace()) + arb(drifted)
            total += q if k < N else q / (1 - fraction_ball(rho * rho))
        return total


def _square(state: int, N: int) -> Matrix:
    """z z' with z the unit vector of a state."""
    return Matrix.from_rows([[int(i == j == state) for j in range(N)] for i in range(N)])


def contraction(setting: Setting) -> float:
    """The largest spectral radius of J exp(A T) over constant corners and the ends of the law."""
    ends = {1.0, setting.shortest} if setting.shortest > 0 else {1.0}
    maps = np.concatenate([exponentials(setting.flows * end) for end in ends])
    return max(float(spectral_radii(J @ maps).max()) for J in setting.jumps)


def lags(radius: float, form: Shape, N: int, level: int) -> int:
    """How many intervals are followed one by one: about three time constants, within what the search can bear."""
    wanted = ceil(_TIME_CONSTANTS / -log(max(radius, 1e-3)))
    bearable = _LARGEST // (form.count * N * (N + 1) // 2) - 1
    return max(1, min(max(2, wanted), _LAGS[level], bearable))


@dataclass
class ChainSearch:
    """minimise the bound over P_0 .. P_N, in floats and unit time; unknowns: the P_k."""

    curves: Curves
    jumps: Array
    spread: Array
    drift: Array
    window: tuple[int, int]

    @staticmethod
    def of(
        question: Question, setting: Setting, form: Shape, N: int, window: tuple[int, int], epsilon: float
    ) -> ChainSearch:  # fmt: skip
        R, Q = noise_floats(question.plant)
        pieces = [window[1], *[form.pieces] * N]
        nothing = np.zeros((N + 1, setting.N, setting.N))
        curves = Curves(form, setting.shortest, setting.flows, nothing, 0, epsilon, until=pieces)
        drift = setting.drive @ Q @ setting.drive.T / setting.T
        return ChainSearch(curves, setting.jumps, setting.kick @ R @ setting.kick.T, drift, window)

    def solve(self, target: Array, rho: float, memory: dict[Any, Any]) -> Array | None:
        """Coefficients of P_0 .. P_N: a guess."""
        curves, (start, end) = self.curves, self.window
        d, N = curves.shape.d, curves.count - 1
        key = ("every time", curves.shape, N, end)
        curves.cuts = set(memory.get(key, ()))
        program = curves.program()
        above = target + curves.epsilon * np.eye(curves.N)
        curves.require_above(program, 0, range(start * d, end * d + 1), above)
        for k in range(1, N + 1):
            curves.require_jumps(program, self.jumps, k - 1, k)
        curves.require_jumps(program, self.jumps, N, N, rho * rho)
        cost = np.zeros(curves.size)
        for k in range(N + 1):
            last = (curves.shape.pieces if k else end) * (d + 1)
            q = curves.start_row(k, self.spread) + curves.sum_rows(k, self.drift)[last]
            cost += q / (1 - rho * rho) if k == N else q
        x = curves.minimise(cost, program)
        memory[key] = curves.cuts
        if x is None:
            return None
        P = curves.coefficients(x)
        P[0, end * d + 1 :] = P[0, end * d]  # beyond the window nothing is asked of it
        return P
