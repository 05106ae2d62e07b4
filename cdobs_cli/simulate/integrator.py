"""Flow from one sample to the next: never across it, with error control and output on a grid.

`OneRun` works on floats, `ManyRuns` on arrays in which every run has its own time and step. Both end a run's
flow exactly at the time asked for, or at the first root of the trigger, whichever is first.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.records import dataclass
from cdobs_cli.simulate import dormand_prince as method
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.postponed import Postponed
from cdobs_cli.simulate.stiffness import LOOK, Stiffness
from cdobs_cli.simulate.trigger import Along

if TYPE_CHECKING:
    from cdobs_cli.simulate.record import Grid

_FLUSH = 256  # steps of a single run between two looks at divergence and stops


class End:
    """Why the flow of a run ended (plain integers: they fill arrays)."""

    REACHED = 0
    TRIGGERED = 1
    HALTED = 2  # the watch found a reason
    SINGULAR = 3  # no step, however small, is accurate: the flow is undefined or unbounded there
    EXHAUSTED = 4  # more steps than one run may take
    STIFF = 5  # stability, not accuracy, bounds the steps: an implicit method is to go on


@dataclass
class Progress:
    """Where the runs stand, each entry one run; the integrators write into it.

    t, h (R,): time and the step size to try next (0: unknown); y, largest (n, R): state and the size it has
    reached; held (c, R); steps (R,): steps tried so far.
    """

    t: Array
    y: Array
    held: Array
    h: Array
    largest: Array
    steps: Integers

    @staticmethod
    def start(t: Array, y: Array, held: Array) -> Progress:
        return Progress(t, y, held, np.zeros(len(t)), np.zeros_like(y), np.zeros(len(t), dtype=np.int64))

    def at(self, runs: Integers) -> tuple[Array, Array, Array]:
        """t, y and held of some of the runs."""
        return self.t[runs], self.y[:, runs], self.held[:, runs]

    def floor(self, runs: Integers) -> Array:
        """The absolute part of the error weights; `largest` is brought up to date first."""
        self.largest[:, runs] = largest = np.maximum(self.largest[:, runs], np.abs(self.y[:, runs]))
        floor: Array = method.ATOL * np.maximum(largest, method.SMALLEST_SHARE * largest.max(axis=0)) + 1e-300
        return floor


# What the engine wants to see of the steps: run, time, state, what is held; returns which runs must halt.
Watch = Callable[[Any, Any, Any, Any], Any]


class OneRun:
    """The flow of a single run, on floats."""

    def __init__(self, loop: ClosedLoop, horizon: float, max_steps: int) -> None:
        self.loop, self.horizon, self.max_steps = loop, horizon, max_steps
        self._flow = loop.scalar_flow()
        self._step = method.scalar_step(self._flow, loop.size)
        self._interpolant = method.scalar_dense_output(self._flow, loop.size)
        self._stiffness = Stiffness(1, 1, max_steps)
        self.postponed = Postponed(loop)

    def advance(self, runs: Integers, progress: Progress, ends: Array, grid: Grid, watch: Watch) -> Integers:
        """Flow the run to its end; returns the End code, shape (1,)."""
        t, h, end = float(progress.t[0]), float(progress.h[0]), float(ends[0])
        y, held = tuple(progress.y[:, 0].tolist()), tuple(progress.held[:, 0].tolist())
        floor, steps = tuple(progress.floor(runs)[:, 0].tolist()), int(progress.steps[0])
        triggered, smallest = self.loop.is_triggered, 1e-15 * self.horizon
        # The state just after a jump has not been looked at yet.
        seen_t, seen_y, code = [t], [y], End.REACHED

        def look() -> bool:
            points = len(seen_t)
            first, kept = np.zeros(points, dtype=np.int64), np.repeat(progress.held, points, axis=1)
            halted = watch(first, np.array(seen_t), np.array(seen_y).T, kept)
            seen_t.clear()
            seen_y.clear()
            return bool(halted[0])

        k = self._slope(t, y, held)
        if h <= 0 and k is not None:
            h = first_step(np.array(y), np.array(k), np.array(floor), self.horizon)
        while t < end:
            if k is None or steps >= self.max_steps:
                code = End.SINGULAR if k is None else End.EXHAUSTED
                break
            left = end - t
            tried = left if h >= left else (left / 2 if 2 * h > left else h)
            new, last, error, slopes = self._try(t, tried, y, k, held, floor)
            steps += 1
            if not error <= 1.0:
                h = tried * min(0.9, method.next_step(error))
                if h < smallest + 4e-16 * t:
                    code = End.SINGULAR
                    break
                continue
            suggested = max(h, tried * method.next_step(error)) if tried < h else tried * method.next_step(error)
            until = end if tried == left else t + tried
            looked = steps % LOOK == 0 and self._stiffness.worth_a_look(left, self.horizon - t, tried)
            stiff = looked and self._stiff(runs, tried, y, new, slopes, floor)
            whole = t, tried, y, new, slopes, held
            if triggered:
                step = self._dense(*whole), np.array(y)[:, None], np.array([t]), np.array([tried]), progress.held
                along = Along(self.loop.trigger, *step)
                theta = along.first_root()
                if theta[0] <= 1.0:
                    part, at_root = along.polished(partial(self._part, t, y, k, held, floor), theta)
                    until, new, code = t + float(part[0]), tuple(at_root[:, 0].tolist()), End.TRIGGERED
            if grid.next_time(0) <= until:
                self.postponed.add_one(grid, grid.take(0, until)[1], *whole)
            h, t, y, k = suggested, until, new, last
            seen_t.append(t)
            seen_y.append(y)
            if code == End.TRIGGERED:
                break
            if stiff:
                code = End.STIFF
                break
            if len(seen_t) >= _FLUSH and look():
                code = End.HALTED
                break
        if seen_t and look():
            code = End.HALTED
        progress.t[0], progress.h[0], progress.y[:, 0], progress.steps[0] = t, h, y, steps
        return np.array([code])

    def _slope(self, t: float, y: tuple[float, ...], held: tuple[float, ...]) -> tuple[float, ...] | None:
        try:
            k = self._flow(t, *y, *held)
        except (ArithmeticError, ValueError):
            return None
        # A negative number to a fractional power is complex in Python: undefined here.
        return None if any(isinstance(value, complex) or value - value != 0.0 for value in k) else k

    def _try(self, t: float, h: float, y: Any, k: Any, held: Any, floor: Any) -> tuple[Any, Any, float, Any]:
        try:
            return self._step(t, h, y, k, held, floor)  # type: ignore[no-any-return]
        except (ArithmeticError, ValueError, TypeError):
            return y, k, float("nan"), ()

    def _stiff(self, runs: Integers, h: float, *of_states: Any) -> bool:
        columns = (np.array(part)[..., None] for part in of_states)
        return bool(self._stiffness.found(runs, np.array([h]), *columns)[0])

    def _part(self, t: float, y: Any, k: Any, held: Any, floor: Any, s: Array) -> tuple[Array, Array]:
        new, last, _, _ = self._try(t, float(s[0]), y, k, held, floor)
        return np.array(new)[:, None], np.array(last)[:, None]

    def _dense(self, t: float, h: float, y: Any, new: Any, slopes: Any, held: Any) -> Array:
        try:
            return np.array(self._interpolant(t, h, y, new, slopes, held), dtype=float)[:, :, None]
        except (ArithmeticError, ValueError, TypeError):
            return np.full((7, len(y), 1), np.nan)


@dataclass
class _Lanes:
    """The runs that still flow, as `Progress`, side by side; ends (R,), floor and the slope k (n, R); room (13, n, R)
    for the slopes of a step."""

    ids: Integers
    t: Array
    h: Array
    ends: Array
    steps: Integers
    y: Array
    held: Array
    floor: Array
    k: Array
    room: Array

    @staticmethod
    def of(progress: Progress, ids: Integers, *columns: Array) -> _Lanes:
        """columns: ends, floor and k of these runs."""
        ends, floor, k = columns
        t, y, held = progress.at(ids)
        return _Lanes(ids, t, progress.h[ids], ends, progress.steps[ids], y, held, floor, k, np.empty((13, *y.shape)))

    def of_those(self, which: Integers) -> _Lanes:
        """Some of them."""
        kept = {name: part[..., which] for name, part in vars(self).items() if name != "room"}
        return _Lanes(**kept, room=np.empty((*self.room.shape[:2], len(which))))

    def write(self, progress: Progress) -> None:
        """Where they stand."""
        progress.t[self.ids], progress.h[self.ids], progress.steps[self.ids] = self.t, self.h, self.steps
        progress.y[:, self.ids] = self.y


class ManyRuns:
    """The flow of many runs at once, each with its own time, step and end."""

    def __init__(self, loop: ClosedLoop, horizon: float, max_steps: int, runs: int, together: int) -> None:
        self.loop, self.horizon, self.max_steps = loop, horizon, max_steps
        self._slope = loop.array_flow()
        self._stiffness = Stiffness(runs, together, max_steps)
        self.postponed = Postponed(loop)

    def advance(self, runs: Integers, progress: Progress, ends: Array, grid: Grid, watch: Watch) -> Integers:
        """Flow the given runs to their ends (len(runs),); returns an End code for each."""
        codes = np.full(len(runs), End.REACHED)
        smallest = 1e-15 * self.horizon
        floor = progress.floor(runs)
        k = self._slope(*progress.at(runs))
        fresh = np.flatnonzero(progress.h[runs] <= 0)
        if fresh.size:
            at_start = progress.y[:, runs[fresh]], k[:, fresh], floor[:, fresh]
            progress.h[runs[fresh]] = first_steps(*at_start, self.horizon)
        codes[~np.isfinite(k).all(axis=0)] = End.SINGULAR
        # The states just after a jump have not been looked at yet.
        codes[watch(runs, *progress.at(runs))[runs]] = End.HALTED
        live = np.flatnonzero((codes == End.REACHED) & (progress.t[runs] < ends))
        lanes = _Lanes.of(progress, runs[live], ends[live], floor[:, live], k[:, live])
        while live.size:
            ids, t, y, h, left = lanes.ids, lanes.t, lanes.y, lanes.h, lanes.ends - lanes.t
            tried = np.where(h >= left, left, np.where(2 * h > left, left / 2, h))
            new, last, error, slopes = method.array_step(
                self._slope, t, tried, y, lanes.k, lanes.held, lanes.floor, lanes.room
            )
            # Where the slope at the start stood there is the one at the end now.
            lanes.k = slopes[0]
            lanes.steps += 1
            good = error <= 1.0
            factor = _next_steps(error)
            longer = np.where(tried < h, np.maximum(h, tried * factor), tried * factor)
            lanes.h = np.where(good, longer, tried * np.minimum(0.9, factor))
            singular = ~good & (lanes.h < smallest + 4e-16 * t)
            until = np.where(tried == left, lanes.ends, t + tried)
            if not good.all():
                # A step that is not taken ends where it began.
                until, new, last = np.where(good, until, t), np.where(good, new, y), np.where(good, last, lanes.k)
            codes[live[singular]], whole = End.SINGULAR, (t, tried, y, new, slopes, lanes.held)
            if self.loop.is_triggered:
                at, when, states = self._first_roots(lanes, np.flatnonzero(good), tried, new, slopes)
                until[at], new, codes[live[at]] = when, new.copy(), End.TRIGGERED
                new[:, at] = states
            self.postponed.add(grid, ids, until, *whole)
            worth = good & (lanes.steps % LOOK == 0) & (codes[live] == End.REACHED)
            looked = np.flatnonzero(worth & self._stiffness.worth_a_look(left, self.horizon - t, tried))
            if looked.size:
                along_step = tried[looked], y[:, looked], new[:, looked], slopes[:, :, looked], lanes.floor[:, looked]
                codes[live[looked[self._stiffness.found(ids[looked], *along_step)]]] = End.STIFF
            lanes.t, lanes.y, lanes.k = until, new, last
            codes[live[watch(ids, until, new, lanes.held)[ids]]] = End.HALTED
            unended = (codes[live] == End.REACHED) & (until < lanes.ends)
            exhausted = unended & (lanes.steps >= self.max_steps)
            codes[live[exhausted]] = End.EXHAUSTED
            stays = unended & ~exhausted
            if not stays.all():
                lanes.write(progress)
                live, lanes = live[stays], lanes.of_those(np.flatnonzero(stays))
        return codes

    def _first_roots(
        self, lanes: _Lanes, at: Integers, tried: Array, new: Array, slopes: Array
    ) -> tuple[Integers, Array, Array]:
        """Of the lanes `at` those whose trigger is reached within their steps, when, and the states there."""
        t, h, y, held = lanes.t[at], tried[at], lanes.y[:, at], lanes.held[:, at]
        coefficients = method.dense_output(self._slope, t, h, y, new[:, at], slopes[method.READ][:, :, at], held)
        along = Along(self.loop.trigger, coefficients, y, t, h, held)
        theta = along.first_root()
        hit = np.flatnonzero(theta <= 1.0)
        if not hit.size:
            return at[hit], t[hit], y[:, hit]
        own = lanes.of_those(at[hit])
        part_of = partial(self._part, own.t, own.y, own.k, own.held, own.floor)
        part, states = along.of(hit).polished(part_of, theta[hit])
        return at[hit], own.t + part, states

    def _part(self, t: Array, y: Array, k: Array, held: Array, floor: Array, s: Array) -> tuple[Array, Array]:
        return method.array_step(self._slope, t, s, y, k, held, floor)[:2]


def _next_steps(error: Array) -> Array:
    """`next_step` over an array."""
    with np.errstate(divide="ignore"):
        root = np.sqrt(np.sqrt(np.sqrt(np.abs(error))))
        factor = np.minimum(np.maximum(0.9 / root, 0.2), 6.0)
    return np.where(np.isfinite(error), factor, 0.2)


def first_steps(y: Array, k: Array, floor: Array, horizon: float) -> Array:
    """Cautious first steps (R,): the state changes by about a hundredth of its size; y, k, floor (n, R)."""
    scale = floor + method.RTOL * np.abs(y)
    size, rate = (np.abs(y) / scale).max(axis=0), (np.abs(k) / scale).max(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        by_size = np.where(size > 0, np.minimum(1e-3 * horizon, 0.01 * size / rate), 1e-6 * horizon)
    return np.where(np.isfinite(rate) & (rate != 0), by_size, 1e-3 * horizon)


def first_step(y: Array, k: Array, floor: Array, horizon: float) -> float:
    """The same of one run: y, k, floor (n,)."""
    return float(first_steps(y[:, None], k[:, None], floor[:, None], horizon)[0])
