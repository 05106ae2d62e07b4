"""The LMI search against known optima; homogeneous problems must be normalised to mean anything."""

from __future__ import annotations

import numpy as np
import pytest

from cdobs_cli.certify.lmi import Program, SparseColumns, ask_clarabel, full, solver_log, summary, symmetric
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


def test_a_panic_of_the_solver_is_no_solution() -> None:
    import clarabel

    beyond = SparseColumns(np.ones(3), np.array([0, 1, 7]), np.arange(4), (3, 3))  # a row that is not there
    with solver_log() as records:
        x, record = ask_clarabel(np.ones(3), beyond, np.ones(3), [clarabel.PSDTriangleConeT(2)])
    assert np.isnan(x).all()
    assert (record.status, record.iterations) == ("Panicked", 0)
    assert summary(records) == record
    with pytest.raises(Exception, match="dimensions"):  # what it refuses is our mistake, and is told
        ask_clarabel(np.ones(2), beyond, np.ones(3), [])


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
