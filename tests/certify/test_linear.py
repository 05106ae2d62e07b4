import math
from fractions import Fraction

import numpy as np
import pytest
from asking import longest, proves
from example_inclusions import canonical, held, impulsive, periodic, plant

from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.certify.cover import covered
from cdobs_cli.certify.linear import _CELLS, _CLOSE, _falls, _prove, stable_interval, stable_intervals

ZERO = [[0, 0], [0, 0]]


def oscillator(T):
    return impulsive(plant([[0, 1], [-1, 0]], ZERO, ZERO, [[1, 0]], periodic(str(T))), [["1"], ["1.2"]])


def test_an_oscillator_loses_and_regains_stability():
    """rho = |cos T - 1.2 sin T|: |.| = 1 at T = k pi and at T = k pi + 2 atan(1 / 1.2)."""
    intervals = stable_intervals(oscillator("0.5"), 0.01, 8.0)
    turn = 2 * math.atan(1 / 1.2)
    assert len(intervals) == 3
    for k, interval in enumerate(intervals):
        assert float(interval.high) == pytest.approx(k * math.pi + turn, rel=3e-4)
        assert float(interval.high) < k * math.pi + turn
        assert float(interval.low) >= max(0.01, k * math.pi)
        for T in np.linspace(float(interval.low), float(interval.high), 50):
            assert abs(math.cos(T) - 1.2 * math.sin(T)) < 1
    near = stable_interval(oscillator("3.5"), 3.5, 0.01, 8.0)
    assert float(near.high) == pytest.approx(math.pi + turn, rel=3e-6) and float(near.low) > math.pi


def test_linear_brackets_are_narrow():
    """Neither end missing, at most 0.1 % apart, round the exact limit of the spectral radius."""
    for at, start in (
        (oscillator, "0.5"),
        (oscillator, "3.5"),
        (lambda T: impulsive(canonical([0, 0, 0], periodic(str(T))), [["1"], ["1.5"], ["0.5"]]), "0.3"),
        (lambda T: held(plant([[0, 1], [-2, -1]], ZERO, ZERO, [[1, 0]], periodic(str(T))), [["2"], ["1"]]), "0.2"),
    ):
        T, certificate = longest(at, start, 0)
        assert proves(at(T), certificate)
        lost, _ = smallest_refuted(at, T, 0)
        assert float(T) < float(lost) < 1.001 * float(T)


def test_a_loop_that_never_converges_has_no_interval():
    unstable = impulsive(plant([["0.1", 0], [0, -1]], ZERO, ZERO, [[0, 1]], periodic("1")), [["0"], ["1"]])
    assert stable_intervals(unstable, 0.01, 5.0) == []
    assert longest(lambda T: unstable, "1", 0) is None


@pytest.mark.parametrize(
    ("low", "high"), [("2.9", "4.9"), ("2.5", "4.4"), ("3.3", "4.6"), ("0.5", "4.5"), ("1.5", "3")]
)
def test_a_cover_leaves_no_period_out(low, high):
    """Stable between pi and pi + 1.39: unstable before and after, though the middle may be stable."""
    falls = _falls(oscillator("1"))
    assert not covered(falls, Fraction(low), Fraction(high), pieces=_CELLS)
    assert _prove(oscillator("1"), float(low), float(high), _CLOSE, _CELLS) is None
    assert covered(falls, Fraction("3.2"), Fraction("4.5"), pieces=_CELLS)
