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

    # (I - K C) Phi is similar to Phi (I - K C), the loop of a predictor.
    predictor = placed(np.array(expm(A * period), dtype=np.float64), C, radius)
    return ExactMatrix.from_floats(filter_gain(A, predictor, period), 12)


def filter_gain(A: Array, predictor: Array, period: float) -> Array:
    """K (n, p) of the observer that corrects at samples, from the gain exp(A period) K (n, p) of a predictor."""
    from scipy.linalg import expm

    K: Array = np.linalg.solve(expm(A * period), predictor).astype(np.float64)
    return K


def constant_gain(plant: Plant, K: ExactMatrix) -> Observer:
    """x_hat' = A x_hat + phi(x_hat, u) + B u,  x_hat+ = x_hat + K (y - C x_hat). K (n, p)."""
    hat = tuple(PREFIX + name for name in plant.states)
    innovation = [Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs(PREFIX))]
    jump = [sum(weighted(K, i, innovation), Variable(name)) for i, name in enumerate(hat)]
    start, x_hat = (tuple(Variable(prefix + name) for name in plant.states) for prefix in ("initial.", PREFIX))
    return Observer(hat, start, plant.right_hand_side(PREFIX), tuple(jump), {"x_hat": x_hat})
