"""The charts that every simulation gets: states with their estimates and sample instants, and the error
with its proved envelope."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certificate import Bound
from cdobs_cli.chart import Chart, Panel, Series, SeriesKind
from cdobs_cli.plant import Plant
from cdobs_cli.report.equations import GREEK, Accent, Script, Symbol, latex, name_formula
from cdobs_cli.report.numbers import float_or_none
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.coordinates import Coordinates
    from cdobs_cli.run import Run, Trajectory
    from cdobs_cli.sensors import Sensor

MAX_PANELS = 8
MAX_RUNS = 20
MAX_STEMS = 60
MAX_DOTS = 60  # measurements of an output that are drawn
_SEPARATE = 2  # runs that are drawn as lines of their own; more are a band
_INSTANTS = 400  # of a band
_WINDOWS = 50
_PEAKS = 150
_SETTLED = 0.02  # of a state's range: a smaller error is not seen in it
_FLOOR = 8.0  # units in the last place
_EARLY = 0.3  # of the horizon: a shorter transient gets a larger scale
_ROOM = 1.3  # of an axis beyond what it is for


def axis_name(name: str) -> str:
    r"""A state's name for an axis: `theta` is $\theta$, `omega_m` is $\omega_{m}$; other words as they are."""
    piece = name_formula(name)
    base = piece.base if isinstance(piece, Script) else piece
    base = base.body if isinstance(base, Accent) else base
    if isinstance(base, Symbol) and (len(base.text) == 1 or base.text in GREEK):
        return f"${latex(piece)}$"
    return name


def run_charts(
    plant: Plant, run: Run, envelope: Mapping[str, str] | None = None, coordinates: Coordinates | None = None,
    bounds: Mapping[str, Bound] | None = None, law: SamplingLaw | None = None,
) -> tuple[Chart, ...]:  # fmt: skip
    """The common charts of a run; the first trajectory stands for the states, all of them for the error."""
    if not run.trajectories or len(run.trajectories[0].t) < 2:
        return ()
    first = run.trajectories[0]
    charts = [states_chart(plant, first, len(run.summaries), law)]
    if coordinates is not None and "x_hat" in first.estimates:
        charts.append(typed_states_chart(coordinates, first))
    errors = bands_chart(plant, run, bounds or {}, envelope) or error_chart(plant, run, envelope)
    accuracy = None if run.comparison is None else accuracy_chart(plant, run, bounds or {})
    return (*charts, *(one for one in (errors, accuracy, intervals_chart(first, law)) if one is not None))


def transient_end(trajectory: Trajectory) -> float | None:
    """Until when the errors, or the widths, are seen beside the states; None where that is no small part of the run."""
    estimates = trajectory.estimates
    if "x_hat" in estimates:
        sizes = np.abs(estimates["x_hat"] - trajectory.x)
    elif "x_lower" in estimates and "x_upper" in estimates:
        sizes = np.abs(estimates["x_upper"] - estimates["x_lower"])
    else:
        return None
    t, x = trajectory.t, trajectory.x
    if len(t) < 3 or not (np.isfinite(sizes).all() and np.isfinite(x).all()):
        return None
    late = sizes[t >= (t[0] + t[-1]) / 2].max(axis=0)
    seen = (sizes > np.maximum(_SETTLED * np.ptp(x, axis=0), 1.2 * late)).any(axis=1)
    if not seen.any():
        return None
    end = 1.2 * float(t[np.flatnonzero(seen)[-1]] - t[0])
    if not 0 < end < _EARLY * float(t[-1] - t[0]):
        return None
    unit = 10.0 ** math.floor(math.log10(end))
    return float(
        f"{next(one for one in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0) if one * unit >= end) * unit:.6g}"
    )


def _stretched(end: float | None) -> str:
    """What a caption says of it."""
    return "" if end is None else f" Up to t = {end:g} (shaded) the time axis has a larger scale."


def _thinned(t: Any, stretch: float | None) -> tuple[Any, int]:
    """Which of many instants are drawn, at most so many of each part of the axis, and one in how many at the least."""
    t, ends = np.asarray(t), [-math.inf, *([] if stretch is None else [stretch]), math.inf]
    kept, least, most = [], 1, MAX_DOTS // (len(ends) - 1)
    for low, high in pairwise(ends):
        own = np.flatnonzero((t >= low) & (t < high))
        step = max(1, math.ceil(len(own) / most))
        kept.append(own[::step])
        least = max(least, step)
    return np.concatenate(kept), least


def _left_out(least: int) -> str:
    return f" Of many instants, down to one in {least} is drawn." if least > 1 else ""


def states_chart(plant: Plant, trajectory: Trajectory, runs: int = 1, law: SamplingLaw | None = None) -> Chart:
    """Each state with its estimate (or its band), and the measurements where an output is one state."""
    measured, lost = _measured_states(plant), lost_instants(trajectory, law)
    sensors = () if law is None else law.sensors
    stretch = transient_end(trajectory)
    shown, panels, thinned = set[int](), [], [1]
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        series = [Series("state", trajectory.t, trajectory.x[:, j], "line", "truth"), *_estimates(trajectory, j)]
        for k, scale in measured.get(j, ())[: None if sensors else 1] if len(trajectory.t_k) else ():
            samples, least = _few(_samples(trajectory, k, sensors, scale), stretch)
            series += [samples, *(_few(one, stretch)[0] for one in _arrivals(trajectory, k, scale))]
            thinned.append(least)
            shown.add(k)
            if len(lost):
                missed = np.interp(lost, trajectory.t, trajectory.x[:, j])
                series.append(_few(Series("lost sample", lost, missed, "points", "refuted"), stretch)[0])
        panels.append(Panel("time (s)", axis_name(name), tuple(series)))
    if not trajectory.estimates:
        caption = "The states of the plant; dots are what would be measured."
    elif len(trajectory.t_k):
        whose = ", each sensor's of their own" if sensors else ""
        caption = f"Each state with its estimate; dots are measurements{whose}, at the instants they are taken."
    else:
        caption = "Each state with its estimate."
    if trajectory.arrival_k is not None:
        caption += " Crosses are those that come late, when they arrive; the estimate is what is known at each time."
    if len(trajectory.t_k) and (sensors or not measured):
        for k in range(min(plant.p, MAX_PANELS)):
            if k not in shown:
                samples, least = _few(_samples(trajectory, k, sensors), stretch)
                own = (samples, *(_few(one, stretch)[0] for one in _arrivals(trajectory, k, 1.0)))
                thinned.append(least)
                panels.append(Panel("time (s)", f"$y_{{{k + 1}}}$", own))
    caption += _left_out(max(thinned)) + _stretched(stretch)
    if plant.n > MAX_PANELS:
        caption += f" The first {MAX_PANELS} of {plant.n} states are drawn."
    if runs > 1:
        caption += f" The first of {runs} runs."
    title = "States and estimates" if trajectory.estimates else "States"
    return Chart("states", title, caption, tuple(panels), stretch)


def _few(series: Series, stretch: float | None) -> tuple[Series, int]:
    """Markers that do not bury what is below them, and one in how many they are."""
    kept, least = _thinned(series.x, stretch)
    return replace(series, x=np.asarray(series.x)[kept], y=np.asarray(series.y)[kept]), least


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
    stretch = transient_end(trajectory)
    caption = f"In the states of the spec, before the change of coordinates.{_stretched(stretch)}"
    return Chart("typed_states", "States and estimates as typed", caption, tuple(panels), stretch)


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


def error_chart(plant: Plant, run: Run, envelope: Mapping[str, str] | None) -> Chart | None:
    """The error of each state on a logarithmic axis, with factor |e(0)| exp(-rate t) where that is proved, down to what
    rounding leaves of it; None without a point estimate."""
    first = run.trajectories[0]
    if "x_hat" not in first.estimates:
        return None
    shown = run.trajectories[:MAX_RUNS]
    errors = [np.abs(one.estimates["x_hat"] - one.x) for one in shown]
    floors = np.max([_rounding(one) for one in shown], axis=0)
    end = max(_floor_reached(one.t, error, floors) for one, error in zip(shown, errors, strict=True))
    stretch = transient_end(first) if end >= float(first.t[-1]) else None
    is_busy = plant.is_perturbed and len(first.t) > 2 * _INSTANTS
    start = max((float(np.linalg.norm(one[0])) for one in errors if np.isfinite(one[0]).all()), default=0.0)
    panels = []
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        curves = [(one.t[one.t <= end], error[one.t <= end, j]) for one, error in zip(shown, errors, strict=True)]
        lowest = max(float(floors[j]), min(map(_lowest_seen, (y for _, y in curves))) / 3)
        if is_busy:
            curves = [_peaks(*one, stretch) for one in curves]
        series = _runs(curves, lowest)
        series += _envelope(envelope, start, float(first.t[0]), min(end, float(first.t[-1])), lowest)
        panels.append(Panel("time (s)", error_label(name), tuple(series), y_scale="log", y_range=(lowest, math.inf)))
    caption = f"Size of the error of each state{'' if len(shown) == 1 else f' in {len(shown)} runs'}."
    if len(run.summaries) > MAX_RUNS:
        caption += f" The first {MAX_RUNS} of {len(run.summaries)} runs are drawn."
    caption += _of_envelope(plant, envelope)
    if end < float(first.t[-1]):
        caption += f" Axes end where rounding is all that is left, {_FLOOR:g} units in the last place of the state;"
        caption += f" every error has come there by t = {end:.3g} of {float(first.t[-1]):g}."
    if is_busy:
        caption += f" Under noise and disturbance only peaks are drawn: the largest of each {_PEAKS}th of the axis."
    return Chart("error", "Estimation error", caption + _stretched(stretch), tuple(panels), stretch)


def error_label(name: str) -> str:
    shown = axis_name(name)
    hat = latex(name_formula(f"hat.{name}"))
    return f"$|{hat} - {shown[1:-1]}|$" if shown.startswith("$") else f"$|$error$|$ of {name}"


def _peaks(t: Any, error: Any, stretch: float | None) -> tuple[Any, Any]:
    """The largest error of each small part of an axis: a curve without the zeros in between."""
    share = 1.0 if stretch is None else _EARLY
    first = np.linspace(t[0], t[-1] if stretch is None else stretch, round(share * _PEAKS) + 1)
    rest: Any = [] if stretch is None else np.linspace(stretch, t[-1], round((1 - share) * _PEAKS) + 1)[1:]
    edges = np.unique(np.searchsorted(t, np.concatenate([first, rest])[:-1]))
    return t[edges], np.maximum.reduceat(error, edges)


def _rounding(trajectory: Trajectory) -> Any:
    """Of each state the error below which the numbers of a computer tell nothing apart, shape (n,)."""
    sizes = np.where(np.isfinite(trajectory.x), np.abs(trajectory.x), 0.0).max(axis=0)
    return np.maximum(_FLOOR * np.finfo(float).eps * sizes, 1e-300)


def _floor_reached(t: Any, error: Any, floors: Any) -> float:
    """From when on all errors are rounding, or the end of the run."""
    above = np.flatnonzero(~(error <= floors).all(axis=1))
    return float(t[min(above[-1] + 1, len(t) - 1)]) if len(above) else float(t[-1])


def _lowest_seen(error: Any) -> float:
    """The lowest that an error comes to, zeros that it passes through left aside."""
    parts = (part[np.isfinite(part)] for part in np.array_split(error, min(_WINDOWS, max(1, len(error)))))
    return min((float(part.max()) for part in parts if len(part) and part.max() > 0), default=math.inf)


def _runs(curves: Sequence[tuple[Any, Any]], lowest: float) -> list[Series]:
    """Few runs as lines, more as the band between their smallest and largest errors, with the median."""
    if len(curves) <= _SEPARATE:
        names = ["error"] if len(curves) == 1 else [f"run {index + 1}" for index in range(len(curves))]
        return [
            Series(name, t, np.maximum(y, lowest), "line", "estimate")
            for name, (t, y) in zip(names, curves, strict=True)
        ]
    t = np.linspace(min(float(t[0]) for t, _ in curves), max(float(t[-1]) for t, _ in curves), _INSTANTS)
    over = np.maximum(np.array([np.interp(t, *curve) for curve in curves]), lowest)
    low, middle, high = over.min(axis=0), np.median(over, axis=0), over.max(axis=0)
    band = Series("smallest to largest of the runs", t, low, "band", "estimate", high)
    return [band, Series("median", t, middle, "line", "estimate")]


def _envelope(envelope: Mapping[str, str] | None, start: float, first: float, last: float, low: float) -> list[Series]:
    """factor |e(0)| exp(-rate t), as far as it is above the axis."""
    if not envelope or start <= 0:
        return []
    t = np.linspace(first, last, 200)
    bound = float(envelope["factor"]) * start * np.exp(-float(envelope["rate"]) * (t - first))
    return [Series("proved envelope", t[bound >= low], bound[bound >= low], "line", "proved")]


def _of_envelope(plant: Plant, envelope: Mapping[str, str] | None) -> str:
    if not envelope:
        return ""
    told = " The envelope bounds the norm of all of them, for every plant of the class"
    return f"{told}{', without disturbance and noise' if plant.is_perturbed else ''}."


def bands_chart(
    plant: Plant, run: Run, bounds: Mapping[str, Bound], envelope: Mapping[str, str] | None = None
) -> Chart | None:
    """How large the error of each state is over all runs: percentiles at each time, the worst run, what is proved; None
    where every run is drawn."""
    bands, ensemble = run.bands, run.ensemble
    if bands is None or ensemble is None:
        return None
    worst = run.trajectories[ensemble.shown.index(ensemble.worst)]
    floors = _rounding(worst)
    starts = (dict(zip(bands.levels, one, strict=True))[100.0][0] for one in bands.values.values())
    start = math.hypot(*(float(one) for one in starts if math.isfinite(one)))
    panels = []
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        at = dict(zip(bands.levels, bands.values[name], strict=True))
        floor = max(float(floors[j]), _smallest_seen(at[50.0]))
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
        series += _envelope(envelope, start, float(bands.t[0]), float(bands.t[-1]), floor)
        panels.append(Panel("time (s)", error_label(name), tuple(series), "log", y_range=(floor, math.inf)))
    diverged = f" {100 * ensemble.diverged:.3g} % of them diverged." if ensemble.diverged else " None of them diverged."
    caption = f"Size of the error over all {ensemble.runs} runs; the worst is run {ensemble.worst + 1}.{diverged}"
    caption += _of_envelope(plant, envelope)
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
    kept, least = np.arange(len(periods)), 1
    kind: SeriesKind = "stems" if len(periods) <= MAX_STEMS else "points"
    if len(periods) > _INSTANTS:
        kept, least = (
            np.arange(0, len(periods), math.ceil(len(periods) / _INSTANTS)),
            math.ceil(len(periods) / _INSTANTS),
        )
    series = Series("sampling interval", trajectory.t_k[:-1][kept], periods[kept], kind, "measured")
    panel = Panel("time (s)", r"$t_{k+1} - t_k$ (s)", (series,), y_range=(0.0, math.inf))
    caption = f"The time from each sample to the next.{_left_out(least)}"
    return Chart("sampling", "Sampling intervals", caption, (panel,))
