"""Figures: the same bytes every time, data beside them, and no data that breaks a drawing."""

from __future__ import annotations

import csv
import io
import math
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from report_pendulum import make_check, make_plant, make_report, make_run

from cdobs_cli.certificate import Bound
from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.data import chart_csv, ladder_csv
from cdobs_cli.report.drawings import RECORD, Drawings
from cdobs_cli.report.figures import _chart_figure, _svg, draw
from cdobs_cli.report.ladder import period_ladder
from cdobs_cli.report.palette import BLUE, adaptable
from cdobs_cli.report.thumbnail import thumbnail
from cdobs_cli.report.trajectories import axis_name, run_charts
from cdobs_cli.report.witnesses import witness_charts
from cdobs_cli.run import Run, Trajectory


def rows(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(content.decode())))


def chart(*series: Series, scale: str = "linear", label: str = "y") -> Chart:
    return Chart("c", "t", "c", (Panel("x", label, series, y_scale=scale),))  # type: ignore[arg-type]


def test_pictures_are_deterministic() -> None:
    one, other = (draw(run_charts(make_plant(), make_run())[0], ("svg", "png", "pdf")) for _ in range(2))
    assert one == other
    assert one["png"].startswith(b"\x89PNG")
    assert b"<text" not in one["svg"], "text is drawn as paths"
    assert b"dc:date" not in one["svg"]


def test_csv_holds_what_is_drawn() -> None:
    run = make_run()
    states, error = run_charts(make_plant(), run, {"factor": "2.0", "rate": "0.5"})
    table = rows(chart_csv(states))
    theta = [row for row in table if row["panel"] == "1" and row["series"] == "state"]
    assert [float(row["x"]) for row in theta] == list(run.trajectories[0].t)
    assert [float(row["y"]) for row in theta] == list(run.trajectories[0].x[:, 0])
    assert len([row for row in table if row["series"] == "measurement"]) == len(run.trajectories[0].t_k)
    envelope = [row for row in rows(chart_csv(error)) if row["series"] == "proved envelope"]
    start = math.hypot(1.0, 0.5)
    assert float(envelope[0]["y"]) == pytest.approx(2 * start)
    assert float(envelope[-1]["y"]) == pytest.approx(2 * start * math.exp(-0.5 * 12))


def test_csv_of_bands_limits_and_marks() -> None:
    table = rows(
        chart_csv(
            chart(
                Series("b", [0.0], [1.0], "band", y2=[2.0]),
                Series("l", [], [3.0], "limit"),
                Series("m", [4.0], [], "mark"),
            )
        )
    )
    assert [(row["series"], row["x"], row["y"], row["y2"]) for row in table] == [
        ("b", "0.0", "1.0", "2.0"), ("l", "nan", "3.0", ""), ("m", "4.0", "nan", ""),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["line", "steps", "points", "stems", "band", "limit", "mark"])
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_every_kind_is_drawn(kind: str, scale: str) -> None:
    x, y = np.linspace(0, 1, 5), np.array([0.0, -1.0, np.nan, 1e300, 2.0])
    assert draw(chart(Series("s", x, y, kind, y2=y + 1), scale=scale))["svg"]  # type: ignore[arg-type]


@pytest.mark.parametrize("values", [[], [math.nan], [0.0, 0.0], [1e-300, 1e-300], [-1.0, -2.0]])
def test_data_that_an_axis_cannot_show(values: list[float]) -> None:
    assert draw(chart(Series("s", list(range(len(values))), values), scale="log"), ("png",))["png"]


@pytest.mark.parametrize("label", ["$", "$a", r"$\frac{$", "a_b", r"$\theta$", "$100 and $200", "<b>&"])
def test_any_label_can_be_drawn(label: str) -> None:
    assert draw(chart(Series(label, [0.0, 1.0], [0.0, 1.0]), label=label))["svg"]


def boxes(content: bytes) -> list[tuple[float, float, float, float]]:
    """Left, right, top and bottom of the grounds of the axes, in points."""
    found = re.findall(r'<path d="([^"]*z\s*)" style="fill: #ffffff', content.decode())
    corners = [[float(one) for one in re.findall(r"-?\d[\d.]*", path)] for path in found]
    return [(min(one[::2]), max(one[::2]), min(one[1::2]), max(one[1::2])) for one in corners]


def test_panels_are_of_one_size_and_leave_room_for_what_stands_round_them() -> None:
    x = [0.0, 1.0]
    names = [("y", [0.0, 1.0]), (r"$\\hat x_1$ (m)", [-12_345.0, 2e4]), ("z", [1e-9, 2e-9])]
    panels = [Panel("time (s)", name, (Series(f"series {name}", x, y),)) for name, y in names]
    picture = draw(Chart("three", "Three", "", tuple(panels)))["svg"]
    width, height = (float(one) for one in re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', picture.decode())[0])
    _, *axes = boxes(picture)
    assert len(axes) == 3
    assert {round(right - left, 3) for left, right, _, _ in axes} == {round(axes[0][1] - axes[0][0], 3)}
    assert {round(low - top, 2) for _, _, top, low in axes} == {round(axes[0][3] - axes[0][2], 2)}
    assert 20 < axes[0][0] < width / 3
    assert 0.9 * width < axes[0][1] < width
    # A legend, and of the last one the numbers and the name of the axis.
    assert axes[0][2] > 12
    assert all(below[2] - above[3] > 12 for above, below in pairwise(axes))
    assert 25 < height - axes[-1][3] < 50


@pytest.mark.parametrize("wide", [True, False])
def test_a_map_has_its_scale_of_colours_beside_it(wide: bool) -> None:
    x, y = [1.0, 1.0, 2.0, 2.0], [1.0, 2.0, 1.0, 2.0]
    cells = Series("error (m)", x, y, "cells", "proved", y2=[0.01, 0.02, 0.03, 5.0 if wide else 0.04])
    figure = _chart_figure(Chart("m", "M", "c", (Panel("a.long.path", "another.long.path", (cells,)),) * 2))
    _svg(figure)
    boxes = [ax.get_position() for ax in figure.axes]
    assert len(boxes) == 4
    assert all(not one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])
    assert min(box.height for box in boxes) > 0.3 and min(box.width for box in boxes[:2]) > 0.5
    assert figure.axes[2].get_yscale() == ("log" if wide else "linear")


def test_loading_the_drawing_library_leaves_it_as_it_is() -> None:
    told = """
from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.figures import draw
draw(Chart("c", "c", "", (Panel("t", "y", (Series("a", [0, 1], [0, 1]),)),)))
from matplotlib import artist
class Mark(artist.Artist):
    def set_size(self, size):
        \"\"\"Set it.\"\"\"
print("size" in Mark.set.__doc__, "size" in str(Mark.set.__signature__))
"""
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout == "True True\n"


def test_axis_names() -> None:
    assert axis_name("theta") == r"$\theta$"
    assert axis_name("x1") == "$x_{1}$"
    assert axis_name("omega_m") == r"$\omega_{m}$"
    assert axis_name("glucose") == "glucose"


def sparse(end: float, decay: float, *, samples: int = 20, count: int = 1) -> Run:
    """Runs to `end` whose errors fall at a rate, with so many samples."""
    t = np.linspace(0, end, 800)
    x = np.stack([np.cos(t), -np.sin(t)], axis=1)
    t_k = np.linspace(0, end, samples)
    y_k = np.cos(t_k)[:, None]
    paths = tuple(
        Trajectory(t, x, {"x_hat": x + np.exp(-decay * t)[:, None] * [1.0 + k, 2.0]}, {}, t_k, y_k)
        for k in range(count)
    )
    one = make_run(count)
    return replace(one, trajectories=paths)


def test_a_short_transient_gets_a_larger_scale_and_the_caption_says_so() -> None:
    states = run_charts(make_plant(), sparse(40, 1.0))[0]
    assert states.stretch == pytest.approx(5.0)
    assert "Up to t = 5 (shaded)" in states.caption
    slow = run_charts(make_plant(), sparse(40, 0.1))[0]
    assert slow.stretch is None and "shaded" not in slow.caption
    assert draw(states)["svg"] != draw(replace(states, stretch=None))["svg"]


def test_the_error_ends_where_rounding_is_all_that_is_left() -> None:
    error = run_charts(make_plant(), sparse(40, 2.0), {"factor": "2", "rate": "1.5"})[1]
    assert len(error.panels) == 2 and "rounding is all that is left" in error.caption
    for panel in error.panels:
        low = panel.y_range[0] if panel.y_range else 0.0
        assert low == pytest.approx(8 * np.finfo(float).eps, rel=1e-3)
        for series in panel.series:
            assert np.min(series.y) >= low and np.max(series.x) < 20
    whole = run_charts(make_plant(), sparse(40, 0.2))[1]
    assert np.max(whole.panels[0].series[0].x) == 40 and "rounding" not in whole.caption


def test_the_envelope_bounds_the_norm_of_all_errors() -> None:
    error = run_charts(make_plant(), sparse(40, 2.0), {"factor": "2", "rate": "1.5"})[1]
    for panel in error.panels:
        curve, envelope = panel.series
        assert envelope.y[0] == pytest.approx(2 * math.hypot(1, 2))
        assert (np.interp(curve.x, envelope.x, envelope.y) >= curve.y)[curve.x <= envelope.x[-1]].all()


def test_many_runs_are_a_band_and_few_are_lines() -> None:
    kinds = [
        [one.kind for one in run_charts(make_plant(), sparse(40, 0.2, count=count))[1].panels[0].series]
        for count in (1, 2, 5)
    ]
    assert kinds == [["line"], ["line", "line"], ["band", "line"]]
    band, median = run_charts(make_plant(), sparse(40, 0.2, count=5))[1].panels[0].series
    assert (band.y[0], median.y[0], band.y2[0]) == pytest.approx((1, 3, 5))


def test_many_measurements_are_thinned_and_the_caption_says_so() -> None:
    few, many = (run_charts(make_plant(), sparse(40, 0.1, samples=count))[0] for count in (20, 1000))
    drawn = [len(one.x) for chart in (few, many) for one in chart.panels[0].series if one.kind == "points"]
    assert drawn[0] == 20 and 50 <= drawn[1] <= 60
    assert "one in 17 is drawn" in many.caption and "one in" not in few.caption


def test_large_numbers_have_their_power_of_ten_in_the_label() -> None:
    from matplotlib.figure import Figure

    from cdobs_cli.report.figures import _tidy

    for values, told in (([0, 3e-6], r"x ($10^{-6}$ m)"), ([0, 2.0], "x (m)"), ([0, 5e6], r"x ($10^{6}$ m)")):
        ax = Figure().subplots()
        ax.plot(values)
        ax.set_ylabel("x (m)")
        _tidy(ax.yaxis, "x (m)")
        assert ax.get_ylabel() == told and ax.yaxis.get_offset_text().get_text() == ""


def test_the_small_picture_has_a_curve_and_its_dark_colours() -> None:
    small = thumbnail(run_charts(make_plant(), make_run())).decode()
    assert small.count("<polyline") == 1 and "prefers-color-scheme: dark" in small
    points = [tuple(map(float, one.split(","))) for one in small.partition('points="')[2].partition('"')[0].split()]
    assert len(points) > 50 and points[0][1] < points[-1][1], "the error falls"
    assert thumbnail(()) == b""


def test_files_are_light_and_pages_adapt() -> None:
    drawn = draw(run_charts(make_plant(), make_run())[0])["svg"].decode()
    assert "var(" not in drawn and BLUE in drawn
    assert f"stroke: var(--figure-0072b2, {BLUE})" in adaptable(drawn)
    assert not re.search(r"(?<!, )(?<!--figure-)#0072b2", adaptable(drawn))


def in_memory(files: dict[str, bytes]) -> Drawings:
    return Drawings.of(files.get)


def test_a_figure_is_drawn_once_and_again_where_its_data_its_formats_or_its_files_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    charts = make_report(check=make_check(), run=make_run(30)).run_charts
    files: dict[str, bytes] = {}
    pictures, new = in_memory(files).drawn(charts, ("svg",))
    files |= new
    assert set(new) == {f"figures/{name}.{end}" for name in ("states", "error") for end in ("svg", "csv")} | {RECORD}
    with monkeypatch.context() as patch:
        patch.setattr("cdobs_cli.report.figures.draw", lambda *_: pytest.fail("is drawn again"))
        assert in_memory(files).drawn(charts, ("svg",)) == (pictures, {})

    first, second = charts
    x = np.array(first.panels[0].series[0].x)
    x[-1] = np.nextafter(x[-1], 100)
    series = replace(first.panels[0].series[0], x=x)
    moved = replace(first, panels=(replace(first.panels[0], series=(series,)), *first.panels[1:]))
    assert f"figures/{first.name}.svg" in in_memory(files).drawn([moved, second], ("svg",))[1]
    assert f"figures/{first.name}.svg" in in_memory(files).drawn([replace(first, title="x")], ("svg",))[1]
    assert {f"figures/{one.name}.pdf" for one in charts} < set(in_memory(files).drawn(charts, ("svg", "pdf"))[1])
    edited = files | {f"figures/{first.name}.svg": b"<svg/>"}
    again, mended = in_memory(edited).drawn(charts, ("svg",))
    assert again == pictures and set(mended) == {f"figures/{first.name}.{end}" for end in ("svg", "csv")} | {RECORD}


@pytest.mark.parametrize("record", [b"", b"[]", b"{", b'{"states": 1}', b'{"states": ["a", {}, 3]}', b"\xff"])
def test_a_record_that_nobody_wrote_means_that_nothing_is_drawn(record: bytes) -> None:
    assert in_memory({RECORD: record}).known == {}


def test_ladder() -> None:
    bounds = {
        "period_max": Bound("1.7", "1.8"),
        "period_max.slow": Bound("0.02", None),
        "period_max.fast": Bound("1.7", "1.8"),
        "period_max_any_gain": Bound(None, "inf"),
        "delta_star": Bound("1.5", "1.6"),
        "lmi_15_period_max": Bound("0.39", None),
    }
    ladder = period_ladder(bounds)
    assert ladder is not None
    assert [rung.label for rung in ladder.rungs] == ["this gain", "slow", "fast", "lmi 15"]
    assert ladder_csv(ladder) == b"method,proved,refuted\nthis gain,1.7,1.8\nslow,0.02,\nfast,1.7,1.8\nlmi 15,0.39,\n"
    assert draw(ladder)["svg"]
    assert period_ladder({"delta_star": Bound("1.5", "1.6")}) is None


def test_text_needs_no_drawing_library() -> None:
    code = (
        "import sys, cdobs_cli.report.model, cdobs_cli.report.files, cdobs_cli.report.index\n"
        "assert not {'matplotlib', 'numpy'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_switching_counterexample_is_drawn() -> None:
    (drawn,) = witness_charts(make_check())
    (panel,) = drawn.panels
    assert drawn.name == "witness_period_refuted"
    assert list(panel.series[0].x) == pytest.approx([0.0, 0.9, 1.7131])
    assert list(panel.series[0].y) == [1.0, -1.0, -1.0]
    assert panel.y_label == "$v_{21}$"
