"""Maximising a function of a few numbers without derivatives: steps along each axis, halved where none helps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

T = TypeVar("T")
Point = tuple[float, ...]


def climb(
    value: Callable[[Point], tuple[float, T] | None],
    starts: Iterable[Point],
    steps: Sequence[float],
    lower: Sequence[float],
    upper: Sequence[float],
    evaluations: int,
) -> T | None:
    """What came with the largest value met, climbing from the best of the starts; None where no start has a value.

    A step that helped is taken again, larger; each axis has its own step. Deterministic.
    """
    tried = [(here[0], start) for start in starts if (here := value(start)) is not None]
    # Asked again: a search may know more by now.
    first = value(max(tried)[1]) if tried else None
    if first is None:
        return None
    (best, found), point = first, max(tried)[1]
    sizes, count, least = list(steps), 1, [step / 40 for step in steps]
    while count < evaluations and any(abs(size) > limit for size, limit in zip(sizes, least, strict=True)):
        for axis in range(len(point)):
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
                    (best, found), point = here, trial
                    sizes[axis] *= 1.5 * side
                    break
            else:
                sizes[axis] /= 2
    return found
