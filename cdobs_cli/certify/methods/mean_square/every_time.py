"""The mean square of one error at every time, under white noise and a white disturbance; one of them may be bounded.

A chain P_0, .., P_N: P_0 is for the interval of the time asked about, P_k for the k-th before it. If

    [[-(Pdot_k + P_k A_v + A_v'P_k), -P_k B], [., diag mu_k]] > 0    on [0, T_max] (P_0: until the end of the window),
    [[P_k(tau) - J'P_(k-1)(0)J, -J'P_(k-1)(0)G], [., diag nu_(k-1) - G'P_(k-1)(0)G]] > 0    on [T_min, T_max],
    the same with rho^2 P_N(tau), P_N(0), nu_N for P_k, P_(k-1), nu_(k-1),                  rho < 1,
    P_0(tau) - z z' > 0                                                                     on the window,

at all corners v and all corners of J, then with

    q_k = tr(R G'P_k(0)G) + int tr(P_k B Q B') + sum_j d0_j^2 int mu_kj + sum_j nu_kj v0_j^2

(integrals to T_max, of P_0 to the end of the window; of each signal only what is declared)

    limsup E (z'e(t))^2 <= q_0 + .. + q_(N-1) + q_N / (1 - rho^2)    over all t with the clock in the window.

Downwards: E e'P_(k-1)(0)e just after a sample is at most E e'P_k e just before it and what v_k adds, E e'P_k e grows by
the integral at most; P_k >= 0 follows from P_0 >= z z'. Intervals are counted backwards from t, so T_k must not depend
on noise and disturbance: where it does, the bound may fail (the average form holds).
"""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.mean_square.chain_search import LAGS, Chain, Search, contraction, lags
from cdobs_cli.certify.methods.mean_square.polynomial import (
    DIGITS,
    Proved,
    Texts,
    exact_scalar,
    matrices,
    positive,
    shape_of,
    shape_texts,
    texts,
    unit_texts,
)
from cdobs_cli.certify.methods.mean_square.setting import EPSILONS, Setting, errors_only, shape
from cdobs_cli.certify.methods.mean_square.signals import takes
from cdobs_cli.certify.methods.mean_square.subject import MeanSquareOfState
from cdobs_cli.certify.methods.mean_square.windows import Window, windows
from cdobs_cli.certify.texts import rational
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_TAILS = (0.25, 0.5, 0.1, 0.75)  # rho between the radius and 1: the first that serves, or the best of all
_RHO_DIGITS = 6

Prices = list[list[str]]


@dataclass(frozen=True)
class EveryTime(MeanSquareOfState):
    """shape, units: as of the average; rho: of the tail; windows: where each ends, in pieces; P: for each window the
    chain P_0 .. P_N. Where one signal is bounded, mu: for each window and function and piece the prices of the
    disturbances; nu: for each window and function those of the noises."""

    state: str
    shape: list[str]
    units: list[str]
    rho: str
    windows: list[str]
    P: list[list[Texts]]
    mu: list[list[Prices]] | None = field(default=None, metadata={OPTIONAL: True})
    nu: list[Prices] | None = field(default=None, metadata={OPTIONAL: True})

    name: ClassVar[str] = "mean_square_at_every_time"
    rung: ClassVar[str] = "mean_square_at_every_time"
    source: ClassVar[str] = "chain of clock-dependent quadratic functions, adapted slopes"
    statement: ClassVar[str] = (
        "A chain of functions e'P_k(tau)e bounds E e_i^2 at every time, for sampling instants that do not depend on "
        "noise and disturbance"
    )
    nonlinear_outputs: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.plant.has_white and takes(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The certificate of the least bound met for the error of the question's state."""
        state = question.state
        if state is None or not cls.applies(question):
            return None
        setting = Setting.of(question, errors_only(question.inclusion, np.eye(question.plant.n)[state]))
        radius = 1.0 if setting is None else contraction(setting)
        if setting is None or not radius < 1:
            return None
        form = shape(question, setting, 1 + LAGS[question.level])
        search = Search(question, setting, form, state, lags(radius, form, setting, question.level))
        tails = [decimal_text(min(radius + (1 - radius) * share, 0.9999), _RHO_DIGITS) for share in _TAILS]
        for epsilon in EPSILONS[1:]:
            search.epsilon = epsilon
            met = search.best(tails)
            if met is not None:
                made = cls._of(search, *met)
                if made.prove(question).holds:
                    return made
        return None

    @classmethod
    def _of(cls, search: Search, rho: str, chains: dict[Window, Chain]) -> Self:
        bounded, met = search.question.plant.has_bounded, chains.values()
        return cls(
            search.question.law, str(search.state), shape_texts(search.form), unit_texts(search.setting.states), rho,
            [fraction_text(window.piece + window.end) for window in chains],
            [[texts(one) for one in chain.P] for chain in met],
            [[[_decimals(row) for row in one] for one in chain.mu] for chain in met] if bounded else None,
            [[_decimals(row) for row in chain.nu] for chain in met] if bounded else None,
        )  # fmt: skip

    def _prove(self, question: Question) -> Proof:
        rho, state = rational(self.rho), int(self.state)
        if not self.applies(question) or not 0 < rho < 1 or not 0 <= state < question.plant.n:
            return NOTHING
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        most = arb(0)
        for number, window in enumerate(windows(proved.shape, self.windows)):
            links = self._links(proved, number)
            if not _holds(proved, links, state, window, rho):
                return NOTHING
            most = most.max(_bound(proved, links, window, rho))
        return Proof(True, error=most.upper().sqrt().upper()) if most.is_finite() else NOTHING

    def _links(self, proved: Proved, number: int) -> list[Link]:
        """The chain of one window. Raises: ValueError, IndexError."""
        B, G = proved.driven
        links = []
        for k, P in enumerate(self.P[number]):
            mu = [[]] * proved.shape.pieces if self.mu is None else self.mu[number][k]
            nu = [] if self.nu is None else self.nu[number][k]
            links.append(
                Link(
                    matrices(P, proved.shape, proved.N), [proved.prices(row, B.shape[1]) for row in mu],
                    proved.prices(nu, G.shape[1]),
                )
            )  # fmt: skip
        return links


@dataclass(frozen=True)
class Link:
    """P_k, with the prices mu of each piece and nu of the sample before the interval, diagonal matrices."""

    P: list[Matrix]
    mu: list[Matrix]
    nu: Matrix


def _holds(proved: Proved, chain: list[Link], state: int, window: Window, rho: Fraction) -> bool:
    """Whether the inequalities of one chain are proved."""
    (B, G), N = proved.driven, len(chain) - 1
    if N < 1:
        return False
    target = proved.weight(_square(state, proved.N))
    return (
        all(positive(P - target) for P in window.inside(chain[0].P, proved.shape))
        and all(proved.falls(new.P[0], old.P, G=G, nu=new.nu) for new, old in pairwise(chain))
        and proved.falls(chain[N].P[0], chain[N].P, rho * rho, G, chain[N].nu)
        and all(
            proved.flows(link.P, until=None if k else window.piece + 1, B=B, mu=link.mu) for k, link in enumerate(chain)
        )
    )


def _bound(proved: Proved, chain: list[Link], window: Window, rho: Fraction) -> arb:
    """q_0 + .. + q_(N-1) + q_N / (1 - rho^2)."""
    total, N = arb(0), len(chain) - 1
    for k, link in enumerate(chain):
        drift = proved.traces(link.P, proved.drift)
        drifted = proved.sums(drift)[-1] if k else window.until_end(drift, proved.shape, proved.lengths)
        spans = proved.lengths if k else window.spans(proved.lengths, exact_scalar)
        q = arb((link.P[0] @ proved.spread).trace()) + arb(drifted.trace()) + proved.kicked(link.nu)
        for mu, span in zip(link.mu, spans, strict=True):
            q += proved.power(mu) * arb(span)
        total += q if k < N else q / (1 - fraction_ball(rho * rho))
    return total


def _square(state: int, N: int) -> Matrix:
    """z z' with z the unit vector of a state."""
    return Matrix.from_rows([[int(i == j == state) for j in range(N)] for i in range(N)])


def _decimals(values: Array) -> list[str]:
    return [decimal_text(max(float(value), 0.0), DIGITS) for value in values]
