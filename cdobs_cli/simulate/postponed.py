"""Points of the output grid that are read off steps later, of many steps at once: dense output asks for three more
slopes, and few steps at a time cost more in calls than in arithmetic."""

from __future__ import annotations

from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.simulate import dormand_prince as method
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.record import Grid

_AT_ONCE = 8192  # numbers of all states together: they stay in a processor's cache


class Postponed:
    """Steps that hold points of the grid. Points are the same bits with whichever others they are read."""

    def __init__(self, loop: ClosedLoop) -> None:
        self._slope, self._size = loop.array_flow(), loop.size
        self._single: list[tuple[Any, ...]] = []
        self._many: list[tuple[Any, ...]] = []
        self._kept = 0

    def add_one(self, grid: Grid, places: slice, *step: Any) -> None:
        """A step of a single run: t and h, then y, new, slopes (13,) and held as tuples of floats."""
        self._single.append((places.start, places.stop, *step))
        self._count(grid, 1)

    def add(self, grid: Grid, runs: Integers, until: Array, *step: Array) -> None:
        """Steps of many runs up to `until` (R,): t, h (R,), y, new (n, R), slopes (13, n, R), held (c, R)."""
        first, last = grid.advance(runs, until)
        due = np.flatnonzero(last > first)
        if not due.size:
            return
        t, h, y, new, slopes, held = step
        theta = (grid.times[first[due]] - t[due]) / h[due]
        at_end = theta >= 1.0 - method.AT_AN_END
        at_state = at_end | ((theta <= method.AT_AN_END) & (last[due] == first[due] + 1))
        here, due, at_end = due[at_state], due[~at_state], at_end[at_state]
        if here.size:
            states = np.where(at_end, new[:, here], y[:, here])
            grid.z[runs[here], :, first[here]] = np.concatenate([states, held[:, here]]).T
        if due.size:
            columns = y[:, due], new[:, due], slopes[method.READ].take(due, axis=2), held[:, due]
            self._many.append((runs[due], first[due], last[due], t[due], h[due], *columns))
            self._count(grid, due.size)

    def _count(self, grid: Grid, steps: int) -> None:
        self._kept += steps * self._size
        if self._kept >= _AT_ONCE:
            self.settle(grid)

    def settle(self, grid: Grid) -> None:
        """Read what was left to be read."""
        if self._single:
            columns = [np.array(column) for column in zip(*self._single, strict=True)]
            first, last, t, h = columns[:4]
            y, new, slopes, held = (np.moveaxis(column, 0, -1) for column in columns[4:])
            self._read(grid, np.zeros(len(t), dtype=np.int64), first, last, t, h, y, new, slopes[method.READ], held)
        if self._many:
            self._read(grid, *(np.concatenate(parts, axis=-1) for parts in zip(*self._many, strict=True)))
        self._single, self._many, self._kept = [], [], 0

    def _read(
        self, grid: Grid, runs: Integers, first: Integers, last: Integers, t: Array, h: Array, y: Array, new: Array,
        slopes: Array, held: Array,
    ) -> None:  # fmt: skip
        coefficients = method.dense_output(self._slope, t, h, y, new, slopes, held)
        counts = last - first
        step = np.repeat(np.arange(len(t)), counts)
        places = np.arange(len(step)) + np.repeat(first - np.cumsum(counts) + counts, counts)
        theta = (grid.times[places] - t[step]) / h[step]
        states = method.interpolate(coefficients[:, :, step], y[:, step], theta)
        grid.z[runs[step], :, places] = np.concatenate([states, held[:, step]]).T
