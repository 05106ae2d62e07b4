"""Held gains that let little noise through: L multiplies P(tau), so they are looked for step by step, with the least
mean square that the clock-dependent function proves of each as their value."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING

from cdobs_cli.certify.climb import GAIN_DIGITS
from cdobs_cli.certify.gains import Candidate, Merit
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.mean_square.aim import Aim
from cdobs_cli.certify.methods.mean_square.average import amplification, amplification_slope
from cdobs_cli.certify.methods.quiet_gains import (
    away_from_zero,
    capped_rate,
    descended,
    kept_rates,
    proved,
    takes,
)
from cdobs_cli.certify.methods.rung import Rung
from cdobs_cli.certify.methods.wirtinger.design import size
from cdobs_cli.certify.search import short
from cdobs_cli.exact.numbers import ExactMatrix

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_PARTS = (1.0, 0.75, 0.5, 0.3, 0.15)  # of a gain that decays fast
_RATE_DIGITS = 6
_LARGEST = (1_000, 1_000, 4_000, 40_000)  # (n + p)^3 times corners, by effort


def quietest(question: Question, start: Candidate, rate: float, rung: Rung) -> Candidate | None:
    """Of the gains that reach half of a proved rate, capped as for a correction at samples, the one that amplifies
    noise least; `start` has that rate."""
    if not is_tried(question):
        return None
    fastest = min(short(rate, _RATE_DIGITS).rational or Fraction(0), capped_rate(question))
    sigma = max(fastest / 2, question.rate)
    return _least(question, start.gain, Aim.quiet(question, float(sigma)), sigma, rung)


def least_error(
    question: Question, start: ExactMatrix, rung: Rung, merit: Merit | None, weights: Sequence[float] | None
) -> Candidate | None:
    """From the best part of a gain down the valley of the merit; where there is none, of the mean square for what is
    declared, bounded signals as if they were uniform."""
    aim = Aim.declared(question, weights, 0.0)
    if not is_tried(question) or not (aim.R.any() or aim.Q.any()):
        return None
    for sigma in kept_rates(question, bool(aim.Q.any())):
        own = Aim(aim.Z, aim.R, aim.Q, float(sigma))
        met = _least(question, start, own, sigma, rung, merit)
        if met is not None:
            return met
    return None


def is_tried(question: Question) -> bool:
    """Whether the plant is small enough at this effort for a search step by step."""
    return takes(question) and size(question.plant) <= _LARGEST[question.level]


def _least(
    question: Question, start: ExactMatrix, aim: Aim, sigma: Fraction, rung: Rung, merit: Merit | None = None
) -> Candidate | None:
    """Of a gain the part that amplifies noise least; with some effort down from it. Its merit is minus what was
    lowered."""

    def value(about: Question) -> float | None:
        return amplification(away_from_zero(about), aim)

    def slope(about: Question) -> tuple[float, Array] | None:
        return amplification_slope(away_from_zero(about), aim, "L")

    def of(L: ExactMatrix) -> float:
        met = value(question.with_gain({"L": L}).afresh())
        return inf if met is None else met

    L = min((ExactMatrix.from_floats(part * start.floats, GAIN_DIGITS) for part in _PARTS), key=of)
    first = proved(question, "L", L, -of(L), rung, sigma)
    if first is None or not question.level:
        return first
    if merit is not None:
        return descended(question, "L", first, merit, rung, sigma, question.plant.n)
    return descended(question.afresh(), "L", first, value, rung, sigma, slope=slope)
