from fractions import Fraction

import numpy as np
import pytest

from cdobs_cli.certify.ball import (
    has_spectral_radius_at_least,
    has_spectral_radius_below,
    spectral_radius_lower,
    spectral_radius_upper,
)
from cdobs_cli.exact.matrix import Matrix


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_enclosures_hold_the_spectral_radius(size):
    rng = np.random.default_rng(size)
    for _ in range(20):
        array = rng.standard_normal((size, size))
        rho = abs(np.linalg.eigvals(array)).max()
        M = Matrix.from_floats(array)
        assert float(spectral_radius_lower(M)) == pytest.approx(rho, rel=1e-9)
        assert rho <= float(spectral_radius_upper(M)) * (1 + 1e-12) <= 1.05 * rho
        near = Fraction(float(rho))
        assert has_spectral_radius_at_least(M / (near * Fraction(999999, 1000000)))
        assert not has_spectral_radius_below(M / (near * Fraction(999999, 1000000)))
        assert has_spectral_radius_below(M / (near * Fraction(1000001, 1000000)))
        assert not has_spectral_radius_at_least(M / (near * Fraction(1000001, 1000000)))


def test_limits_of_rational_matrices_are_decided_exactly():
    jordan = Matrix.from_rows([[1, 1], [0, 1]])
    rotation = Matrix.from_rows([[0, 1], [-1, 0]])
    flip = Matrix.from_rows([[-1, 5, 0], [0, 0, 0], [0, 0, Fraction(1, 2)]])
    for M in (jordan, rotation, flip):
        assert has_spectral_radius_at_least(M)
        assert not has_spectral_radius_below(M)
        assert not has_spectral_radius_at_least(M * Fraction(999, 1000))
        assert has_spectral_radius_below(M * Fraction(999, 1000))


def test_unbounded_entries_prove_nothing():
    M = Matrix.from_rows([[1, 0], [0, 1]]).balls() / Matrix.from_rows([[0]]).balls()[0, 0]
    assert not has_spectral_radius_at_least(M)
    assert not has_spectral_radius_below(M)
