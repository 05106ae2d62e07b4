from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.polynomial import Polynomial

from cdobs_cli.certify.bernstein import derivative, elevation, restriction


def value(coefficients, s):
    """de Casteljau."""
    points = list(coefficients)
    while len(points) > 1:
        points = [(1 - s) * a + s * b for a, b in pairwise(points)]
    return points[0]


def test_elevation_keeps_the_polynomial_and_derivative_differentiates_it():
    rng = np.random.default_rng(0)
    for d in (1, 2, 4, 6):
        coefficients = rng.standard_normal(d + 1)
        power = Polynomial.fit(np.linspace(0, 1, d + 1), [value(coefficients, s) for s in np.linspace(0, 1, d + 1)], d)
        for D in (d, d + 1, d + 3):
            raised = np.array(elevation(d, D), dtype=float) @ coefficients
            slope = np.array(derivative(d, D), dtype=float) @ coefficients
            for s in (0.0, 0.3, 0.8, 1.0):
                assert np.isclose(value(raised, s), power(s))
                assert np.isclose(value(slope, s), power.deriv()(s))


def test_restriction_keeps_the_polynomial_on_a_part():
    coefficients = np.random.default_rng(1).standard_normal(5)
    for start, end in ((0, 1), (0, "1/3"), ("1/3", "1/2"), ("3/4", 1)):
        low, high = Fraction(start), Fraction(end)
        part = np.array(restriction(4, low, high), dtype=float) @ coefficients
        for s in (0.0, 0.3, 1.0):
            assert np.isclose(value(part, s), value(coefficients, float(low) + s * float(high - low)))
