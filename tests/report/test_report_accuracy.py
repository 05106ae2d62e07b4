"""The table of accuracies and its figure: proved, found, simulated, and beside the Kalman filter."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from report_pendulum import make_check, make_plant, make_report, make_run

from cdobs_cli.certificate import Bound
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.labels import Labels
from cdobs_cli.report.accuracy import accuracy
from cdobs_cli.report.blocks import Grid
from cdobs_cli.report.data import chart_csv
from cdobs_cli.report.drawings import Drawings
from cdobs_cli.report.figures import draw
from cdobs_cli.report.files import render
from cdobs_cli.report.model import Report
from cdobs_cli.report.trajectories import accuracy_chart
from cdobs_cli.run import Compared, Comparison, Filtered, Run

PEAKS = {
    "error.theta": Bound("0.0121", "0.0115", "rad", "peak", "class", "less"),
    "error.omega": Bound("0.03", None, "rad/s", "peak", "class", "less"),
}
RMS = {"rms.theta": Bound("0.004", None, "rad", "chain", "class", "less")}


def compared_run(reason: str | None = None, seeds: int = 8) -> Run:
    run = make_run()
    first = run.trajectories[0]
    theirs = None if reason else 0.00123456
    states = {"theta": Compared(0.002, theirs), "omega": Compared(0.006, theirs and 1e-9)}
    filtered = None if reason else Filtered(first.t, 0.5 * (first.estimates["x_hat"] - first.x))
    return replace(run, comparison=Comparison(seeds, states, reason), filtered=filtered)


def reported(run: Run, bounds: dict[str, Bound] | None = None) -> Report:
    check = make_check()
    report = make_report(check=replace(check, bounds={**check.bounds, **(bounds or {})}), run=run)
    plant = replace(make_plant(), covariance=ExactMatrix([["1e-4"]]), noise=None)
    made = replace(report, plant=plant, labels=Labels("s", {"theta": "rad", "omega": "rad/s"}))
    made.__dict__["versions"] = report.versions
    return made


def table(run: Run, bounds: dict[str, Bound] | None = None) -> Grid:
    (grid,) = accuracy(reported(run, bounds))
    assert isinstance(grid, Grid)
    return grid


def test_without_bounds_there_are_dashes() -> None:
    grid = table(compared_run())
    assert grid.columns == ("state", "proved bound", "worst found", "RMSE", "RMSE of the filter", "ratio")
    assert grid.rows[0] == ("theta (rad)", "–", "–", "0.002", "0.001235", "1.62")
    assert grid.rows[1] == ("omega (rad/s)", "–", "–", "0.006", "1e-9", "> 1000")
    assert "over the second half of 8 runs" in grid.caption and "takes the model as exact" in grid.caption


def test_bounds_have_both_their_ends() -> None:
    grid = table(compared_run(), PEAKS)
    assert grid.columns[1:3] == ("proved peak", "worst peak found")
    assert [row[1:3] for row in grid.rows] == [("0.0121", "0.0115"), ("0.03", "–")]
    both = table(compared_run(seeds=1), {**PEAKS, **RMS})
    assert both.columns[1:5] == ("proved peak", "worst peak found", "proved rms", "worst rms found")
    assert both.rows[0][3:5] == ("0.004", "–") and both.rows[1][3:5] == ("–", "–") and "of one run" in both.caption


def test_why_there_is_no_filter_stands_in_the_caption() -> None:
    grid = table(compared_run("There is no filter: no noise is declared of y, so that R is singular."))
    assert [row[-2:] for row in grid.rows] == [("–", "–")] * 2
    assert grid.caption.endswith("so that R is singular.")
    assert accuracy(reported(make_run())) == ()


def rows(bounds: dict[str, Bound], run: Run) -> list[dict[str, str]]:
    chart = accuracy_chart(make_plant(), run, bounds)
    assert chart is not None
    return list(csv.DictReader(io.StringIO(chart_csv(chart).decode())))


@pytest.mark.parametrize(("bounds", "label"), [(PEAKS, "proved bound"), (RMS, "proved bound of the rms")])
def test_the_figure_shows_the_errors_within_the_bound(bounds: dict[str, Bound], label: str) -> None:
    run = compared_run()
    drawn = rows(bounds, run)
    first = [row for row in drawn if row["panel"] == "1"]
    band = [row for row in first if row["series"] == label]
    size = float(str(bounds.get("error.theta", bounds.get("rms.theta")).proved))  # type: ignore[union-attr]
    assert [(float(row["y"]), float(row["y2"])) for row in band] == [(-size, size)] * 2
    own = [float(row["y"]) for row in first if row["series"] == "observer"]
    assert own == list(run.trajectories[0].estimates["x_hat"][:, 0] - run.trajectories[0].x[:, 0])
    assert len([row for row in first if row["series"] == "Kalman filter"]) == len(own)


def test_axes_are_for_what_is_left_after_the_transient() -> None:
    chart = accuracy_chart(make_plant(), compared_run(), PEAKS)
    assert chart is not None
    (low, high), (lower, upper) = (panel.y_range or (0, 0) for panel in chart.panels)
    assert high == pytest.approx(1.3 * 0.015, rel=0.2) and low == -high and lower == -upper
    assert draw(chart, ("png",))["png"].startswith(b"\x89PNG")


def test_hostile_errors_do_not_break_the_drawing() -> None:
    run = compared_run()
    for value in (np.nan, np.inf, 0.0, 1e300):
        error = np.full_like(run.filtered.error, value)  # type: ignore[union-attr]
        odd = replace(run, filtered=Filtered(run.trajectories[0].t, error))
        for bounds in (PEAKS, {"error.theta": Bound("inf", None, "rad", better="less")}, {}):
            chart = accuracy_chart(make_plant(), odd, bounds)
            assert chart is not None and draw(chart)["svg"]


def test_the_page_holds_table_figure_and_covariance() -> None:
    files = render(reported(compared_run(), PEAKS), Drawings(lambda _: None))
    page, text = files["report.html"].decode(), files["report.md"].decode()
    assert (
        "<svg" in page
        and "figures/accuracy.svg" in files
        and "figures/accuracy.svg" in text.replace("(", "").split("![Accuracy]")[1]
    )
    assert "| θ (rad) | 0.0121 | 0.0115 | 0.002 | 0.001235 | 1.62 |" in text
    assert "of mean 0 and the covariance R" in text
