"""Figures of the paper's example: input and measurements, delta_k, L(t), c along the estimate."""

from __future__ import annotations

from typing import Any

import numpy as np

from cdobs_cli.certificate import Check
from cdobs_cli.chart import Chart, Exhibits, Panel, Role, Series, Table
from cdobs_cli.design import Design
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run, Trajectory

_TIME = "time (s)"
MAX_TEETH = 40  # of a saw that an eye can follow
_CAPTION = (
    "No sampling period is shorter while c stays below its bound. "
    "The last column is what the periods come down to for constant c."
)  # fmt: skip
_NOISE = (
    "The theorems say nothing of noise, which the gain delta L K amplifies: "
    "a smaller alpha trades accuracy for more samples."
)  # fmt: skip
_FOOTNOTE = (
    "The footnote's a_2 >= 2 (N_1 + N_2) / (p_3 p_1) lacks a factor n: step 3 of the proof needs "
    "2 n (N_1 + N_2) / (p_3 p_1), or n max(N_1, 2 N_2) / (p_3 p_1), which is what is used here."
)


def exhibits(plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """What the report shows beyond the common figures.

    Source: Andrieu2014, Figures 1, 2, 4
    """
    if design.outcome == "none":
        return Exhibits()
    charts: list[Chart] = []
    if run is not None and run.trajectories and len(run.trajectories[0].t_k) > 1:
        first = run.trajectories[0]
        charts = [*_inputs(first), _periods(first, check), _gain(first)]
    return Exhibits(tuple(charts), tuple(_tables(check)), _notes(design))


def _inputs(run: Trajectory) -> list[Chart]:
    panels = tuple(_line(name, name, run, values) for name, values in run.inputs.items())
    return [Chart("inputs", "Inputs", "The known inputs, in the first run.", panels)] if panels else []


def _line(axis: str, name: str, run: Trajectory, values: Any, role: Role = "other") -> Panel:
    return Panel(_TIME, axis, (Series(name, run.t, values, "line", role),))


def _periods(run: Trajectory, check: Check | None) -> Chart:
    delta = np.diff(run.t_k)
    series = [Series(r"$\delta_k$", run.t_k[1:], delta, "points", "measured")]
    bound = None if check is None else check.bounds.get("guaranteed_period")
    caption = "The sampling periods that the observer chose."
    # A bound far below every period would only squeeze the figure.
    if bound is not None and bound.proved is not None and float(bound.proved) > 0.02 * float(delta.max()):
        series.append(Series("guaranteed", [float(run.t_k[1])], [float(bound.proved)], "limit", "proved"))
        caption += " The line is the period that is guaranteed."
    panel = Panel(_TIME, r"$\delta_k$ (s)", tuple(series))
    return Chart("sampling", "Updated sampling periods", caption, (panel,))


def _gain(run: Trajectory) -> Chart:
    L, c = run.internals["L"], run.internals["c"]
    series: list[Series] = [Series("L(t)", run.t, L, "line", "estimate")]
    caption = "The gain L(t) falls towards 1 at samples and rises with c(x_hat, u) in between."
    if len(run.t_k) > MAX_TEETH:
        # The last grid point at an instant is just after its jump.
        after = np.searchsorted(run.t, run.t_k, side="right") - 1
        highest = np.maximum.reduceat(L, after)
        series = [
            Series("between two samples", run.t_k, L[after], "band", "estimate", highest),
            Series("L just after a sample", run.t_k, L[after], "line", "estimate"),
        ]
        caption += " The band is how far L goes up from each sample to the next."
    panels = (Panel(_TIME, "L", tuple(series)), _line("c", "c at the estimate", run, c))
    return Chart("high_gain", "High gain L", caption, panels)


def _tables(check: Check | None) -> list[Table]:
    if check is None or not check.bounds:
        return []
    names = {
        "guaranteed_period": "fixed point of (6)-(7), exact",
        "guaranteed_period.lemma_1": "constants of Lemma 1",
        "guaranteed_period.constant": "constant period and gain, c known in advance",
    }
    rows: list[tuple[Any, ...]] = [(names[key], bound) for key, bound in check.bounds.items() if key in names]
    columns = ("bound", "at least (s)", "falls to (s)")
    return [Table("guaranteed_periods", "Guaranteed sampling period", _CAPTION, columns, tuple(rows))]


def _notes(design: Design) -> tuple[str, ...]:
    used = any(certificate.method == "theorem_2" for certificate in design.certificates)
    return (_NOISE, _FOOTNOTE) if used else (_NOISE,)
