"""Exact matrices against numpy, and the one code for all arithmetics."""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb

from cdobs_cli.exact.matrix import Matrix, block, symmetric


def lyapunov(A, P, L):
    return block([[-symmetric(A.T @ P) * 2, P @ L], [L.T @ P, P[0:1, 0:1] - P[1:2, 1:2]]])


def test_one_function_two_arithmetics() -> None:
    rng = np.random.default_rng(0)
    A, P, L = rng.normal(size=(2, 2)), np.eye(2) + 0.1, rng.normal(size=(2, 1))
    exact = lyapunov(*(Matrix.from_floats(M) for M in (A, P, L)))
    assert exact.is_rational
    assert np.allclose(exact.floats, lyapunov(A, P, L))


def test_exponential_inverse_and_solve() -> None:
    M = Matrix.from_rows([[0, 1], [-1, 0]])
    E = M.exp(arb.pi())
    assert np.allclose(E.floats, -np.eye(2))
    assert np.allclose((M.inverse() @ M).floats, np.eye(2))
    assert np.allclose(M.solve(Matrix.from_rows([[1], [2]])).floats, [[-2], [1]])
    with pytest.raises(ZeroDivisionError):
        Matrix.zeros(2, 2).inverse()


def test_rationals_stay_rational_and_mix_with_balls() -> None:
    R, B = Matrix.from_rows([[1, 2], [3, 4]]), Matrix.from_rows([[arb.pi(), 0], [0, 1]])
    assert (R @ R.T - R).is_rational
    assert not (R @ B).is_rational
    assert not (R * arb.pi()).is_rational
    assert R[[1, 0], 0].tolist() == [[3], [1]]
    assert R[-1, -1] == 4
