"""From what was recorded to trajectories and their figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.run import Departure, RunSummary, Trajectory
from cdobs_cli.simulate.departure import LARGEST
from cdobs_cli.simulate.loop import ClosedLoop, View
from cdobs_cli.simulate.record import Paths, Samples
from cdobs_cli.simulate.watch import Watch

ENCLOSURE_ROUNDING = 1e-9  # of the largest value met: a state outside its bounds by less is on them


def summarise(loop: ClosedLoop, watch: Watch, paths: Paths, samples: Samples) -> tuple[list[RunSummary], Array | None]:
    """The figures of every run, and the error (n, P) along its path that they are made from, where there is one."""
    held, size = paths.z[loop.size :], loop.size
    seen = loop.see(paths.t, paths.z[:size], held)
    loop.signals.refuse_outside(paths.t, seen.signals)
    watch.departures.look(paths.run, paths.t, seen.x, seen.estimates.get("x_hat"))
    runs = len(watch.stopped)
    margins = _margins(watch.margin, paths, seen) if seen.encloses else [None] * runs
    further = [(bool(watch.diverged[run]), watch.departures.of(run), watch.stopped[run]) for run in range(runs)]
    return figures(loop.plant.states, paths, samples, seen, margins, further), seen.error


def trajectory(loop: ClosedLoop, watch: Watch, paths: Paths, samples: Samples, run: int) -> Trajectory:
    """What is shown of one run."""
    own, sampled = _own(paths.offsets, run), _own(samples.offsets, run)
    # Copies: what is shown must not keep the other runs in memory.
    t, z = paths.t[own].copy(), paths.z[:, own].copy()
    seen = loop.see(t, z[: loop.size], z[loop.size :])
    inputs = {source.name: seen.signals[source.name] for source in loop.plant.inputs}
    inputs |= {name: values for name, values in seen.signals.items() if name.startswith("d.")}
    estimates = {name: rows.T for name, rows in seen.estimates.items()}
    t_k, y_k = samples.t[sampled].copy(), samples.y[:, sampled].copy().T
    arrival = None if samples.arrival is None else samples.arrival[:, sampled].copy().T
    return Trajectory(t, seen.x.T, estimates, dict(seen.internals), t_k, y_k, inputs, watch.stopped[run], arrival)


def _own(offsets: Integers, run: int) -> slice:
    return slice(int(offsets[run]), int(offsets[run + 1]))


def of_trajectory(states: Sequence[str], path: Trajectory, seen: View, told: RunSummary) -> RunSummary:
    """The figures that a trajectory shows; margin, divergence and departure are those that are told of it."""
    samples = Samples(np.array([0, len(path.t_k)]), path.t_k, path.y_k.T)
    further = [(told.diverged, told.departure, path.stopped)]
    return figures(states, Paths.one(path.t, seen.x), samples, seen, [told.inclusion_margin], further)[0]


def _margins(smallest: Array, paths: Paths, seen: View) -> list[float | None]:
    """The smallest distance of a state from its bounds, of each run, negative outside; 0 where that is rounding."""
    values = [np.abs(rows) for rows in (seen.x, seen.estimates["x_lower"], seen.estimates["x_upper"])]
    size = _most(np.max([np.where(np.isfinite(rows), rows, 0.0).max(axis=0) for rows in values], axis=0), paths)
    least = np.minimum(smallest, np.minimum.reduceat(seen.margin, paths.offsets[:-1]))
    rounded = (-ENCLOSURE_ROUNDING * size <= least) & (least < 0)
    return [float(one) for one in np.where(rounded, 0.0, np.clip(least, -LARGEST, LARGEST))]


def _most(values: Array, paths: Paths) -> Array:
    """The largest of each run, over the last axis."""
    most: Array = np.maximum.reduceat(values, paths.offsets[:-1], axis=-1)
    return most


def figures(
    states: Sequence[str], paths: Paths, samples: Samples, seen: View, margins: Sequence[float | None],
    further: Sequence[tuple[bool, Departure | None, str | None]],
) -> list[RunSummary]:  # fmt: skip
    """The figures of each run. Periods are between its measurements, the one at t_0 included; rmse is the root of the
    time average of the squared error (trapezoids over the output grid), of the whole run and of its second half, where
    what is left of the initial error is small if the run is long enough to show anything.

    Args:
        further: of each run whether it diverged, how it left the domain, and why it was stopped.
    """
    states_of_all = _errors(states, paths, seen.error, len(further))
    rows = zip(np.diff(samples.offsets), _periods(samples), states_of_all, margins, further, strict=True)
    return [
        RunSummary(
            int(count), *periods, final, whole, late, margin, diverged, departure is not None, departure, stopped, most
        )
        for count, periods, (final, whole, late, most), margin, (diverged, departure, stopped) in rows
    ]


_Sizes = dict[str, float]


def _errors(
    states: Sequence[str], paths: Paths, error: Array | None, runs: int
) -> list[tuple[float | None, _Sizes, _Sizes, _Sizes]]:
    """Of each run the error's size in the end, its root mean squares, late ones, and the largest of each state."""
    if error is None:
        return [(None, {}, {}, {}) for _ in range(runs)]
    final = map(_finite, _sizes(error[:, paths.last]).tolist())
    whole, late = (root_mean_squares(states, paths, error, late=half) for half in (False, True))
    return list(zip(final, whole, late, _named(states, _most(np.abs(error), paths)), strict=True))


def _periods(samples: Samples) -> list[tuple[float | None, float | None]]:
    """The shortest and the longest of each run; instants are good to about 1e-12: digits beyond that are rounding."""
    lengths, starts = np.diff(samples.t, append=np.nan), samples.offsets[:-1]
    some = np.diff(samples.offsets) > 0
    lengths[samples.offsets[1:][some] - 1] = np.nan
    least, most = np.full(len(starts), np.nan), np.full(len(starts), np.nan)
    if some.any():
        least[some], most[some] = (one.reduceat(lengths, starts[some]) for one in (np.fmin, np.fmax))
    return [
        (None, None) if np.isnan(low) else (float(f"{low:.12g}"), float(f"{high:.12g}"))
        for low, high in zip(least, most, strict=True)
    ]


def root_mean_squares(
    states: Sequence[str], paths: Paths, error: Array, *, late: bool = False
) -> list[dict[str, float]]:
    """Of each row of error (n, P) over each run, or over its second half; by state, those that floats hold."""
    if late:
        paths, error = _second_half(paths, error)
    largest, width = _most(np.abs(error), paths), np.diff(paths.t, append=np.nan)
    width[paths.last] = 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        squares = error / np.repeat(np.where(largest > 0, largest, 1.0), np.diff(paths.offsets), axis=1)
        squares *= squares
        follows = np.roll(squares, -1, axis=1)
        follows += squares
        follows *= width
        sums = np.add.reduceat(follows, paths.offsets[:-1], axis=1)
        # From the first point that counts.
        length = np.add.reduceat(width, paths.offsets[:-1])
        means = largest * np.sqrt(sums / (2 * length))
    return _named(states, np.where(length > 0, means, np.abs(error[:, paths.last])))


def _second_half(paths: Paths, error: Array) -> tuple[Paths, Array]:
    """Of each run the points after the middle of its time, its last one among them."""
    first, last = paths.t[paths.offsets[:-1]], paths.t[paths.last]
    start = first + 0.5 * (1.0 - 1e-12) * (last - first)
    inside = paths.t >= np.repeat(start, np.diff(paths.offsets))
    offsets = np.concatenate([[0], np.cumsum(np.add.reduceat(inside, paths.offsets[:-1], dtype=np.int64))])
    return Paths(offsets, paths.t[inside], paths.z[:0]), error[:, inside]


def _named(states: Sequence[str], values: Array) -> list[dict[str, float]]:
    """Of each run the values (n, R) by state that floats hold: JSON has no infinity."""
    rows = values.T.tolist()
    return [{name: one for name, one in zip(states, row, strict=True) if one - one == 0.0} for row in rows]


def _sizes(vectors: Array) -> Array:
    """The length of each column, without overflow on the way."""
    largest = np.abs(vectors).max(axis=0)
    with np.errstate(invalid="ignore"):
        parts = vectors / np.where(largest != 0, largest, 1.0)
        lengths: Array = largest * np.sqrt((parts * parts).sum(axis=0))
    return lengths


def _finite(value: float) -> float | None:
    """JSON has no infinity: a figure beyond floats is left out."""
    return value if isfinite(value) else None


def quadratic_means(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Over runs, of each state that all of them have."""
    return {
        name: float(np.hypot.reduce([one[name] for one in figures])) / len(figures) ** 0.5
        for name in figures[0]
        if all(name in one for one in figures)
    }


def overall(summaries: Sequence[RunSummary]) -> RunSummary:
    """All runs as one: measurements added up; the shortest and longest period, the largest final error, the smallest
    margin of any run, the largest error of each state; rmse the quadratic mean over runs; flags set where any run sets
    them."""
    if len(summaries) == 1:
        return summaries[0]
    rmse = quadratic_means([summary.rmse for summary in summaries])
    late = quadratic_means([summary.rmse_after_transient for summary in summaries])
    stops = [f"run {index + 1}: {summary.stopped}" for index, summary in enumerate(summaries) if summary.stopped]
    stopped = None if not stops else stops[0] if len(stops) == 1 else f"{stops[0]}; and {len(stops) - 1} more"

    def known(name: str) -> list[Any]:
        return [value for one in summaries if (value := getattr(one, name)) is not None]

    return RunSummary(
        sum(one.measurements for one in summaries),
        min(known("period_min"), default=None), max(known("period_max"), default=None),
        max(known("error_final"), default=None), rmse, late, min(known("inclusion_margin"), default=None),
        any(one.diverged for one in summaries), any(one.left_domain for one in summaries),
        min(known("departure"), key=lambda departure: departure.time, default=None), stopped,
        {name: max(one.error_max[name] for one in summaries) for name in summaries[0].error_max
         if all(name in one.error_max for one in summaries)},
    )  # fmt: skip
