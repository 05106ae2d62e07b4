"""Ackermann's formula: all poles of an observer of one output at one place, for the plant linearised at a point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.plant import Interval, Plant

_WORST = 1e14  # condition of an observability matrix that floats can solve with


def placed(A: Array, C: Array, pole: float) -> Array:
    """L (n, 1) with all eigenvalues of A - L C at `pole`: (A - pole I)^n O^-1 e_n. A (n, n), C (1, n).

    Raises: ValueError where the pair is not observable, or there are more outputs.
    """
    n = len(A)
    observability = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(n)])
    if len(C) != 1 or np.linalg.cond(observability) > _WORST:
        raise ValueError("poles are placed for one output that observes the linearised plant")
    wanted = np.linalg.matrix_power(A - pole * np.eye(n), n)
    L: Array = wanted @ np.linalg.solve(observability, np.eye(n)[:, [-1]])
    return L


def linearised(plant: Plant, estimate: Sequence[float]) -> tuple[Array, Array]:
    """df/dx (n, n) and dh/dx (p, n) at an estimate (n,), the inputs amid their ranges, else 0.

    Raises: ValueError where they are not defined there.
    """
    inputs = [_middle(one.range) for one in plant.inputs]
    names = [*plant.states, *(one.name for one in plant.inputs)]
    rows = (*plant.right_hand_side(), *plant.outputs())
    value = compile_floats([row.derivative(name) for row in rows for name in plant.states], names, arrays=False)
    try:
        entries = np.array(value(*estimate, *inputs), dtype=np.float64).reshape(len(rows), plant.n)
    except (ValueError, ArithmeticError):
        entries = np.full((len(rows), plant.n), np.nan)
    if not np.isfinite(entries).all():
        raise ValueError("the plant has no linearisation at the initial estimate")
    return entries[: plant.n], entries[plant.n :]


def _middle(range_: Interval | None) -> float:
    if range_ is None or range_.lower is None or range_.upper is None:
        return 0.0
    return float(range_.lower + range_.upper) / 2
