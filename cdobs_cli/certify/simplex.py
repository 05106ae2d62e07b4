"""Nelder and Mead's simplex: a search without derivatives, within a budget of values.

Source: Nelder1965
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_REFLECT, _EXPAND, _CONTRACT, _SHRINK = 1.0, 2.0, 0.5, 0.5
_WIDTH = 1e-4


def smallest(
    value: Callable[[Array], float], start: Array, steps: Array, budget: int, width: float = _WIDTH
) -> tuple[Array, float]:
    """The point of the least value met, and the value; infinite values are walls.

    steps: of the first simplex along each axis, shape (k,). Ends within `budget` values, or where those of the simplex
    differ by the relative width.
    """
    left = [budget]

    def asked(point: Array) -> float:
        left[0] -= 1
        met = value(point)
        return met if np.isfinite(met) else np.inf

    points = [np.array(start, dtype=float)]
    points += [points[0] + step * row for step, row in zip(steps, np.eye(len(points[0])), strict=True)]
    values = [asked(point) for point in points[: max(budget, 1)]]
    points = points[: len(values)]
    while left[0] > 0 and len(values) > 1:
        order = np.argsort(values, kind="stable")
        points, values = [points[k] for k in order], [values[k] for k in order]
        if values[-1] - values[0] <= width * abs(values[0]):
            break
        centre = np.mean(points[:-1], axis=0)

        def along(step: float, centre: Array = centre, worst: Array = points[-1]) -> tuple[Array, float]:
            point = centre + step * (centre - worst)
            return point, asked(point)

        point, met = along(_REFLECT)
        if met < values[0] and left[0] > 0:
            further = along(_EXPAND)
            point, met = further if further[1] < met else (point, met)
        elif met >= values[-2] and left[0] > 0:
            nearer = along(_CONTRACT if met < values[-1] else -_CONTRACT)
            if nearer[1] < min(met, values[-1]):
                point, met = nearer
            elif met >= values[-1]:
                for k in range(1, len(points)):
                    if left[0] > 0:
                        points[k] = points[0] + _SHRINK * (points[k] - points[0])
                        values[k] = asked(points[k])
                continue
        if met < values[-1]:
            points[-1], values[-1] = point, met
        else:
            break
    best = int(np.argmin(values))
    return points[best], values[best]
