"""A copy of the model with a constant gain at a constant period: no proof, poles placed on the linear part."""

from __future__ import annotations

import numpy as np

from cdobs_cli.exact.expression import Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant, weighted

PREFIX = "hat."


def placed_gain(plant: Plant, period: float, radius: float) -> ExactMatrix:
    """K with all eigenvalues of (I - K C) exp(A period) at `radius`, by Ackermann's formula; one output. Shape (n, 1).

    Raises: ValueError where the pair cannot be observed at this period.
    """
    from scipy.linalg import expm

    n = plant.n
    Phi = expm(np.array(plant.A.floats) * period)
    C = np.array(plant.C.floats)
    observability = np.vstack([C @ np.linalg.matrix_power(Phi, k) for k in range(n)])
    if plant.p != 1 or np.linalg.cond(observability) > 1e14:
        raise ValueError("poles are placed for one output that observes the linear part at this period")
    wanted = np.linalg.matrix_power(Phi - radius * np.eye(n), n)
    # (I - K C) Phi is similar to Phi (I - K C): an observer in filter form, its gain is Phi^-1 times the predictor's.
    predictor = wanted @ np.linalg.solve(observability, np.eye(n)[:, [-1]])
    return ExactMatrix.from_floats(np.linalg.solve(Phi, predictor), 12)


def constant_gain(plant: Plant, K: ExactMatrix) -> Observer:
    """x_hat' = A x_hat + phi(x_hat, u) + B u,  x_hat+ = x_hat + K (y - C x_hat). K (n, p)."""
    hat = tuple(PREFIX + name for name in plant.states)
    innovation = [Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs(PREFIX))]
    jump = [sum(weighted(K, i, innovation), Variable(name)) for i, name in enumerate(hat)]
    start, x_hat = (tuple(Variable(prefix + name) for name in plant.states) for prefix in ("initial.", PREFIX))
    return Observer(hat, start, plant.right_hand_side(PREFIX), tuple(jump), {"x_hat": x_hat})
