"""The LMI search against known optima; homogeneous problems must be normalised to mean anything."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from command import ROOT

from cdobs_cli.certify.lmi import Program, full, symmetric
from cdobs_cli.exact.matrix import block


def lyapunov_margin(A: np.ndarray) -> float:
    program = Program({"P": symmetric(2), "t": full(1, 1)})
    program.require(lambda x: -(A.T @ x["P"] + x["P"] @ A) - x["t"] * np.eye(2))
    program.require(lambda x: x["P"] - x["t"] * np.eye(2))
    program.equate(lambda x: np.trace(x["P"]) - 1)
    program.maximise(lambda x: x["t"])
    solution = program.solve()
    assert solution.solved
    return float(solution.values["t"][0, 0])


def test_the_margin_tells_stability_where_it_is_large() -> None:
    assert lyapunov_margin(np.array([[0.0, 1.0], [-2.0, -0.5]])) > 0.1
    # An unstable matrix has margin 0, not a negative one: a singular P is allowed. Only a proof tells them apart.
    assert abs(lyapunov_margin(np.array([[0.0, 1.0], [2.0, -0.5]]))) < 1e-6


def test_equalities_and_full_unknowns() -> None:
    # smallest spectral norm of a matrix with a given entry
    program = Program({"X": full(2, 3), "s": full(1, 1)})
    program.require(lambda x: np.block([[x["s"] * np.eye(2), x["X"]], [x["X"].T, x["s"] * np.eye(3)]]))
    program.equate(lambda x: x["X"][:1, :1] - 2)
    program.maximise(lambda x: -x["s"])
    solution = program.solve()
    assert solution.objective == pytest.approx(-2, abs=1e-6)


def test_infeasible_is_not_solved() -> None:
    program = Program({"x": full(1, 1)})
    program.require(lambda x: x["x"] - 1)
    program.require(lambda x: -x["x"] - 1)
    program.maximise(lambda x: x["x"])
    assert not program.solve().solved


def test_a_modelling_layer_agrees() -> None:
    """The same inequality, a pure function, read by evaluation and by cvxpy."""
    import cvxpy

    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -3.0, -2.0]])

    def lyapunov(P, t):
        return -(A.T @ P + P @ A) - t * np.eye(3)

    program = Program({"P": symmetric(3), "t": full(1, 1)})
    program.require(lambda x: lyapunov(x["P"], x["t"]))
    program.require(lambda x: x["P"] - x["t"] * np.eye(3))
    program.equate(lambda x: np.trace(x["P"]) - 1)
    program.maximise(lambda x: x["t"])
    P, t = cvxpy.Variable((3, 3), symmetric=True), cvxpy.Variable()
    constraints = [lyapunov(P, t) >> 0, P - t * np.eye(3) >> 0, cvxpy.trace(P) == 1]
    problem = cvxpy.Problem(cvxpy.Maximize(t), constraints)
    problem.solve(solver=cvxpy.SCS, eps=1e-8)
    assert program.solve().objective == pytest.approx(problem.value, abs=1e-5)
    assert problem.value > 0.01


def test_block_serves_every_arithmetic() -> None:
    """The least s with [[s I, X], [X', s I]] >= 0 is the largest singular value, by both ways."""
    import cvxpy

    X = np.array([[1.0, 2.0], [0.5, -1.0]])

    def schur(s):
        return block([[s * np.eye(2), X], [X.T, s * np.eye(2)]])

    program = Program({"s": full(1, 1)})
    program.require(lambda x: schur(x["s"]))
    program.maximise(lambda x: -x["s"])
    s = cvxpy.Variable((1, 1))
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.trace(s)), [schur(s) >> 0])
    problem.solve(solver=cvxpy.SCS, eps=1e-8)
    largest = np.linalg.svd(X)[1][0]
    assert -program.solve().objective == pytest.approx(largest, abs=1e-6)
    assert problem.value == pytest.approx(largest, abs=1e-5)


def test_the_solver_needs_no_more_of_scipy_than_its_lapack_and_the_rest_can_be_loaded_after() -> None:
    told = """
import sys
import numpy as np
from cdobs_cli.certify.lmi import Program, full
program = Program({"t": full(1, 1)})
program.require(lambda x: np.diag([2.0, 3.0]) - x["t"] * np.eye(2))
program.maximise(lambda x: x["t"])
before = float(program.solve().values["t"][0, 0])
print("scipy.linalg" in sys.modules, "scipy.linalg.cython_lapack" in sys.modules)
import scipy.linalg
import scipy.optimize
after = float(program.solve().values["t"][0, 0])
print(before == after, scipy.linalg.solve(np.diag([2.0, 4.0]), np.ones(2)), scipy.optimize.linprog([1], [[-1]], [-1]).x)
"""
    done = subprocess.run([sys.executable, "-c", told], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["False True", "True [0.5  0.25] [1.]"]
