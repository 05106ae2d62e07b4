"""Theorem III.2: delta_star, and the box (31) against random slope histories."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from flint import arb
from reachability_brute import histories
from reachability_plants import chain, symmetric_chain

from cdobs_cli.families.reachability.canonical import LastRow, box_31, delta_star, holds_until, last_row


def star(lo, hi):
    return delta_star(LastRow(tuple(Fraction(v) for v in lo), tuple(Fraction(v) for v in hi)))


@pytest.mark.parametrize(
    ("c", "value"),
    [
        ((1, 0), math.pi / 2),  # the paper's pendulum, where it prints the sufficient sqrt(3) - 1
        ((1, 1), 2 * math.pi / (3 * math.sqrt(3))),
        ((4, 0), math.pi / 4),
        ((Fraction(1, 10**6), 0), 1000 * math.pi / 2),
        ((10**6, 0), math.pi / 2000),
    ],
)
def test_delta_star_is_enclosed(c, value):
    limit = star([-v for v in c], c)
    assert float((limit.upper() - limit.lower()) / limit.mid()) < 1e-14
    assert float(limit.mid()) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("c", [(0, 1), (0, 0, 5), (7,)])
def test_delta_star_is_infinite_without_slopes_below_the_last(c):
    assert not star([-v for v in c], c).is_finite()


def test_delta_star_is_finite_as_soon_as_one_slope_below_the_last_is_not_zero():
    assert star((Fraction(-1, 10**6), 0, -1), (Fraction(1, 10**6), 0, 1)).is_finite()


@pytest.mark.parametrize("c", [(1, 0), (1, 1), (1, 2, 1, 0), (1,) * 8, (0, 1, 0)])
def test_the_limit_of_the_box_is_sharp(c):
    row = LastRow(tuple(Fraction(-v) for v in c), tuple(Fraction(v) for v in c))
    limit = delta_star(row).mid()
    assert holds_until(row, limit * arb("0.999999"))
    assert not holds_until(row, limit * arb("1.000001"))


def test_beyond_delta_star_the_box_misses_a_slope_history():
    # At 1.2 delta_star a bang-bang V leaves the box that the formula gives: the bound is not an artefact.
    plant, delta = symmetric_chain((1, 0), 1), 1.2 * math.pi / 2
    box = box_31(last_row(plant), arb(delta))
    Phi = histories(plant, delta, 3000, seed=3)
    assert np.max(box.lower.floats - Phi) > 1e-3


@pytest.mark.parametrize(
    ("lo", "hi"),
    [
        ((-1, 0), (1, 0)),
        ((-1, -1), (1, 1)),
        ((-2, 0), (1, 3)),
        ((0, -3), (2, 0)),
        ((-1, -1, -1), (1, 1, 1)),
        ((-3, 0, -1), (0, 2, 0)),
        ((-1, -2, 0, -1), (2, 0, 1, 1)),
        ((0, -1, -1, -1), (1, 1, 0, 2)),
    ],
)
def test_the_box_holds_every_history_up_to_its_limit(lo, hi):
    plant = chain(lo, hi, 1)
    row = last_row(plant)
    limit = delta_star(row)
    delta = min(2.0, float(limit.lower()) if limit.is_finite() else 2.0)
    box = box_31(row, arb(delta))
    Phi = histories(plant, delta, 400)
    assert np.all(Phi <= box.upper.floats + 1e-9)
    assert np.all(Phi >= box.lower.floats - 1e-9)


def test_both_ends_are_attained_for_the_pendulum():
    box = box_31(last_row(symmetric_chain((1, 0), 1)), arb("0.6"))
    c, s, ch, sh = math.cos(0.6), math.sin(0.6), math.cosh(0.6), math.sinh(0.6)
    assert box.lower.floats == pytest.approx(np.array([[c, s], [-s, c]]), abs=1e-15)
    assert box.upper.floats == pytest.approx(np.array([[ch, sh], [sh, ch]]), abs=1e-15)


def test_time_scaling_moves_the_box_with_the_states():
    # Slopes c_k w^(n-k+1) at delta / w is the same system in other units of time.
    w, c = 3, (1, Fraction(1, 2), Fraction(1, 4))
    scaled = tuple(value * w ** (3 - k) for k, value in enumerate(c))
    one = box_31(last_row(symmetric_chain(c, 1)), arb(1)).upper.floats
    two = box_31(last_row(symmetric_chain(scaled, 1)), arb(1) / w).upper.floats
    s = float(w) ** np.arange(3)
    assert two == pytest.approx(one * s[:, None] / s, rel=1e-12)


def test_a_last_row_that_misses_zero_is_enlarged_to_it():
    row = last_row(chain((1, 0), (2, 0), 1, last=(0, -1)))
    assert row.lo == (0, -1)
    assert row.hi == (2, 0)
