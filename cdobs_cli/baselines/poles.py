"""Ackermann's formula: all poles of an observer of one output at one place."""

from __future__ import annotations

import numpy as np

from cdobs_cli.arrays import Array

_WORST = 1e14  # condition of an observability matrix that floats can solve with


def placed(A: Array, C: Array, pole: float) -> Array:
    """L (n, 1) with all eigenvalues of A - L C at `pole`: (A - pole I)^n O^-1 e_n. A (n, n), C (1, n).

    Raises: ValueError where the pair is not observable, or there are more outputs.
    """
    n = len(A)
    observability = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(n)])
    if len(C) != 1 or np.linalg.cond(observability) > _WORST:
        raise ValueError("poles are placed for one output that observes the linear part")
    wanted = np.linalg.matrix_power(A - pole * np.eye(n), n)
    L: Array = wanted @ np.linalg.solve(observability, np.eye(n)[:, [-1]])
    return L
