"""A search without derivatives, within a budget of values, past walls where there is none.

Source: Nelder1965
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_WIDTH = 1e-4


def smallest(
    value: Callable[[Array], float], start: Array, steps: Array, budget: int, width: float = _WIDTH
) -> tuple[Array, float]:
    """The point of the least value met, and the value; infinite values are walls.

    steps: of the first simplex along each axis, shape (k,). Ends within `budget` values, or where those of the simplex
    differ by the width, relative to the value at the start.
    """
    from scipy.optimize import minimize

    met: dict[tuple[float, ...], float] = {}

    def asked(point: Array) -> float:
        key = tuple(map(float, point))
        if key not in met:
            met[key] = value(np.array(key))
        return met[key]

    first = asked(start)
    simplex = np.vstack([start, start + np.diag(steps)])
    tolerance = width * abs(first) if isfinite(first) else 0.0
    with np.errstate(invalid="ignore"):  # the difference of two walls
        minimize(
            asked, start, method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": budget, "fatol": tolerance, "xatol": inf},
        )  # fmt: skip
    point, least = min(met.items(), key=lambda one: one[1])
    return np.array(point), least
