"""What is kept of a simulation, within a memory budget: states on a common grid, both sides of jumps, and
every measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.simulate.dormand_prince import interpolate

GRID_POINTS = 2001  # of one run; fewer for many
SMALLEST_GRID = 21
BUDGET = 2_000_000  # numbers kept on the grid, and again at jumps


class Grid:
    """States of every run at common, equally spaced times 0 .. horizon.

    times (G + 1,), the last one infinite; z (R, n + c, G): states, and what is held; due (R,): next place to be filled.
    """

    def __init__(self, horizon: float, size: int, held: int, runs: int) -> None:
        points = max(SMALLEST_GRID, min(GRID_POINTS, BUDGET // ((size + held) * runs)))
        self.times = np.append(np.linspace(0.0, horizon, points), np.inf)
        self.size, self.z = size, np.empty((runs, size + held, points))
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
        self.z[run, : self.size, places], self.z[run, self.size :, places] = y, held

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
            states = interpolate(coefficients[:, :, due], y[:, due], theta)
            self.z[ids, :, places] = np.concatenate([states, held[:, due]]).T
            self.due[ids] += 1


@dataclass
class Sides:
    """Both sides of jumps, for all samples while they fit into the budget, then for every second, fourth, ..."""

    stride: int = 1
    entries: list[tuple[int, Integers, Array, Array, Array]] = field(default_factory=list)
    kept: int = 0

    def add(self, index: int, runs: Integers, t: Array, before: Array, after: Array) -> None:
        """States and what is held (n + c, len(runs)) of the given runs, before and after sample number `index` at t."""
        if index % self.stride:
            return
        self.entries.append((index, runs, t, before, after))
        self.kept += 2 * before.size
        while self.kept > BUDGET and len(self.entries) > 2:
            self.stride *= 2
            self.entries = [entry for entry in self.entries if entry[0] % self.stride == 0]
            self.kept = sum(2 * entry[3].size for entry in self.entries)


def _coincides(t: Array, instants: Array, slack: float) -> Booleans:
    """Which times are within rounding of one of the (sorted) instants."""
    after = np.searchsorted(instants, t).clip(1, max(1, len(instants) - 1))
    nearest = np.minimum(np.abs(instants[after - 1] - t), np.abs(instants[np.minimum(after, len(instants) - 1)] - t))
    close: Booleans = nearest <= slack
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
        final = np.concatenate([final_y, final_held])
        ids = np.concatenate([entry[1] for entry in self.sides.entries])
        # One column a jump: its time, and both sides.
        columns = [np.concatenate([t[None], before, after]) for _, _, t, before, after in self.sides.entries]
        rows, result = np.concatenate(columns, axis=1), []
        for run, jumps in enumerate(_by_run(ids, rows, runs)):
            end = float(final_t[run])
            jumps = jumps[:, jumps[0] <= end]
            t_k, (before, after) = jumps[0], np.split(jumps[1:], 2)
            times = self.grid.times[: int(self.grid.due[run])]
            taken = np.flatnonzero((times <= end) & ~_coincides(times, t_k, 1e-9 * float(self.grid.times[1])))
            t, order = np.concatenate([times[taken], t_k, t_k]), np.repeat([0, 1, 2], [len(taken), len(t_k), len(t_k)])
            z = np.concatenate([self.grid.z[run][:, taken], before, after], axis=1)
            if not t.max() >= end:
                t, order, z = np.append(t, end), np.append(order, 3), np.append(z, final[:, [run]], axis=1)
            places = np.lexsort((order, t))
            finite = np.isfinite(z[:size, places]).all(axis=0)
            places = places[finite] if finite.any() else places
            result.append((t[places], z[:size, places], z[size:, places]))
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
