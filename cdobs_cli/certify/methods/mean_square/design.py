"""Gains for a correction at samples that let little noise through: at a rate, or for the noise that is declared."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import log
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.gains import Candidate
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import GAIN_DIGITS, design_impulsive, is_small
from cdobs_cli.certify.methods.mean_square.setting import units
from cdobs_cli.certify.methods.mean_square.signals import noise_floats
from cdobs_cli.certify.methods.mean_square.synthesis import Aim, best_gain
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.certify.search import short
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_WIDTH = 0.02
_RATE_DIGITS = 6
_PARTS = (Fraction(1), Fraction(99, 100), Fraction(9, 10))  # of the rate kept, where less is left by rounding
_SLOW = 50  # periods in which the error falls to 1 % at least, where no disturbance keeps a gain from vanishing


def scales(question: Question) -> Array:
    """How far each state moves: the width of its domain's side, else what the clock certificate counts in, in
    proportion to the sides that are known; shape (n,)."""
    plant = question.plant
    size = units(question.inclusion)[: plant.n]
    known = {}
    for i, name in enumerate(plant.states):
        side = plant.domain.box.get(name)
        if side is not None and side.lower is not None and side.upper is not None:
            known[i] = float(side.upper) - float(side.lower)
    known = {i: width for i, width in known.items() if width > 0}
    ratio = float(np.median([width / size[i] for i, width in known.items()])) if known else 1.0
    return np.array([known.get(i, ratio * size[i]) for i in range(plant.n)])


def capped_rate(question: Question) -> Fraction:
    """ln(100) / (n T_max): the error falls to 1 % in n periods. A dead beat is no goal."""
    return short(log(100) / (question.plant.n * float(question.law.T_max)), _RATE_DIGITS).rational or Fraction(0)


def fastest_rate(question: Question) -> Fraction | None:
    """The largest rate that a gain with a clock certificate was found for, at most the cap; None where there is no
    gain at the question's own rate."""

    def found(sigma: Fraction) -> bool:
        return design_impulsive(question.afresh().with_rate(sigma)) is not None

    high = max(capped_rate(question), question.rate)
    if found(high):
        return high
    low = question.rate
    if not found(low):
        return None
    while high - low > Fraction(_WIDTH) * high:
        middle = short(float(low + high) / 2, _RATE_DIGITS).rational or low
        if not low < middle < high:
            break
        low, high = (middle, high) if found(middle) else (low, middle)
    return low


def away_from_zero(question: Question) -> Question:
    """Where periods may be as short as one likes: from T_max / 8 on."""
    law = question.law
    if not law.from_zero or law.T_max.rational is None:
        return question
    return question.under(SamplingLaw("aperiodic", Exact(law.T_max.rational / 8), law.T_max))


def quietest(question: Question) -> Candidate | None:
    """Of the gains that reach half of the fastest proved rate the one that amplifies noise least: R = I, Q = 0, errors
    weighted by 1 / scale^2. Its certificate proves that rate; the merit is minus its root mean square."""
    if not is_small(question.inclusion) or question.law.is_updated:
        return None
    fastest = fastest_rate(question)
    if fastest is None:
        return None
    n, p = question.plant.n, question.plant.p
    sigma = max(fastest / 2, question.rate)
    aim = Aim(np.diag(scales(question) ** -2.0), np.eye(p), np.zeros((n, n)), float(sigma))
    return designed(question, aim, sigma)


def least_white_error(question: Question, weights: Sequence[float] | None = None) -> Candidate | None:
    """The gain of the least weighted mean square error over time, for the covariance and intensity declared.

    Where none is proved, or no disturbance keeps the gain from vanishing, a slow rate is kept too."""
    if not is_small(question.inclusion) or question.law.is_updated:
        return None
    R, Q = noise_floats(question.plant)
    if not (R.any() or Q.any()):
        return None
    Z = np.diag(scales(question) ** -2.0) if weights is None else np.diag(np.asarray(weights, dtype=float))
    floor = max(question.rate, short(log(100) / (_SLOW * float(question.law.T_max)), _RATE_DIGITS).rational or 0)
    for sigma in (question.rate, floor) if Q.any() else (floor,):
        candidate = designed(question, Aim(Z, R, Q, float(sigma)), question.rate)
        if candidate is not None:
            return candidate
    return None


def designed(question: Question, aim: Aim, sigma: Fraction) -> Candidate | None:
    """The gain that is best for the aim, rounded, and proved at a rate of about sigma; its merit is minus the aim's
    root mean square."""
    away = away_from_zero(question)
    met = best_gain(away.afresh(), aim)
    if met is None:
        return None
    K = ExactMatrix.from_floats(met[0], GAIN_DIGITS)
    if question.law.from_zero:
        K = kernel(question.plant.C).nearest(K)
    for part in _PARTS if sigma > question.rate else _PARTS[:1]:
        about = question.with_gain({"K": K}).with_rate(max(question.rate, sigma * part))
        method = GENERAL.propose(about.afresh())
        if method is not None:
            return Candidate(K, question.law, -met[1], method)
    return None
