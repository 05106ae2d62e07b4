"""What is kept of a simulation, within a memory budget: states on a common grid, both sides of jumps, and
every measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cdobs_cli.simulate.dormand_prince import interpolate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Integers = NDArray[np.int64]

GRID_POINTS = 2001  # of one run; fewer for many
SMALLEST_GRID = 21
BUDGET = 4_000_000  # numbers kept on the grid, and again at jumps


class Grid:
    """States of every run at common, equally spaced times 0 .. horizon.

    times (G + 1,), the last one infinite; y (n, G, R); held (c, G, R); due (R,): next place to be filled.
    """

    def __init__(self, horizon: float, size: int, held: int, runs: int) -> None:
        import numpy as np

        points = max(SMALLEST_GRID, min(GRID_POINTS, BUDGET // ((size + held) * runs)))
        self.times = np.append(np.linspace(0.0, horizon, points), np.inf)
        self.y, self.held = np.empty((size, points, runs)), np.empty((held, points, runs))
        self.due = np.zeros(runs, dtype=np.int64)

    def next_time(self, run: int) -> float:
        return float(self.times[self.due[run]])

    def any_due(self, runs: Integers, until: Array) -> bool:
        return bool((self.times[self.due[runs]] <= until).any())

    def take(self, run: int, until: float) -> tuple[Array, slice]:
        """Times up to `until` that are still empty for this run, and their places; they count as filled."""
        import numpy as np

        first, last = int(self.due[run]), int(np.searchsorted(self.times, until, side="right"))
        self.due[run] = max(first, last)
        return self.times[first : max(first, last)], slice(first, max(first, last))

    def put(self, run: int, places: slice, y: Array, held: Array) -> None:
        """y (n, places), held (c, 1)."""
        self.y[:, places, run], self.held[:, places, run] = y, held

    def fill(self, runs: Integers, until: Array, t: Array, h: Array, coefficients: Array, y: Array, held: Array) -> None:
        """Read all times up to `until` (R',) from the dense output of steps that began at t (R',)."""
        import numpy as np

        while True:
            due = np.flatnonzero(self.times[self.due[runs]] <= until)
            if not due.size:
                return
            ids = runs[due]
            places = self.due[ids]
            theta = (self.times[places] - t[due]) / h[due]
            self.y[:, places, ids] = interpolate(coefficients[:, :, due], y[:, due], theta)
            self.held[:, places, ids] = held[:, due]
            self.due[ids] += 1


@dataclass
class Sides:
    """Both sides of jumps, for all samples while they fit into the budget, then for every second, fourth, ..."""

    stride: int = 1
    entries: list[tuple[int, Any, Any, Any, Any, Any, Any]] = field(default_factory=list)
    kept: int = 0

    def add(self, index: int, runs: Integers, t: Array, before: Array, held_before: Array, after: Array, held_after: Array) -> None:
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
    import numpy as np

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

        A grid time at which the run was sampled is left out: the two sides of the jump stand for it.
        """
        import numpy as np

        runs = len(final_t)
        jumps: list[list[tuple[float, Array, Array, Array, Array]]] = [[] for _ in range(runs)]
        for _, ids, t, before, held_before, after, held_after in self.sides.entries:
            for column, run in enumerate(ids):
                jumps[run].append((t[column], before[:, column], held_before[:, column], after[:, column], held_after[:, column]))
        result = []
        for run in range(runs):
            count = int(self.grid.due[run])
            end = float(final_t[run])
            taken = np.flatnonzero(self.grid.times[:count] <= end)
            parts = [(self.grid.times[taken], np.zeros(len(taken)), self.grid.y[:, taken, run], self.grid.held[:, taken, run])]
            inside = [jump for jump in jumps[run] if jump[0] <= end]
            if inside:
                t_k = np.array([jump[0] for jump in inside])
                clear = ~_coincides(parts[0][0], t_k, 1e-9 * float(self.grid.times[1]))
                parts = [(parts[0][0][clear], parts[0][1][clear], parts[0][2][:, clear], parts[0][3][:, clear])]
                for order, y_at, held_at in ((1, 1, 2), (2, 3, 4)):
                    y, held = np.array([jump[y_at] for jump in inside]).T, np.array([jump[held_at] for jump in inside]).T
                    parts.append((t_k, np.full(len(t_k), order), y, held))
            if not any(part[0].size and part[0].max() >= end for part in parts):
                parts.append((np.array([end]), np.array([3]), final_y[:, [run]], final_held[:, [run]]))
            t = np.concatenate([part[0] for part in parts])
            sorted_ = np.lexsort((np.concatenate([part[1] for part in parts]), t))
            y = np.concatenate([part[2] for part in parts], axis=1)[:, sorted_]
            held = np.concatenate([part[3] for part in parts], axis=1)[:, sorted_]
            result.append((t[sorted_], y, held))
        return result

    def measurements(self, runs: int) -> list[tuple[Array, Array]]:
        """For each run: t_k (K,), y_k (K, p)."""
        import numpy as np

        times: list[list[Any]] = [[] for _ in range(runs)]
        values: list[list[Any]] = [[] for _ in range(runs)]
        for ids, t, y in self.measured:
            for column, run in enumerate(ids.tolist()):
                times[run].append(t[column])
                values[run].append(y[:, column])
        return [(np.array(t), np.array(y)) for t, y in zip(times, values, strict=True)]
