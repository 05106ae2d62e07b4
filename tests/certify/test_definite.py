"""Definiteness: proved exactly when it is true with room, never for a singular or indefinite matrix."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st

from cdobs_cli.certify.definite import eigenvalue_range, positive_definite
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10**6), st.sampled_from([1e-6, 1.0, 1e6]))
def test_against_eigenvalues(size: int, seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    eigenvalues = rng.uniform(-1, 1, size)
    M = (Q * eigenvalues * scale) @ Q.T
    M = (M + M.T) / 2
    smallest = np.linalg.eigvalsh(M)[0]
    found = positive_definite(Matrix.from_floats(M))
    if smallest < 0:
        assert not found.proved
    elif smallest > 1e-6 * scale:
        assert found.proved
        assert found.margin is not None
        assert 0 < found.margin <= Fraction(smallest * (1 + 1e-9))


def test_singular_is_never_proved() -> None:
    assert not positive_definite(Matrix.from_rows([[1, 1], [1, 1]])).proved
    assert not positive_definite(Matrix.zeros(3, 3)).proved


def test_the_margin_is_strict_even_where_it_is_tiny() -> None:
    tiny = Fraction(1, 10**40)
    assert positive_definite(Matrix.from_rows([[1, 1], [1, 1 + tiny]])).proved
    assert not positive_definite(Matrix.from_rows([[1, 1], [1, 1 - tiny]])).proved


def test_balls_that_hold_a_singular_matrix_are_open() -> None:
    assert not positive_definite(Matrix.from_rows([[arb(1, 0.5), 0], [0, arb(0, 1e-30)]])).proved
    assert not positive_definite(Matrix.from_rows([[arb("nan"), 0], [0, 1]])).proved


def test_eigenvalue_ranges_hold_the_eigenvalues():
    random = np.random.default_rng(3)
    for _ in range(20):
        raw = random.normal(size=(4, 4))
        M = ExactMatrix.from_floats(raw + raw.T, 6)
        smallest, largest = (eigenvalue_range(M.balls(), smallest=which) for which in (True, False))
        values = np.linalg.eigvalsh(M.floats)
        assert float(smallest.low) - 1e-12 <= values[0] <= float(smallest.high) + 1e-12
        assert float(largest.low) - 1e-12 <= values[-1] <= float(largest.high) + 1e-12
        assert float(smallest.high) - float(smallest.low) < 1e-6
