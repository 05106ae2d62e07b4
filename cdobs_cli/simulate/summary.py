"""From what was recorded to trajectories and their figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.run import Departure, Run, RunSummary, Trajectory
from cdobs_cli.simulate.departure import LARGEST
from cdobs_cli.simulate.loop import ClosedLoop, View
from cdobs_cli.simulate.record import Record
from cdobs_cli.simulate.watch import Watch

ENCLOSURE_ROUNDING = 1e-9  # of the largest value met: a state outside its bounds by less is on them


def summarise(loop: ClosedLoop, watch: Watch, record: Record, final_t: Array, final_y: Array, final_held: Array) -> Run:
    """Trajectories with estimates, and their figures; final_t (R,), final_y (n, R), final_held (c, R)."""
    trajectories, summaries = [], []
    points, measurements = record.points(final_t, final_y, final_held), record.measurements(len(final_t))
    for run, ((t, y, held), (t_k, y_k)) in enumerate(zip(points, measurements, strict=True)):
        seen = loop.see(t, y, held)
        loop.signals.refuse_outside(t, seen.signals)
        inputs = {source.name: seen.signals[source.name] for source in loop.plant.inputs}
        inputs |= {name: values for name, values in seen.signals.items() if name.startswith("d.")}
        estimates = {name: rows.T for name, rows in seen.estimates.items()}
        path = Trajectory(t, seen.x.T, estimates, dict(seen.internals), t_k, y_k, inputs, watch.stopped[run])
        trajectories.append(path)
        margin = _margin(min(watch.margin[run], seen.margin.min()), seen) if seen.encloses else None
        watch.departures.look(np.full(len(t), run), t, seen.x, seen.estimates.get("x_hat"))
        diverged, departure = bool(watch.diverged[run]), watch.departures.of(run)
        summaries.append(summary(loop.plant.states, path, seen, margin, diverged=diverged, departure=departure))
    return Run(tuple(trajectories), tuple(summaries), overall(summaries))


def _margin(smallest: float, seen: View) -> float:
    """The smallest distance of a state from its bounds, negative outside; 0 where that is rounding."""
    values = (seen.x, seen.estimates["x_lower"], seen.estimates["x_upper"])
    size = max(float(np.abs(rows[np.isfinite(rows)]).max(initial=0.0)) for rows in values)
    if -ENCLOSURE_ROUNDING * size <= smallest < 0:
        return 0.0
    return float(np.clip(smallest, -LARGEST, LARGEST))


def summary(
    states: Sequence[str], path: Trajectory, seen: View, margin: float | None, *, diverged: bool,
    departure: Departure | None,
) -> RunSummary:  # fmt: skip
    """The figures of one run. Periods are between its measurements, the one at t_0 included; rmse is the root of the
    time average of the squared error (trapezoids over the output grid), of the whole run and of its second half, where
    what is left of the initial error is small if the run is long enough to show anything."""
    # Instants are good to about 1e-12: digits beyond that are rounding of the differences.
    periods = [float(f"{period:.12g}") for period in np.diff(path.t_k)]
    error, final = seen.error, None
    rmse, late, most = dict[str, float](), dict[str, float](), dict[str, float]()
    if error is not None:
        sizes = zip(states, np.abs(error).max(axis=1), strict=True)
        most = {name: float(size) for name, size in sizes if np.isfinite(size)}
        final = _finite(_size(error[:, -1]))
        rmse, late = root_mean_squares(states, path.t, error), root_mean_squares(states, path.t, error, late=True)
    return RunSummary(
        len(path.t_k), min(periods, default=None), max(periods, default=None),
        final, rmse, late, margin, diverged, departure is not None, departure, path.stopped, most,
    )  # fmt: skip


def root_mean_squares(states: Sequence[str], t: Array, error: Array, *, late: bool = False) -> dict[str, float]:
    """Of each row of error (n, N) over t (N,), or over its second half; by state, those that floats hold."""
    if late:
        after = t >= t[0] + 0.5 * (1.0 - 1e-12) * (t[-1] - t[0])
        t, error = t[after], error[:, after]
    means = {name: _finite(_root_mean_square(t, row)) for name, row in zip(states, error, strict=True)}
    return {name: value for name, value in means.items() if value is not None}


def _root_mean_square(t: Array, values: Array) -> float:
    length, largest = float(t[-1] - t[0]), float(np.abs(values).max())
    if not length > 0 or largest == 0:
        return float(abs(values[-1]))
    squares = (values / largest) ** 2
    return largest * float(np.sqrt(np.diff(t) @ (squares[:-1] + squares[1:]) / (2 * length)))


def _size(vector: Array) -> float:
    """Its length, without overflow on the way."""
    largest = float(np.abs(vector).max())
    return largest * float(np.sqrt(((vector / largest) ** 2).sum())) if largest != 0 else 0.0


def _finite(value: float) -> float | None:
    """JSON has no infinity: a figure beyond floats is left out."""
    return value if np.isfinite(value) else None


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
