"""The charts that every simulation gets: states with their estimates and sample instants, and the error
with its proved envelope."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certificate import Bound
from cdobs_cli.chart import Chart, Panel, Series, SeriesKind
from cdobs_cli.plant import Plant
from cdobs_cli.report.equations import GREEK, latex, name_formula
from cdobs_cli.report.numbers import float_or_none
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.coordinates import Coordinates
    from cdobs_cli.run import Run, Trajectory
    from cdobs_cli.sensors import Sensor

MAX_PANELS = 8
MAX_RUNS = 20
MAX_STEMS = 150
_FAR_BELOW = 0.01
_ROOM = 1.3  # of an axis beyond what it is for


def axis_name(name: str) -> str:
    r"""A state's name for an axis: `theta` is $\theta$, `x1` is $x_{1}$; other words as they are."""
    stem = name.rstrip("0123456789").removesuffix("_")
    if len(stem) == 1 or stem in GREEK:
        return f"${latex(name_formula(name))}$"
    return name


def run_charts(
    plant: Plant, run: Run, envelope: Mapping[str, str] | None = None, coordinates: Coordinates | None = None,
    bounds: Mapping[str, Bound] | None = None, law: SamplingLaw | None = None,
) -> tuple[Chart, ...]:  # fmt: skip
    """The common charts of a run; the first trajectory stands for the states, all of them for the error."""
    if not run.trajectories or len(run.trajectories[0].t) < 2:
        return ()
    charts = [states_chart(plant, run.trajectories[0], len(run.summaries), law)]
    if coordinates is not None and "x_hat" in run.trajectories[0].estimates:
        charts.append(typed_states_chart(coordinates, run.trajectories[0]))
    error, intervals = error_chart(run, envelope), intervals_chart(run.trajectories[0], law)
    accuracy = None if run.comparison is None else accuracy_chart(plant, run, bounds or {})
    bands = bands_chart(plant, run, bounds or {})
    return (*charts, *(chart for chart in (error, bands, accuracy, intervals) if chart is not None))


def states_chart(plant: Plant, trajectory: Trajectory, runs: int = 1, law: SamplingLaw | None = None) -> Chart:
    """Each state with its estimate (or its band), and the measurements where an output is one state."""
    measured, lost = _measured_states(plant), lost_instants(trajectory, law)
    sensors = () if law is None else law.sensors
    shown, panels = set[int](), []
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        series = [Series("state", trajectory.t, trajectory.x[:, j], "line", "truth"), *_estimates(trajectory, j)]
        for k, scale in measured.get(j, ())[: None if sensors else 1] if len(trajectory.t_k) else ():
            series.append(_samples(trajectory, k, sensors, scale))
            series += _arrivals(trajectory, k, scale)
            shown.add(k)
            if len(lost):
                missed = np.interp(lost, trajectory.t, trajectory.x[:, j])
                series.append(Series("lost sample", lost, missed, "points", "refuted"))
        panels.append(Panel("time (s)", axis_name(name), tuple(series)))
    whose = ", each sensor's of their own" if sensors else ""
    caption = f"Each state with its estimate; dots are measurements{whose}, at the instants they are taken."
    if trajectory.arrival_k is not None:
        caption += " Crosses are those that come late, when they arrive; the estimate is what is known at each time."
    if len(trajectory.t_k) and (sensors or not measured):
        for k in range(min(plant.p, MAX_PANELS)):
            if k not in shown:
                own = (_samples(trajectory, k, sensors), *_arrivals(trajectory, k, 1.0))
                panels.append(Panel("time (s)", f"$y_{{{k + 1}}}$", own))
    if plant.n > MAX_PANELS:
        caption += f" The first {MAX_PANELS} of {plant.n} states are drawn."
    if runs > 1:
        caption += f" The first of {runs} runs."
    return Chart("states", "States and estimates", caption, tuple(panels))


def _samples(trajectory: Trajectory, k: int, sensors: Sequence[Sensor], scale: float = 1.0) -> Series:
    """Output k at the instants at which it is read, by the name of its sensor where there are several."""
    for place, sensor in enumerate(sensors):
        if k in sensor.outputs:
            t, y = trajectory.read_by(sensor)
            return Series(sensor.name, t, y[:, sensor.outputs.index(k)] / scale, "points", "measured", place=place)
    return Series("measurement", trajectory.t_k, trajectory.y_k[:, k] / scale, "points", "measured")


def typed_states_chart(coordinates: Coordinates, trajectory: Trajectory) -> Chart:
    """States and estimates in the coordinates that the user typed."""
    x = coordinates.original_values(trajectory.x)
    x_hat = coordinates.original_values(trajectory.estimates["x_hat"])
    panels = []
    for j, name in enumerate(coordinates.states[:MAX_PANELS]):
        state = Series("state", trajectory.t, x[:, j], "line", "truth")
        estimate = Series("estimate", trajectory.t, x_hat[:, j], "line", "estimate")
        panels.append(Panel("time (s)", axis_name(name), (state, estimate)))
    caption = "In the states of the spec, before the change of coordinates."
    return Chart("typed_states", "States and estimates as typed", caption, tuple(panels))


def _arrivals(trajectory: Trajectory, k: int, scale: float) -> tuple[Series, ...]:
    """The samples of an output that come late, where they are by the end of the run."""
    if trajectory.arrival_k is None:
        return ()
    t, late = trajectory.arrival_k[:, k], trajectory.arrival_k[:, k] > trajectory.t_k
    there = late & (t <= trajectory.t[-1])
    if not late.any():
        return ()
    return (Series("its arrival", t[there], trajectory.y_k[there, k] / scale, "points", "arrived"),)


def lost_instants(trajectory: Trajectory, law: SamplingLaw | None) -> Any:
    """When samples were to come and did not, up to the last one that came."""
    if law is None or not (law.is_lossy or law.is_random) or len(trajectory.t_k) < 2:
        return np.empty(0)
    h, t_k = float(law.T_min), trajectory.t_k
    gaps = np.round(np.diff(t_k) / h).astype(int)
    return np.concatenate([t + h * np.arange(1, gap) for t, gap in zip(t_k, gaps, strict=False)])


def _measured_states(plant: Plant) -> dict[int, list[tuple[int, float]]]:
    """State -> [(output, factor)] for outputs that are a multiple of one state."""
    measured: dict[int, list[tuple[int, float]]] = {}
    for k in range(plant.p if plant.h is None else 0):
        used = [(j, value) for j in range(plant.n) if (value := float(plant.C[k, j])) != 0]
        if len(used) == 1:
            measured.setdefault(used[0][0], []).append((k, used[0][1]))
    return measured


def _estimates(trajectory: Trajectory, j: int) -> tuple[Series, ...]:
    estimates = trajectory.estimates
    if "x_lower" in estimates and "x_upper" in estimates:
        lower, upper = estimates["x_lower"][:, j], estimates["x_upper"][:, j]
        return (Series("interval estimate", trajectory.t, lower, "band", "estimate", upper),)
    if "x_hat" in estimates:
        return (Series("estimate", trajectory.t, estimates["x_hat"][:, j], "line", "estimate"),)
    return tuple(Series(name, trajectory.t, values[:, j], "line", "other") for name, values in estimates.items())


def error_chart(run: Run, envelope: Mapping[str, str] | None) -> Chart | None:
    """|x - x_hat| on a logarithmic axis, with factor |e(0)| exp(-rate t) where that is proved; None without
    a point estimate."""
    first = run.trajectories[0]
    if "x_hat" not in first.estimates:
        return None
    series = []
    shown = run.trajectories[:MAX_RUNS]
    start = 0.0
    for index, trajectory in enumerate(shown):
        error = np.linalg.norm(trajectory.x - trajectory.estimates["x_hat"], axis=1)
        start = max(start, float(error[0])) if np.isfinite(error[0]) else start
        label = "error" if len(shown) == 1 else f"error, run {index + 1}"
        series.append(Series(label, trajectory.t, error, "line", "estimate"))
    caption = "Norm of the estimation error."
    if envelope and start > 0:
        t = np.linspace(float(first.t[0]), float(first.t[-1]), 200)
        bound = float(envelope["factor"]) * start * np.exp(-float(envelope["rate"]) * (t - t[0]))
        # Far below the errors of a noisy run it would only press them together.
        errors = np.concatenate([one.y for one in series])
        keep = bound >= _FAR_BELOW * float(np.min(errors, where=errors > 0, initial=np.inf))
        series.append(Series("proved envelope", t[keep], bound[keep], "line", "proved"))
        caption += " The envelope holds for every plant of the class, without disturbance and noise."
    if len(run.summaries) > MAX_RUNS:
        caption += f" The first {MAX_RUNS} of {len(run.summaries)} runs are drawn."
    panel = Panel("time (s)", r"$|x - \hat{x}|$", tuple(series), y_scale="log")
    return Chart("error", "Estimation error", caption, (panel,))


def bands_chart(plant: Plant, run: Run, bounds: Mapping[str, Bound]) -> Chart | None:
    """How large the error of each state is over all runs: percentiles at each time, the worst run, what is proved; None
    where every run is drawn."""
    bands, ensemble = run.bands, run.ensemble
    if bands is None or ensemble is None:
        return None
    worst = run.trajectories[ensemble.shown.index(ensemble.worst)]
    panels = []
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        at = dict(zip(bands.levels, bands.values[name], strict=True))
        floor = _smallest_seen(at[50.0])
        low, quarter, median, most, high, largest = (np.maximum(at[one], floor) for one in sorted(at))
        series = [
            Series("5 % to 95 % of the runs", bands.t, low, "band", "beside", high),
            Series("middle half", bands.t, quarter, "band", "estimate", most),
            Series("median", bands.t, median, "line", "estimate"),
            Series("largest of all", bands.t, largest, "line", "refuted"),
        ]
        if "x_hat" in worst.estimates:
            error = np.abs(worst.estimates["x_hat"][:, j] - worst.x[:, j])
            series.append(Series("worst run", worst.t, np.maximum(error, floor), "line", "truth"))
        proved = float_or_none(bounds[f"error.{name}"].proved) if f"error.{name}" in bounds else None
        if proved is not None and math.isfinite(proved):
            series.append(Series("proved in the long run", bands.t[[0, -1]], [proved, proved], "line", "proved"))
        panels.append(Panel("time (s)", f"|error of {axis_name(name)}|", tuple(series), y_scale="log"))
    diverged = f" {100 * ensemble.diverged:.3g} % of them diverged." if ensemble.diverged else " None of them diverged."
    caption = f"Size of the error over all {ensemble.runs} runs; the worst is run {ensemble.worst + 1}.{diverged}"
    return Chart("bands", "Errors of all runs", caption, tuple(panels))


def _smallest_seen(median: Any) -> float:
    """Where the axis of an error ends below: a logarithm has no 0, and below rounding nothing is told apart."""
    sizes = median[np.isfinite(median) & (median > 0)]
    return float(max(sizes.min() / 100, sizes.max() * 1e-14)) if len(sizes) else 1e-300


def accuracy_chart(plant: Plant, run: Run, bounds: Mapping[str, Bound]) -> Chart | None:
    """The error of each state under the declared disturbance and noise, within its proved bound, above that of the
    filter beside it; what is left of the initial error goes beyond the axes."""
    first = run.trajectories[0]
    if "x_hat" not in first.estimates:
        return None
    panels, errors = [], first.estimates["x_hat"] - first.x
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        kind = next((kind for kind in ("error", "rms") if f"{kind}.{name}" in bounds), None)
        proved = None if kind is None else float_or_none(bounds[f"{kind}.{name}"].proved)
        series = [Series("observer", first.t, errors[:, j], "line", "estimate")]
        largest = _largest(first.t, errors[:, j])
        if run.filtered is not None:
            theirs = run.filtered.error[:, j]
            series.append(Series("Kalman filter", run.filtered.t, theirs, "line", "beside"))
            largest = max(largest, _largest(run.filtered.t, theirs))
        if proved is not None and math.isfinite(proved):
            label, ends = f"proved bound{' of the rms' if kind == 'rms' else ''}", [first.t[0], first.t[-1]]
            series.insert(0, Series(label, ends, [-proved, -proved], "band", "proved", [proved, proved]))
            largest = max(largest, proved)
        seen = (-_ROOM * largest, _ROOM * largest) if 0 < largest < math.inf else None
        panels.append(Panel("time (s)", f"error of {axis_name(name)}", tuple(series), y_range=seen))
    caption = "Estimate less state in run 1; the axes are for what is left after the transient, which goes beyond them."
    if run.filtered is not None:
        caption += " The thin line is the extended Kalman filter on the same measurements."
    if plant.n > MAX_PANELS:
        caption += f" The first {MAX_PANELS} of {plant.n} states are drawn."
    return Chart("accuracy", "Accuracy", caption, tuple(panels))


def _largest(t: Any, error: Any) -> float:
    """Of an error, over the second half of its time."""
    late = error[t >= (t[0] + t[-1]) / 2]
    return float(np.abs(late[np.isfinite(late)]).max(initial=0.0))


def intervals_chart(trajectory: Trajectory, law: SamplingLaw | None = None) -> Chart | None:
    """The time from each sample to the next; None where it is constant, or of several sensors."""
    periods = np.diff(trajectory.t_k)
    if law is not None and law.has_sensors:  # the sensors' own samples are drawn
        return None
    if len(periods) < 2 or float(np.ptp(periods)) <= 1e-9 * float(np.max(np.abs(periods))):
        return None
    kind: SeriesKind = "stems" if len(periods) <= MAX_STEMS else "line"
    series = Series("sampling interval", trajectory.t_k[:-1], periods, kind, "measured")
    panel = Panel("time (s)", r"$t_{k+1} - t_k$ (s)", (series,))
    return Chart("sampling", "Sampling intervals", "The time from each sample to the next.", (panel,))
