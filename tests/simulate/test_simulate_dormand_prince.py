"""The step and its dense output: coefficients, observed orders, floats against arrays."""

import math

import numpy as np
import pytest
from scipy.integrate import DOP853

from cdobs_cli.simulate import dormand_prince as tableau
from cdobs_cli.simulate.dormand_prince import (
    array_step,
    dense_output,
    interpolate,
    interpolate_one,
    next_step,
    scalar_dense_output,
    scalar_step,
)  # fmt: skip

FLOOR = (1e-12, 1e-12)


def flow(t, x, y):
    """x' = y, y' = -x + t: x = cos t + t has x'' = -x + t."""
    return y, -x + t


def exact(t):
    return np.array([math.cos(t) + t, 1 - math.sin(t)])


def slope(t, z, held=None, out=None):
    value = np.array(flow(t, *z))
    if out is not None:
        out[:] = value
    return value


def one_step(t, h):
    y = tuple(exact(t))
    return y, *scalar_step(flow, 2)(t, h, y, flow(t, *y), (), FLOOR)


def test_coefficients_agree_with_an_independent_copy():
    rows = [*tableau.A[:12], tableau.A[12]]
    for s in range(12):
        assert np.array_equal(DOP853.A[s, :s], np.array(rows[s]))
    assert np.array_equal(DOP853.B, np.array(rows[12]))
    for name in ("C", "E5", "E3", "D", "C_EXTRA"):
        assert np.array_equal(getattr(DOP853, name), np.array(getattr(tableau, name)))
    for s in range(3):
        assert np.array_equal(DOP853.A_EXTRA[s, : 13 + s], np.array(tableau.A_EXTRA[s]))


def test_the_order_conditions_that_rows_must_meet():
    for s, row in enumerate(tableau.A[:12]):
        assert sum(row) == pytest.approx(tableau.C[s], abs=1e-13)
    for k in range(8):
        assert sum(b * c**k for b, c in zip(tableau.A[12], tableau.C, strict=True)) == pytest.approx(
            1 / (k + 1), abs=1e-13
        )


def test_the_step_has_order_8_and_its_dense_output_order_7():
    errors, dense_errors = [], []
    for h in (1.0, 0.5):
        y, new, _, _, slopes = one_step(0.3, h)
        errors.append(np.abs(np.array(new) - exact(0.3 + h)).max())
        coefficients = np.array(scalar_dense_output(flow, 2)(0.3, h, y, new, slopes, ()))
        thetas = np.linspace(0, 1, 21)
        inside = interpolate_one(coefficients, np.array(y), thetas)
        dense_errors.append(np.abs(inside - np.array([exact(0.3 + h * theta) for theta in thetas]).T).max())
    assert 8.5 < math.log2(errors[0] / errors[1]) < 10.5  # local error: order + 1
    assert 7.5 < math.log2(dense_errors[0] / dense_errors[1]) < 9.5


def test_floats_and_arrays_take_the_same_step():
    h = np.array([0.4, 0.7, 0.1])
    t = np.array([0.0, 0.5, 2.0])
    y = np.array([exact(time) for time in t]).T
    floor = np.full((2, 3), 1e-12)
    new, last, error, slopes = array_step(slope, t, h, y, slope(t, y), np.empty((0, 3)), floor)
    coefficients = dense_output(slope, t, h, y, new, slopes[tableau.READ], np.empty((0, 3)))
    for run in range(3):
        own, own_new, own_last, own_error, own_slopes = one_step(float(t[run]), float(h[run]))
        assert new[:, run] == pytest.approx(own_new, rel=1e-14)
        assert last[:, run] == pytest.approx(own_last, rel=1e-13, abs=1e-14)
        assert error[run] == pytest.approx(own_error, rel=1e-2, abs=1e-5)
        own_coefficients = np.array(scalar_dense_output(flow, 2)(t[run], h[run], own, own_new, own_slopes, ()))
        assert coefficients[:, :, run] == pytest.approx(own_coefficients, abs=1e-12)
        halfway = interpolate(coefficients, y, 0.3)[:, run]
        assert halfway == pytest.approx(
            interpolate_one(own_coefficients, np.array(own), np.array([0.3]))[:, 0], abs=1e-14
        )


def test_the_next_step_is_bounded_both_ways():
    assert next_step(0.0) == 6.0
    assert next_step(1.0) == 0.9
    assert next_step(float("nan")) == next_step(float("inf")) == 0.2
