"""Charts of sensors that send on change: each output against its threshold, and how many messages that takes."""

from __future__ import annotations

import numpy as np

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.design import Design
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run, Trajectory

_ROOM = 1.8  # of an axis, beyond the threshold


def messages_charts(plant: Plant, design: Design, run: Run | None) -> list[Chart]:
    """Of the first run."""
    law = design.sampling
    if not law.is_on_change or run is None or "x_hat" not in run.trajectories[0].estimates:
        return []
    path = run.trajectories[0]
    if len(path.t) < 2:
        return []
    told = _counts(float(law.T_max), path)
    residuals = np.abs((path.x - path.estimates["x_hat"]) @ plant.C.floats.T)
    panels = []
    for one in law.thresholds:
        sent, delta = ~np.isnan(path.y_k[:, one.output]), float(one.delta)
        series = [
            Series("difference from the prediction", path.t, residuals[:, one.output], "line", "estimate"),
            Series("threshold", path.t[[0, -1]], [delta, delta], "line", "refuted"),
        ]
        if sent.any():
            at = path.t_k[sent]
            before = np.minimum(np.searchsorted(path.t, at), len(path.t) - 1)
            series.append(Series("message", at, residuals[before, one.output], "points", "measured"))
        label = r"$|y - C \hat{x}|$" + (f" ({one.name})" if len(law.thresholds) > 1 else "")
        panels.append(Panel("time (s)", label, tuple(series), y_range=(0.0, _ROOM * delta)))
    t, number = np.append(path.t_k, path.t[-1]), np.append(np.arange(1, len(path.t_k) + 1), len(path.t_k))
    counted = [Series("messages", np.insert(t, 0, 0.0), np.insert(number, 0, 0), "steps", "measured")]
    least, most = _shortest(path), float(len(path.t_k))
    if least is not None:
        ends = path.t[[0, -1]]
        name = f"one every {least:.3g}, as this sensor at its most in the second half"
        counted.append(Series(name, ends, ends / least, "line", "beside"))
        most = max(most, float(ends[1]) / least)
    panels.append(Panel("time (s)", "messages", tuple(counted), y_range=(0.0, 1.1 * max(1.0, most))))
    noise = " Noise is not in the difference that is drawn." if plant.is_noisy else ""
    caption = f"{told} The difference may be above the threshold between comparisons alone.{noise}"
    if not law.is_checked:
        caption = f"{told}{noise}"
    return [Chart("messages", "Messages", caption, tuple(panels))]


def _shortest(path: Trajectory) -> float | None:
    """The shortest time between two instants with messages in the second half of the run."""
    late = np.unique(path.t_k[path.t_k >= path.t[-1] / 2])
    return float(np.diff(late).min()) if len(late) > 2 else None


def _counts(h: float, path: Trajectory) -> str:
    """h: the time between comparisons, 0 where there is none."""
    count, length = len(path.t_k), float(path.t[-1])
    if not h:
        return f"{count} messages in the first run."
    checks = int(np.floor(length / h * (1 + 1e-12))) + 1
    return f"{count} messages in the first run, of {checks} comparisons: {100 * (1 - count / checks):.3g} % are saved."
