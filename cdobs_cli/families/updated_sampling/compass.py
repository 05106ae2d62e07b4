"""Maximising a function of a few numbers without derivatives: steps along each axis, halved where none helps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

T = TypeVar("T")
Point = tuple[float, ...]


def climb(
    value: Callable[[Point], tuple[float, T] | None],
    start: Point,
    steps: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    evaluations: int,
) -> tuple[float, T, Point] | None:
    """(value, what came with it, point) of the best point met; None where the function has none at the start.

    A step that helped is taken again, larger; each axis has its own step. Deterministic.
    """
    first = value(start)
    if first is None:
        return None
    best, found, point = first[0], first[1], start
    sizes, count, least = list(steps), 1, [step / 40 for step in steps]
    while count < evaluations and any(abs(size) > limit for size, limit in zip(sizes, least, strict=True)):
        for axis in range(len(start)):
            if abs(sizes[axis]) <= least[axis]:
                continue
            for side in (1, -1):
                moved = min(max(point[axis] + side * sizes[axis], lower[axis]), upper[axis])
                if moved == point[axis]:
                    continue
                trial = (*point[:axis], moved, *point[axis + 1 :])
                here = value(trial)
                count += 1
                if here is not None and here[0] > best * (1 + 1e-9):
                    best, found, point = here[0], here[1], trial
                    sizes[axis] *= 1.5 * side
                    break
            else:
                sizes[axis] /= 2
    return best, found, point
