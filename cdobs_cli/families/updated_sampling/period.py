"""The guaranteed sampling period while c(x_hat, u) <= c, and Lemma 1's own bound, both enclosed."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import exp, inf, isfinite, log
from typing import Any

from flint import arb

from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.families.updated_sampling.theorems import fixed_point, growth, lemma_1_kappa, lemma_1_phi
from cdobs_cli.records import dataclass

_LARGEST = 1e150


@dataclass(frozen=True)
class Timing:
    """alpha, a_1, a_2, a_3 of (6)-(7), in floats, rationals or balls."""

    alpha: Any
    a_1: Any
    a_2: Any
    a_3: Any

    @property
    def balls(self) -> Timing:
        """The same in balls."""
        return Timing(*map(arb, (self.alpha, self.a_1, self.a_2, self.a_3)))

    @property
    def floats(self) -> Timing:
        """The same in floats."""
        return Timing(*(float(arb(value).mid()) for value in (self.alpha, self.a_1, self.a_2, self.a_3)))

    @property
    def is_signed(self) -> bool:
        """alpha, a_1, a_2 > 0, a_3 >= 0 and a_1 alpha < 1: what (6)-(7) take for granted. Not in floats."""
        positive = all(arb(value) > 0 for value in (self.alpha, self.a_1, self.a_2))
        return bool(positive and arb(self.a_3) >= 0 and arb(self.a_1 * self.alpha) < 1)

    def cycle(self, c: Any, x: Any, exponential: Callable[[Any], Any]) -> Any:
        """`fixed_point` at L^- = x for constant c."""
        grown = growth(self.a_2, self.a_3, c * self.alpha / x, exponential)
        return fixed_point(self.a_1 * self.alpha, grown, x, exponential)


def _ball_exp(x: Any) -> arb:
    return arb(x).exp()


def _float_exp(x: float) -> float:
    return exp(x) if x < 700 else inf


def _root(negative: Callable[[float], bool], low: float) -> float:
    """Where a monotone function that is negative at `low` stops being so; inf beyond 1e150."""
    high = 2 * low
    while negative(high):
        low, high = high, high * high if high > 2 else 4.0
        if high > _LARGEST:
            return inf
    while high / low > 1 + 1e-14:
        middle = low * exp(log(high / low) / 2)
        if not low < middle < high:
            break
        low, high = (middle, high) if negative(middle) else (low, middle)
    return high


def float_period(timing: Timing, c: float) -> float:
    """alpha / x at the fixed point of the cycle, in floats: what a search maximises."""
    x = _root(lambda x: timing.cycle(c, x, _float_exp) < 0, 1.0)
    return timing.alpha / x  # type: ignore[no-any-return]


def guaranteed_period(timing: Timing, c: arb) -> tuple[arb, arb]:
    """(proved, reached): delta_k >= proved for all k while c(x_hat, u) <= c and L(0) = 1, and for constant c
    the periods fall to at most `reached`.

    x (exp(-I(c alpha / x)) - (1 - a_1 alpha)) - a_1 alpha changes its sign once, at L^- of the cycle: x grows
    with L_k and with c, so from L(0) = 1 it never passes that point. Timing in balls.
    """
    floats = timing.floats
    guess = _root(lambda x: floats.cycle(float(c.upper()), x, _float_exp) < 0, 1.0)
    if not isfinite(guess):
        return arb(0), timing.alpha
    above = _beside(guess, 1, lambda x: timing.cycle(c, x, _ball_exp) > 0)
    below = _beside(guess, -1, lambda x: timing.cycle(c, x, _ball_exp) < 0)
    if above is None:
        return arb(0), timing.alpha
    return timing.alpha / above, timing.alpha if below is None else timing.alpha / below


def _beside(guess: float, side: int, holds: Callable[[arb], bool]) -> arb | None:
    """A number just above (side 1) or below (-1) the guess at which something holds."""
    trials = (fraction_ball(Fraction(guess) * (1 + side * Fraction(1, 10**digits))) for digits in (12, 9, 6))
    return next(filter(holds, trials), None)


def lemma_1(timing: Timing, c: arb) -> arb:
    """alpha / l_inf, l_inf = max(L_0, l_1, l_1 phi(1)) kappa(alpha), phi(l_1) = 1, L_0 = 1: Lemma 1's own bound.

    Source: Andrieu2014, proof of Lemma 1
    Deviates: the paper leaves L_0 out of the maximum.
    """

    def phi(parts: Timing, rate: Any, ell: Any, exponential: Callable[[Any], Any]) -> Any:
        kappa = lemma_1_kappa(parts.a_2, parts.a_3, rate * parts.alpha / ell, exponential)
        return lemma_1_phi(parts.a_1 * parts.alpha, kappa, ell)

    floats = timing.floats
    guess = _root(lambda ell: phi(floats, float(c.upper()), ell, _float_exp) > 1, 1e-9)
    if not isfinite(guess):
        return arb(0)
    ell_1 = fraction_ball(Fraction(guess) * (1 + Fraction(1, 10**9)))
    if not phi(timing, c, ell_1, _ball_exp) < 1:
        return arb(0)
    largest = arb(1).max(ell_1).max(ell_1 * phi(timing, c, arb(1), _ball_exp))
    bound = largest * lemma_1_kappa(timing.a_2, timing.a_3, c * timing.alpha, _ball_exp)
    return timing.alpha / bound if bound.is_finite() else arb(0)
