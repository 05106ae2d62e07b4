"""Figures of the paper's example: input and measurements, delta_k, L(t), c along the estimate."""

from __future__ import annotations

from typing import Any

from cdobs_cli.certificate import Check
from cdobs_cli.chart import Chart, Exhibits, Panel, Series, Table
from cdobs_cli.design import Design
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run, Trajectory

_TIME = "time (s)"


def exhibits(plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """What the report shows beyond the common figures.

    Source: Andrieu2014, Figures 1, 2, 4
    """
    if design.outcome == "none":
        return Exhibits()
    charts: list[Chart] = []
    if run is not None and run.trajectories and len(run.trajectories[0].t_k) > 1:
        first = run.trajectories[0]
        charts = [_measured(plant, first), _periods(first, check), _gain(first)]
    return Exhibits(tuple(charts), tuple(_tables(check)), _notes(design))


def _measured(plant: Plant, run: Trajectory) -> Chart:
    panels = [Panel(_TIME, name, (Series(name, run.t, values, "line", "other"),)) for name, values in run.inputs.items()]
    state = plant.states[0]
    output = (
        Series(f"{state}(t)", run.t, run.x[:, 0], "line", "truth"),
        Series("measured", run.t_k, run.y_k[:, 0], "points", "measured"),
    )
    panels.append(Panel(_TIME, state, output))
    return Chart("inputs_and_measurements", "Inputs and measurements", "The known inputs, and the measurements at the instants "
                 "that the observer asked for.", tuple(panels))  # fmt: skip


def _periods(run: Trajectory, check: Check | None) -> Chart:
    import numpy as np

    delta = np.diff(run.t_k)
    series = [Series(r"$\delta_k$", run.t_k[1:], delta, "points", "measured")]
    bound = None if check is None else check.bounds.get("guaranteed_period")
    caption = "The sampling periods that the observer chose."
    # A bound far below every period would only squeeze the figure.
    if bound is not None and bound.proved is not None and float(bound.proved) > 0.02 * float(delta.max()):
        series.append(Series("guaranteed", [float(run.t_k[1])], [float(bound.proved)], "limit", "proved"))
        caption += " The line is the period that is guaranteed."
    return Chart("sampling_periods", "Updated sampling periods", caption, (Panel(_TIME, r"$\delta_k$ (s)", tuple(series)),))


def _gain(run: Trajectory) -> Chart:
    panels = (
        Panel(_TIME, "$L$", (Series("L(t)", run.t, run.internals["L"], "line", "estimate"),)),
        Panel(_TIME, "$c$", (Series("c at the estimate", run.t, run.internals["c"], "line", "other"),)),
    )
    return Chart("high_gain", "High gain L", "The gain L(t) falls towards 1 at samples and rises with c(x_hat, u) in between.", panels)


def _tables(check: Check | None) -> list[Table]:
    if check is None or not check.bounds:
        return []
    names = {
        "guaranteed_period": "fixed point of (6)-(7), exact",
        "guaranteed_period.lemma_1": "constants of Lemma 1",
        "guaranteed_period.constant": "constant period and gain, c known in advance",
    }
    rows: list[tuple[Any, ...]] = [(names[key], bound) for key, bound in check.bounds.items() if key in names]
    caption = (
        "No sampling period is shorter while c stays below its bound. The last column is what the periods come down to for constant c."
    )
    return [Table("guaranteed_periods", "Guaranteed sampling period", caption, ("bound", "at least (s)", "falls to (s)"), tuple(rows))]


def _notes(design: Design) -> tuple[str, ...]:
    notes = ["The theorems say nothing of noise, which the gain delta L K amplifies: a smaller alpha trades accuracy for more samples."]
    if any(certificate.method == "theorem_2" for certificate in design.certificates):
        notes.append(
            "The footnote's a_2 >= 2 (N_1 + N_2) / (p_3 p_1) lacks a factor n: step 3 of the proof needs 2 n (N_1 + N_2) / (p_3 p_1), "
            "or n max(N_1, 2 N_2) / (p_3 p_1), which is what is used here."
        )
    return tuple(notes)
