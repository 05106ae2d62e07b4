"""A copy of the model with a constant gain at a constant period: no proof, poles placed on the linearised plant."""

from __future__ import annotations

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.baselines.poles import placed
from cdobs_cli.exact.expression import Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant, weighted

PREFIX = "hat."


def placed_gain(A: Array, C: Array, period: float, radius: float) -> ExactMatrix:
    """K (n, 1) with all eigenvalues of (I - K C) exp(A period) at `radius`, by Ackermann's formula. A (n, n), C (1, n).

    Raises: ValueError where the pair cannot be observed at this period.
    """
    from scipy.linalg import expm

    Phi: Array = np.array(expm(A * period), dtype=np.float64)
    # (I - K C) Phi is similar to Phi (I - K C): an observer in filter form, its gain is Phi^-1 times the predictor's.
    predictor = placed(Phi, C, radius)
    return ExactMatrix.from_floats(_solved(Phi, predictor), 12)


def _solved(M: Array, right: Array) -> Array:
    found: Array = np.linalg.solve(M, right).astype(np.float64)
    return found


def constant_gain(plant: Plant, K: ExactMatrix) -> Observer:
    """x_hat' = A x_hat + phi(x_hat, u) + B u,  x_hat+ = x_hat + K (y - C x_hat). K (n, p)."""
    hat = tuple(PREFIX + name for name in plant.states)
    innovation = [Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs(PREFIX))]
    jump = [sum(weighted(K, i, innovation), Variable(name)) for i, name in enumerate(hat)]
    start, x_hat = (tuple(Variable(prefix + name) for name in plant.states) for prefix in ("initial.", PREFIX))
    return Observer(hat, start, plant.right_hand_side(PREFIX), tuple(jump), {"x_hat": x_hat})
