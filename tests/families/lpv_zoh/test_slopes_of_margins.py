"""Derivatives of margins from multipliers, against differences of solved margins; and what ascents on them reach."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from lpv_asking import asked
from lpv_plants import family, linear_class, sine, up_to

from cdobs_cli.certify.ascent import Ascent, Height, end
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.clock.slope import slope
from cdobs_cli.certify.methods.peak import from_zero_search
from cdobs_cli.certify.methods.peak.from_zero import PeakFromZero
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh.gains import PeriodAscent
from cdobs_cli.plant import Box
from cdobs_cli.sampling import SamplingLaw

RATE = Fraction(1, 20)
STEP = 1e-4
LAWS = {
    "from zero": (up_to("1.2"), Shape(3, 4, 0, 2)),
    "an interval": (SamplingLaw("aperiodic", Exact("0.3"), Exact("1.2")), Shape(3, 4, 1, 2)),
    "periodic": (SamplingLaw.periodic(Exact("1.2")), Shape(3, 4, 2, 0)),
}


def difference(value, step: float = STEP) -> float:
    return (value(step) - value(-step)) / (2 * step)


@pytest.mark.parametrize("name", LAWS)
def test_the_slopes_of_the_clock_margin(name):
    law, shape = LAWS[name]
    L = np.array([[1.0], [0.35]])
    question = asked(sine(law), ExactMatrix.from_floats(L, 9), "1.2").with_rate(RATE)
    met = slope(question, shape, "L")

    def margin(about: Question) -> float:
        return slope(about.afresh(), shape).margin

    for i in range(2):
        unit = np.eye(2)[:, [i]]
        by_gain = difference(
            lambda d, unit=unit: margin(question.with_gain({"L": ExactMatrix.from_floats(L + d * unit, 12)}))
        )
        assert met.by_gain[i, 0] == pytest.approx(by_gain, rel=2e-3, abs=1e-5)
    by_period = difference(lambda d: margin(question.at(Exact(repr(1.2 + d)))))
    assert met.by_period == pytest.approx(by_period, rel=2e-3, abs=1e-5)
    by_rate = difference(lambda d: margin(question.with_rate(RATE + Fraction(d))))
    assert met.by_rate == pytest.approx(by_rate, rel=2e-3, abs=1e-5)


def test_the_slopes_where_corners_are_cuts():
    """Eight corners, of which some are never imposed."""
    slopes = {(1, 0): ("-0.3", "0.3"), (2, 0): ("-0.2", "0.2"), (2, 1): ("-0.1", "0.1")}
    plant = linear_class([["0", "1", "0"], ["0", "0", "1"], ["0", "0", "0"]], [["1", "0", "0"]], slopes, up_to("0.5"))
    L = np.array([[2.5], [2.0], [0.5]])
    question, shape = asked(plant, ExactMatrix.from_floats(L, 9), "0.5"), Shape(3, 4, 0, 2)
    met = slope(question, shape, "L")
    along = np.array([[0.5], [1.0], [-0.7]])
    moved = difference(
        lambda d: slope(question.with_gain({"L": ExactMatrix.from_floats(L + d * along, 12)}).afresh(), shape).margin
    )
    assert float(np.sum(met.by_gain * along)) == pytest.approx(moved, rel=0.02, abs=1e-6)


def test_the_slopes_of_the_convex_synthesis():
    synthesis, at = HeldSynthesis(sine()), (0.7, 0.2, 1.1)
    _, moved = synthesis._solved(*at)
    for i in range(3):
        there = [tuple(value * (1 + sign * STEP * (k == i)) for k, value in enumerate(at)) for sign in (1, -1)]
        solved = (synthesis._solved(*there[0])[0].margin - synthesis._solved(*there[1])[0].margin) / 2
        assert (moved(*there[0]) - moved(*there[1])) / 2 == pytest.approx(solved, rel=2e-3, abs=1e-9)


def test_the_slope_of_an_error_bound_by_sigma(monkeypatch):
    noisy = replace(sine(up_to("0.5")), noise=Box((Exact("-0.1"),), (Exact("0.1"),)))
    question = asked(noisy, ExactMatrix([["1.3"], ["0.5"]]), "0.5").of_state(1)
    seen = []

    def scanned(search, rate, question):
        for sigma in (0.2 * rate, 0.5 * rate):
            here, above, below = (search.least(sigma * part) for part in (1, 1 + 1e-3, 1 - 1e-3))
            seen.append((here.slope, np.log(above.bound / below.bound) / np.log((1 + 1e-3) / (1 - 1e-3))))

    monkeypatch.setattr(from_zero_search, "_scanned", scanned)
    PeakFromZero.error_guess(question)
    assert len(seen) == 2
    for told, solved in seen:
        assert told == pytest.approx(solved, rel=5e-3, abs=1e-4)


def test_an_end_that_is_flat_inside_and_steep_outside():
    asked_at = []

    def margin(v: float) -> Height:
        asked_at.append(v)
        return Height(0.01 - 1e-3 * v, np.zeros(0), -1e-3) if v < 2 else Height(0.008 - 5 * (v - 2), np.zeros(0), -5.0)

    v = end(margin, 0.5, 1e-4, 1.0)
    assert 2.0016 * (1 - 1e-4) <= v < 2.0016
    assert len(asked_at) < 16
    assert end(lambda v: Height(-1.0, np.zeros(0), -0.1), 1.0, 1e-3, 1.0, least=0.01) is None


def test_an_ascent_of_a_curved_ridge():
    """ln v* = -(x - 1)^2 - 10 (y - x^2)^2."""

    def height(x, v):
        a, b = x[0] - 1, x[1] - x[0] ** 2
        top = -(a**2) - 10 * b**2
        gradient = np.array([-2 * a + 40 * b * x[0], -20 * b])
        return Height(top - np.log(v), gradient, -1 / v)

    x, v = Ascent(height, np.ones(2), 1e-6, 200).run(np.array([-0.5, 0.5]), 0.3)
    assert x == pytest.approx([1, 1], abs=1e-2) and v == pytest.approx(1, abs=1e-4)


def test_the_longest_period_of_the_plant_of_boukal_is_not_shorter_than_pattern_search_found():
    question = family(objective="max_period").question(sine(up_to("1.5")), {}, 1)
    found = PeriodAscent().longest(question)
    assert float(found.law.T_max) >= 1.726198
    assert found == PeriodAscent().longest(question)
