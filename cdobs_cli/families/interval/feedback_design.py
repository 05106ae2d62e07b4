"""K_lower = K_upper for a sampling law: candidates by the descriptor LMI of Theorem 2, the fastest of those proved."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import SimpleNamespace

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certify.floats import spectral_radii
from cdobs_cli.certify.lmi import Program, full
from cdobs_cli.certify.lmi import symmetric as symmetric_unknown
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.matrix import symmetric
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.held import held_maps
from cdobs_cli.families.interval.held_loop import HeldLoop
from cdobs_cli.families.interval.method import Gain, largest_margin
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import held_derivative, theorem_2_functional

_EPSILONS = (0.1, 0.3, 1.0, 3.0)
_DIGITS = 5


def feedback_design(question: Question) -> Gain | None:
    """K_lower = K_upper = K S^-1 / 2, proved for the question's law; None where none was found."""
    proved = [one for one in _candidates(question) if HeldLoop.propose(one) is not None]
    best = min(proved, key=_multiplier, default=None)
    return None if best is None else {name: best.inclusion.gain[name] for name in ("K_lower", "K_upper")}


def _candidates(question: Question) -> Iterator[Question]:
    plant, T, R = question.plant, float(question.law.T_max), System.of(question).floats.R
    assert plant.B is not None
    for epsilon in _EPSILONS:
        for unit in {1.0, max(T, 1e-9)}:
            # epsilon has the unit of time: tried in the plant's and in the sampling period's.
            K = descriptor_design(np.array(plant.A.floats), np.array(plant.B.floats), T, epsilon * unit)
            if K is not None:
                half = ExactMatrix.from_floats(K @ R / 2, _DIGITS)
                yield question.with_gain({**question.inclusion.gain, "K_lower": half, "K_upper": half})


def _multiplier(question: Question) -> float:
    """rho(F(T)) of the held loop at the largest period; infinite beyond floats."""
    A, closed = (M.floats for M in System.of(question).held_loop)
    maps = held_maps(A, closed - A, [float(question.law.T_max)])
    return np.inf if maps is None else max(float(spectral_radii(maps)[0]), 1e-12)


def descriptor_design(A: Array, B: Array, Tbar: float, epsilon: float) -> Array | None:
    """K = Y Q^-1 of the held loop xdot = A x + B K x(t_k), T_k <= Tbar, by a convex LMI for fixed epsilon:
    Theorem 2's conditions with P_3 = epsilon P_2, Q = P_2^-1, and every unknown transformed by Q.

        Omega_11 = A Q + Q' A' - Y_1 - Y_1',  Omega_12 = P - Q + epsilon Q' A' - Y_2,  Omega_13 = Y_1' + B Y - R,
        Omega_22 = -epsilon (Q + Q'),  Omega_23 = Y_2' + epsilon B Y,  Omega_33 = R + R'

    Source: Efimov2016, Theorem 2
    """
    n, m = B.shape
    unknowns = {name: symmetric_unknown(n) for name in ("P", "U")}
    unknowns |= {name: full(n, n) for name in ("Q", "X", "X_1", "Y_1", "Y_2", "R")}
    program = Program({**unknowns, "Y": full(m, n), "t": full(1, 1)})

    def derivative(x: Mapping[str, Array], corner: int) -> Array:
        Q, Y_1, Y_2, R, BY = x["Q"], x["Y_1"], x["Y_2"], x["R"], B @ x["Y"]
        Omega = {
            (1, 1): symmetric(A @ Q - Y_1), (1, 2): x["P"] - Q + epsilon * Q.T @ A.T - Y_2, (1, 3): Y_1.T + BY - R,
            (2, 2): -epsilon * symmetric(Q), (2, 3): Y_2.T + epsilon * BY, (3, 3): symmetric(R),
        }  # fmt: skip
        M = np.block(held_derivative(Omega, SimpleNamespace(**x), Tbar, corner))
        return -M - np.eye(len(M)) * x["t"]

    program.require(lambda x: theorem_2_functional(SimpleNamespace(**x), Tbar) - np.eye(2 * n) * x["t"])
    program.require(lambda x: derivative(x, 0))
    program.require(lambda x: derivative(x, 1))
    program.require(lambda x: x["P"] - np.eye(n) * x["t"])
    program.require(lambda x: np.eye(n) * n - symmetric(x["Q"]) / 2)
    program.equate(lambda x: np.trace(x["P"]) - n)
    values = largest_margin(program)
    if values is None:
        return None
    try:
        K: Array = values["Y"] @ np.linalg.inv(values["Q"])
    except np.linalg.LinAlgError:
        return None
    return K if np.all(np.isfinite(K)) else None
