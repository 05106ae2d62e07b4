"""What is kept of a simulation, within a memory budget: states on a common grid, both sides of jumps, and
every measurement."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import field
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.records import dataclass

GRID_POINTS = 2001  # of one run; fewer for many
SHOWN = 32  # runs that are all shown; of more some are, and the others are counted
GRID_OF_MANY = 201
SMALLEST_GRID = 21
BUDGET = 2_000_000  # numbers kept on the grid, and again at jumps
MOST_IN_MEMORY = 8_000_000  # numbers of both sides of jumps, before those of ended runs alone are kept whole
ON_GRID, BEFORE, AFTER = 0, 1, 2


def grid_times(horizon: float, width: int, runs: int) -> Array:
    """Common, equally spaced times 0 .. horizon of so many runs of `width` numbers each."""
    if runs > SHOWN:
        return grid_of_many(horizon)
    return np.linspace(0.0, horizon, max(SMALLEST_GRID, min(GRID_POINTS, BUDGET // (width * runs))))


def grid_of_many(horizon: float) -> Array:
    """Those of more runs than are all shown."""
    return np.linspace(0.0, horizon, GRID_OF_MANY)


def sides_of_one(width: int, runs: int) -> int:
    """How many jumps of one run are kept, where there are so many runs."""
    return max(2, BUDGET // (2 * width * runs))


def stride(samples: Any, most: int) -> Any:
    """Every so manieth jump is kept: the least power of 2 that leaves at most `most` of so many (at least one)."""
    return 2 ** np.ceil(np.log2(np.maximum(1, -(-np.asarray(samples) // most)))).astype(np.int64)


class Grid:
    """States of every run at common times.

    times (G + 1,), the last one infinite; z (R, n + c, G): states, and what is held; due (R,): next place to be filled.
    """

    def __init__(self, times: Array, size: int, held: int, runs: int) -> None:
        self.times = np.append(times, np.inf)
        self._times = self.times.tolist()
        self.size, self.z = size, np.empty((runs, size + held, len(times)))
        self.due = np.zeros(runs, dtype=np.int64)

    def next_time(self, run: int) -> float:
        return float(self.times[self.due[run]])

    def take(self, run: int, until: float) -> tuple[Array, slice]:
        """Times up to `until` that are still empty for this run, and their places; they count as filled."""
        first = int(self.due[run])
        self.due[run] = last = max(first, bisect_right(self._times, until))
        return self.times[first:last], slice(first, last)

    def advance(self, runs: Integers, until: Array) -> tuple[Integers, Integers]:
        """Of each run the first place that is still empty, and the one after the last up to `until` (R',); those
        between count as filled."""
        first = self.due[runs]
        self.due[runs] = last = np.maximum(first, np.searchsorted(self.times, until, side="right"))
        return first, last

    def put(self, run: int, places: slice, y: Array, held: Array) -> None:
        """y (n, places), held (c, 1)."""
        self.z[run, : self.size, places], self.z[run, self.size :, places] = y, held


@dataclass
class Sides:
    """Both sides of jumps: runs, time, what was before and after, each entry one sample number of some runs."""

    most: int
    entries: list[tuple[int, Integers, Array, Array, Array]] = field(default_factory=list)
    kept: int = 0

    def add(self, index: int, runs: Integers, t: Array, before: Array, after: Array) -> None:
        """States and what is held (n + c, len(runs)) of the given runs, before and after sample number `index` at t."""
        self.entries.append((index, runs, t, before, after))
        self.kept += 2 * before.size
        if self.kept > MOST_IN_MEMORY:
            self._thin(index, runs)

    def _thin(self, index: int, going: Integers) -> None:
        """Leave out of the runs that go on what their number of samples will leave out in the end."""
        every, thinned = int(stride(index + 1, self.most)), []
        for number, runs, *columns in self.entries:
            stays = np.ones(len(runs), dtype=bool) if number % every == 0 else ~np.isin(runs, going)
            if stays.any():
                t, before, after = columns
                thinned.append((number, runs[stays], t[stays], before[:, stays], after[:, stays]))
        self.entries, self.kept = thinned, sum(2 * entry[3].size for entry in thinned)


@dataclass(frozen=True)
class Log:
    """All that was recorded, run after run, each in the order of time.

    run, kind, index (P,): whose it is, where it was (on the grid, before or after a jump), at which sample; t (P,);
    z (n + c, P): states, and what is held.
    """

    run: Integers
    kind: Integers
    index: Integers
    t: Array
    z: Array


@dataclass(frozen=True)
class Samples:
    """All measurements: run r took those in [offsets[r], offsets[r + 1]) of t (K,) and y (p, K); arrival (p, K) is when
    they are there, None where that is at once."""

    offsets: Integers
    t: Array
    y: Array
    arrival: Array | None = None


@dataclass(frozen=True)
class Paths:
    """What is kept of runs: run r went through [offsets[r], offsets[r + 1]) of t (P,) and z (n + c, P)."""

    offsets: Integers
    t: Array
    z: Array

    @staticmethod
    def one(t: Array, z: Array) -> Paths:
        """Of a single run."""
        return Paths(np.array([0, len(t)]), t, z)

    @property
    def run(self) -> Integers:
        """Whose each point is."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))

    @property
    def last(self) -> Integers:
        """The place of each run's end."""
        return self.offsets[1:] - 1


@dataclass
class Record:
    """Everything kept: grid, jumps, and the measurements (runs, t_k, y_k (p, ..)) of each sample, with their arrivals
    (p, ..) where some are late."""

    grid: Grid
    sides: Sides
    measured: list[tuple[Any, Any, Any]] = field(default_factory=list)
    arrivals: list[Array] = field(default_factory=list)

    def log(self) -> Log:
        places = np.arange(len(self.grid.times) - 1)
        filled, at = np.nonzero(places < self.grid.due[:, None])
        nothing = np.zeros(len(filled), dtype=np.int64)
        run, kind, index = [filled], [nothing + ON_GRID], [nothing]
        t, z = [self.grid.times[at]], [self.grid.z[filled, :, at].T]
        for number, runs, t_k, before, after in self.sides.entries:
            for side, columns in ((BEFORE, before), (AFTER, after)):
                run.append(runs)
                kind.append(np.full(len(runs), side))
                index.append(np.full(len(runs), number))
                t.append(t_k)
                z.append(columns)
        whose, where, when = np.concatenate(run), np.concatenate(kind), np.concatenate(t)
        order = np.lexsort((where, when, whose))
        return Log(
            whose[order],
            where[order],
            np.concatenate(index)[order],
            when[order],
            np.concatenate(z, axis=1).take(order, axis=1),
        )

    def samples(self, runs: int) -> Samples:
        ids = np.concatenate([entry[0] for entry in self.measured])
        order = np.argsort(ids, kind="stable")
        t = np.concatenate([entry[1] for entry in self.measured])[order]
        y = np.concatenate([entry[2] for entry in self.measured], axis=1)[:, order]
        arrival = np.concatenate(self.arrivals, axis=1)[:, order] if self.arrivals else None
        return Samples(_offsets(ids, runs), t, y, arrival)


def paths(log: Log, samples: Samples, most: int, spacing: float, size: int, final_t: Array, final_z: Array) -> Paths:
    """What is kept of a log: each run up to its end (final_t (R,), final_z (n + c, R)), both sides of each jump.

    A grid time at which the run was sampled is left out: the two sides of the jump stand for it. So are states that
    are not finite, unless the run has no others, and of the jumps of a run all but `most`, evenly.
    """
    runs = len(final_t)
    every, kept = stride(np.diff(samples.offsets), most), log.t <= final_t[log.run]
    if (every > 1).any():
        kept &= (log.kind == ON_GRID) | (log.index % every[log.run] == 0)
    kept[kept] = ~_beside_a_jump(log.run[kept], log.kind[kept], log.t[kept], 1e-9 * spacing)
    run, t, z = log.run[kept], log.t[kept], log.z.take(np.flatnonzero(kept), axis=1)
    early = np.flatnonzero(~(t[_offsets(run, runs)[1:] - 1] >= final_t))
    at = _offsets(run, runs)[early + 1]
    if early.size:
        run, t = np.insert(run, at, early), np.insert(t, at, final_t[early])
        z = np.insert(z, at, final_z[:, early], axis=1)
    is_finite = np.isfinite(z[:size])
    if is_finite.all():
        return Paths(_offsets(run, runs), t, z)
    finite = is_finite.all(axis=0)
    has_any = np.bincount(run[finite], minlength=runs) > 0
    shown = finite | ~has_any[run]
    return Paths(_offsets(run[shown], runs), t[shown], z[:, shown])


def _beside_a_jump(run: Integers, kind: Integers, t: Array, slack: float) -> Booleans:
    """Which grid points are within `slack` of a jump of their run: of one of their neighbours, as the grid is wider."""
    near = (np.diff(t) <= slack) & (np.diff(run) == 0)
    on_grid, beside = kind == ON_GRID, np.zeros(len(t), dtype=bool)
    beside[:-1] |= near & ~on_grid[1:]
    beside[1:] |= near & ~on_grid[:-1]
    result: Booleans = beside & on_grid
    return result


def _offsets(run: Integers, runs: int) -> Integers:
    """Where each run begins, and where the last one ends."""
    return np.concatenate([[0], np.cumsum(np.bincount(run, minlength=runs))])
