"""What is kept of a simulation, within a memory budget: states on a common grid, both sides of jumps, and
every measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.simulate.dormand_prince import interpolate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Integers = NDArray[np.int64]

GRID_POINTS = 2001  # of one run; fewer for many
SMALLEST_GRID = 21
BUDGET = 2_000_000  # numbers kept on the grid, and again at jumps


class Grid:
    """States of every run at common, equally spaced times 0 .. horizon.

    times (G + 1,), the last one infinite; y (R, n, G); held (R, c, G); due (R,): next place to be filled.
    """

    def __init__(self, horizon: float, size: int, held: int, runs: int) -> None:
        points = max(SMALLEST_GRID, min(GRID_POINTS, BUDGET // ((size + held) * runs)))
        self.times = np.append(np.linspace(0.0, horizon, points), np.inf)
        self.y, self.held = np.empty((runs, size, points)), np.empty((runs, held, points))
        self.due = np.zeros(runs, dtype=np.int64)

    def next_time(self, run: int) -> float:
        return float(self.times[self.due[run]])

    def any_due(self, runs: Integers, until: Array) -> bool:
        return bool((self.times[self.due[runs]] <= until).any())

    def take(self, run: int, until: float) -> tuple[Array, slice]:
        """Times up to `until` that are still empty for this run, and their places; they count as filled."""
        first, last = int(self.due[run]), int(np.searchsorted(self.times, until, side="right"))
        self.due[run] = max(first, last)
        return self.times[first : max(first, last)], slice(first, max(first, last))

    def put(self, run: int, places: slice, y: Array, held: Array) -> None:
        """y (n, places), held (c, 1)."""
        self.y[run, :, places], self.held[run, :, places] = y, held

    def fill(
        self, runs: Integers, until: Array, t: Array, h: Array, coefficients: Array, y: Array, held: Array
    ) -> None:
        """Read all times up to `until` (R',) from the dense output of steps that began at t (R',)."""
        while True:
            due = np.flatnonzero(self.times[self.due[runs]] <= until)
            if not due.size:
                return
            ids = runs[due]
            places = self.due[ids]
            theta = (self.times[places] - t[due]) / h[due]
            self.y[ids, :, places] = interpolate(coefficients[:, :, due], y[:, due], theta).T
            self.held[ids, :, places] = held[:, due].T
            self.due[ids] += 1


@dataclass
class Sides:
    """Both sides of jumps, for all samples while they fit into the budget, then for every second, fourth, ..."""

    stride: int = 1
    entries: list[tuple[int, Any, Any, Any, Any, Any, Any]] = field(default_factory=list)
    kept: int = 0

    def add(
        self, index: int, runs: Integers, t: Array, before: Array, held_before: Array, after: Array, held_after: Array
    ) -> None:
        if index % self.stride:
            return
        self.entries.append((index, runs, t, before, held_before, after, held_after))
        self.kept += 2 * (before.size + held_before.size)
        while self.kept > BUDGET and len(self.entries) > 2:
            self.stride *= 2
            self.entries = [entry for entry in self.entries if entry[0] % self.stride == 0]
            self.kept = sum(2 * (entry[3].size + entry[4].size) for entry in self.entries)


def _coincides(t: Array, instants: Array, slack: float) -> NDArray[np.bool_]:
    """Which times are within rounding of one of the (sorted) instants."""
    after = np.searchsorted(instants, t).clip(1, max(1, len(instants) - 1))
    nearest = np.minimum(np.abs(instants[after - 1] - t), np.abs(instants[np.minimum(after, len(instants) - 1)] - t))
    close: NDArray[np.bool_] = nearest <= slack
    return close


@dataclass
class Record:
    """Everything kept: grid, jumps, and the measurements (runs, t_k, y_k (p, ..)) of each sample."""

    grid: Grid
    sides: Sides = field(default_factory=Sides)
    measured: list[tuple[Any, Any, Any]] = field(default_factory=list)

    def points(self, final_t: Array, final_y: Array, final_held: Array) -> list[tuple[Array, Array, Array]]:
        """For each run: t (N,), y (n, N), held (c, N) up to the run's end, in order, both sides of each jump kept.

        A grid time at which the run was sampled is left out: the two sides of the jump stand for it. So are
        states that are not finite, unless the run has no others.
        """
        runs, size = len(final_t), len(final_y)
        entries = self.sides.entries
        ids = np.concatenate([entry[1] for entry in entries])
        # One row a jump: time, both states, what was held before and after.
        rows = np.concatenate(
            [np.concatenate([entry[2][None], entry[3], entry[5], entry[4], entry[6]]) for entry in entries], axis=1
        )
        result = []
        for run, jumps in enumerate(_by_run(ids, rows, runs)):
            end = float(final_t[run])
            jumps = jumps[:, jumps[0] <= end]
            t_k, before, after = jumps[0], jumps[1 : 1 + size], jumps[1 + size : 1 + 2 * size]
            held_before, held_after = np.split(jumps[1 + 2 * size :], 2)
            times = self.grid.times[: int(self.grid.due[run])]
            taken = np.flatnonzero((times <= end) & ~_coincides(times, t_k, 1e-9 * float(self.grid.times[1])))
            t, order = np.concatenate([times[taken], t_k, t_k]), np.repeat([0, 1, 2], [len(taken), len(t_k), len(t_k)])
            y = np.concatenate([self.grid.y[run][:, taken], before, after], axis=1)
            held = np.concatenate([self.grid.held[run][:, taken], held_before, held_after], axis=1)
            if not t.max() >= end:
                t, order = np.append(t, end), np.append(order, 3)
                y, held = np.append(y, final_y[:, [run]], axis=1), np.append(held, final_held[:, [run]], axis=1)
            places = np.lexsort((order, t))
            finite = np.isfinite(y[:, places]).all(axis=0)
            places = places[finite] if finite.any() else places
            result.append((t[places], y[:, places], held[:, places]))
        return result

    def measurements(self, runs: int) -> list[tuple[Array, Array]]:
        """For each run: t_k (K,), y_k (K, p)."""
        ids = np.concatenate([entry[0] for entry in self.measured])
        rows = np.concatenate([np.concatenate([t[None], y]) for _, t, y in self.measured], axis=1)
        return [(own[0], own[1:].T) for own in _by_run(ids, rows, runs)]


def _by_run(ids: Integers, columns: Array, runs: int) -> list[Array]:
    """The columns of each run, in their order; every run has at least one."""
    order = np.argsort(ids, kind="stable")
    starts = np.searchsorted(ids[order], np.arange(1, runs))
    return np.split(columns[:, order], starts, axis=1)
