"""Gains that let little noise through: at a rate, or for the noise and disturbance that are declared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from math import exp, inf, isfinite, log
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.ascent import highest
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.gains import Candidate, Merit
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import GAIN_DIGITS, design_impulsive, is_small
from cdobs_cli.certify.methods.mean_square import synthesis as mean_square
from cdobs_cli.certify.methods.mean_square.aim import Aim, weights_of
from cdobs_cli.certify.methods.peak import synthesis as peak
from cdobs_cli.certify.methods.rung import GENERAL, Rung
from cdobs_cli.certify.search import short
from cdobs_cli.certify.simplex import smallest
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# A value of a question's gain and its derivative by the gain's entries, (n, p); None where there is none.
Slope = Callable[[Question], "tuple[float, Array] | None"]

_WIDTH, _STEPS = 0.05, 8  # of the search for the fastest rate, half of which is asked for
_FEW_STATES = 4  # where each step of it costs little
_RATE_DIGITS = 6
_PARTS = (Fraction(1), Fraction(99, 100), Fraction(9, 10))  # of the rate kept, where less is left by rounding
_SLOW = 50  # periods in which the error falls to 1 % at least, where no disturbance keeps a gain from vanishing
_STEP = 0.05  # of a gain's entries
_ROOM = 400.0  # such steps
_SLOPE_DIGITS = 12
_LEAST_GAIN = 1e-4  # of a value, relative: what a descent ends at
_PARTS_OF_SLOW = (Fraction(1), Fraction(1, 4), Fraction(1, 16))
_SOLVES = (12, 36, 120, 400)  # of a descent, by effort: as many values of a mean square, fewer of n bounds


def capped_rate(question: Question) -> Fraction:
    """ln(100) / (n T_max): the error falls to 1 % in n periods. A dead beat is no goal."""
    return _rate(log(100) / (question.plant.n * float(question.law.T_max)))


def kept_rates(question: Question, disturbed: bool) -> tuple[Fraction, ...]:
    """Rates to be kept in a search for little error, the first that has a gain counts: the question's; but where no
    disturbance keeps a gain from vanishing one that is slow, ln(100) / (50 T_max), or a part of it."""
    slow = _rate(log(100) / (_SLOW * float(question.law.T_max)))
    parts = tuple(max(question.rate, part * slow) for part in _PARTS_OF_SLOW)
    return tuple(dict.fromkeys((question.rate, slow) if disturbed else (*parts, question.rate)))


def _rate(value: float) -> Fraction:
    return short(value, _RATE_DIGITS).rational or Fraction(0)


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
    for _ in range(_STEPS if question.plant.n <= _FEW_STATES else _STEPS // 2):
        middle = _rate(float(low + high) / 2)
        if high - low <= Fraction(_WIDTH) * high or not low < middle < high:
            break
        low, high = (middle, high) if found(middle) else (low, middle)
    return low


def away_from_zero(question: Question) -> Question:
    """Where periods may be as short as one likes: from T_max / 8 on."""
    law = question.law
    if not law.from_zero or law.T_max.rational is None:
        return question
    return question.under(SamplingLaw("aperiodic", Exact(law.T_max.rational / 8), law.T_max))


def takes(question: Question) -> bool:
    """Whether corners are few enough, and the law one of periods."""
    return is_small(question.inclusion) and question.law.is_bounded


def quietest(question: Question) -> Candidate | None:
    """The correction at samples that amplifies noise least, R = I, Q = 0, errors weighted by 1 / scale^2, of those that
    reach half of the fastest proved rate. Its certificate proves that rate; the merit is minus its root mean square."""
    fastest = fastest_rate(question) if takes(question) else None
    if fastest is None:
        return None
    sigma = max(fastest / 2, question.rate)
    return _designed(question, Aim.quiet(question, float(sigma)), sigma)


def least_error(
    question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None
) -> Candidate | None:
    """The correction at samples of the least error under what is declared: white signals, of the least mean square over
    time; bounded ones, of the least bounds, sum_i w_i b_i^2; then the merit, where there is one, is lowered step by
    step. At the question's rate at least."""
    if not takes(question):
        return None
    bounded = question.plant.has_only_bounded
    disturbed = (
        question.plant.disturbance is not None if bounded else bool(Aim.declared(question, weights, 0.0).Q.any())
    )
    search = _least_bounds if bounded else _least_mean_square
    for sigma in kept_rates(question, disturbed):
        start = search(question, weights, sigma)
        if start is not None:
            solves = question.plant.n if weights is None else sum(1 for weight in weights if weight)
            return start if merit is None else descended(question, "K", start, merit, GENERAL, sigma, solves)
    return None


def _least_mean_square(question: Question, weights: Sequence[float] | None, sigma: Fraction) -> Candidate | None:
    aim = Aim.declared(question, weights, float(sigma))
    return _designed(question, aim, question.rate) if aim.R.any() or aim.Q.any() else None


def _least_bounds(question: Question, weights: Sequence[float] | None, sigma: Fraction) -> Candidate | None:
    Z = np.diag(weights_of(question, weights))
    guess = peak.best_gain(away_from_zero(question).afresh(), Z, float(sigma))
    if guess is None:
        return None
    return proved(question, "K", corrected(question, guess.K), -float(np.sqrt(guess.size)), GENERAL, sigma)


def _designed(question: Question, aim: Aim, sigma: Fraction) -> Candidate | None:
    """The gain that is best for the aim, rounded, and proved at a rate of about sigma; its merit is minus the aim's
    root mean square."""
    met = mean_square.best_gain(away_from_zero(question).afresh(), aim)
    return None if met is None else proved(question, "K", corrected(question, met[0]), -met[1], GENERAL, sigma)


def corrected(question: Question, K: Array) -> ExactMatrix:
    """The gain rounded; from T_min = 0 on the nearest with C K = I."""
    rounded = ExactMatrix.from_floats(K, GAIN_DIGITS)
    return kernel(question.plant.C).nearest(rounded) if question.law.from_zero else rounded


def proved(
    question: Question, letter: str, gain: ExactMatrix, merit: float, rung: Rung, sigma: Fraction
) -> Candidate | None:
    """The gain with its certificate at a rate of about sigma, and at the question's at least."""
    for part in _PARTS if sigma > question.rate else _PARTS[:1]:
        about = question.with_gain({letter: gain}).with_rate(max(question.rate, sigma * part))
        method = rung.propose(about.afresh())
        if method is not None:
            return Candidate(gain, question.law, merit, method)
    return None


def descended(
    question: Question, letter: str, start: Candidate, value: Merit, rung: Rung, sigma: Fraction | None = None,
    solves: int = 1, slope: Slope | None = None,
) -> Candidate:  # fmt: skip
    """From a gain down the valley of a value, which is None where nothing is proved; what is met counts where its
    certificate is found at a rate of about sigma, the question's where it is not said. solves: semidefinite programs
    that a value takes. slope: value and derivative by the gain's entries, where it has one."""
    rate = question.rate if sigma is None else sigma
    round_off = _round_off(question, letter)

    def of(entries: Array) -> float:
        about = question.with_gain({letter: round_off(entries)}).afresh()
        met = value(about) if _may_decay(about, rate) else None
        return inf if met is None else met

    first, steps = _entries(question, letter, start.gain)
    if not len(first):
        return start
    budget = max(2 * (len(first) + 1), _SOLVES[question.level] // solves)
    if slope is None:
        entries, least = smallest(of, first, steps, budget)
    else:
        entries, least = _followed(question, letter, slope, first, steps, budget, rate)
    if least == inf:
        return start
    candidate = proved(question, letter, round_off(entries), -least, rung, rate)
    if candidate is not None:
        return candidate
    at_start = of(first)
    return start if at_start == inf else replace(start, merit=-at_start)


def _followed(
    question: Question, letter: str, slope: Slope, first: Array, steps: Array, budget: int, rate: Fraction
) -> tuple[Array, float]:
    """The entries of the least value met along its slopes, and the value."""
    rows = _free_rows(question, letter)

    def rise(x: Array) -> tuple[float, Array]:
        whole = np.zeros((question.plant.n, question.plant.p))
        whole[rows] = (first + steps * x).reshape(len(rows), -1)
        about = question.with_gain({letter: ExactMatrix.from_floats(whole, _SLOPE_DIGITS)})
        met = slope(replace(about, memory=question.memory)) if _may_decay(about, rate) else None
        if met is None or not met[0] > 0:
            return -inf, np.zeros(len(first))
        return -log(met[0]), -met[1][rows].reshape(-1) * steps / met[0]

    room = np.array([(-_ROOM, _ROOM)] * len(first))
    best, x = highest(rise, room, 1.0, budget, _LEAST_GAIN)
    return first + steps * x, exp(-best) if isfinite(best) else inf


def _may_decay(question: Question, rate: Fraction) -> bool:
    """Whether every constant corner decays at this rate under the longest period."""
    maps, T = question.inclusion.floats, float(question.law.T_max)
    flows = np.array(list(maps.corners())) * T
    if not np.all(np.isfinite(flows)):
        return False
    radii = np.array([spectral_radii(J @ exponentials(flows)) for J in maps.jumps()])
    return bool(np.all(radii <= np.exp(-float(rate) * T) * (1 + 1e-9)))


def _free_rows(question: Question, letter: str) -> list[int]:
    """Rows of the gain that are free: of a correction with C K = I those off the pivots."""
    tied = letter == "K" and question.law.from_zero
    return list(kernel(question.plant.C).others) if tied else list(range(question.plant.n))


def _entries(question: Question, letter: str, gain: ExactMatrix) -> tuple[Array, Array]:
    """The free entries of a gain, and first steps from them."""
    floats = gain.floats[_free_rows(question, letter)]
    steps = _STEP * np.maximum(np.abs(floats), 0.2 * np.abs(gain.floats).max())
    return floats.reshape(-1), steps.reshape(-1)


def _round_off(question: Question, letter: str) -> Callable[[Array], ExactMatrix]:
    plant, rows = question.plant, _free_rows(question, letter)

    def gain(entries: Array) -> ExactMatrix:
        whole = np.zeros((plant.n, plant.p))
        whole[rows] = entries.reshape(len(rows), plant.p)
        return corrected(question, whole) if letter == "K" else ExactMatrix.from_floats(whole, GAIN_DIGITS)

    return gain
