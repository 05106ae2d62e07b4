import numpy as np
import pytest

from cdobs_cli.certify.sylvester import is_observable, residual, sylvester_rows
from cdobs_cli.exact.numbers import ExactMatrix


@pytest.mark.parametrize("p", [1, 2])
def test_rows_solve_the_sylvester_equation(p):
    rng = np.random.default_rng(p)
    A, C = rng.normal(size=(4, 4)), rng.normal(size=(p, 4))
    rates, G = np.array([-1.0, -2.5, -4.0])[: 4 - p], rng.normal(size=(4 - p, p))
    T = sylvester_rows(A, C, rates, G)
    assert T is not None and residual(A, C, T, rates, G) < 1e-12
    assert residual(A, C, T + 1e-3, rates, G) > 1e-6
    S = np.vstack([C, T])
    Q0 = S @ A @ np.linalg.inv(S)
    assert np.allclose(Q0[p:, p:], np.diag(rates))  # T A = Lambda T + G C: rows of C and T only


def test_an_eigenvalue_of_the_plant_is_no_rate():
    assert sylvester_rows(np.diag([-1.0, 2.0]), np.array([[1.0, 1.0]]), np.array([-1.0]), np.array([[1.0]])) is None


def test_observability_is_exact():
    A = ExactMatrix([[0, 1], [-1, 0]]).balls()
    assert is_observable(A, ExactMatrix([[1, 0]]).balls()) is True
    assert is_observable(ExactMatrix([[1, 0], [0, 1]]).balls(), ExactMatrix([[1, 0]]).balls()) is False
    assert is_observable(ExactMatrix([["sqrt(2)", 1], [0, 1]]).balls(), ExactMatrix([[1, 0]]).balls()) is True
    assert is_observable(ExactMatrix([["sqrt(2)", 0], [0, "sqrt(2)"]]).balls(), ExactMatrix([[1, 1]]).balls()) is None
