"""Comparisons: who is in the table and why not, what carries a certificate, and figures that are the artefacts' own."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from command import PENDULUM, Done, forked

from cdobs_cli.certificate import Bound
from cdobs_cli.compare.figures import NO_CERTIFICATE, Figures
from cdobs_cli.compare.table import columns, compare_chart, compare_csv, compare_page, text_lines
from cdobs_cli.report.figures import draw

NOISY = PENDULUM.replace("{period: 0.6}", "{period: 0.3}\n  noise: {lower: [-0.01], upper: [0.01]}").replace(
    "  method: set\n", "  gain: {K: [[1], [1.3]]}\n"
)
QUIET = PENDULUM.replace("  method: set\n", "  gain: {K: [[1], [1.3]]}\n")
WRONG = QUIET.replace("[[1], [1.3]]", "[[-1], [-1.3]]")


def compare(folder: Path, *arguments: str, **specs: str) -> Done:
    for name, text in specs.items():
        (folder / f"{name}.yaml").write_text(text)
    return forked(["compare", *arguments, "--effort", "0"], folder)


def table(folder: Path, stem: str = "p") -> dict[str, dict[str, str]]:
    text = (folder / f"results/{stem}/compare/compare.csv").read_text()
    return {row["observer"]: row for row in csv.DictReader(text.splitlines())}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    folder = tmp_path_factory.mktemp("compared")
    return folder, compare(folder, "p.yaml", p=NOISY)


def test_who_is_in_the_table(done: tuple[Path, Done]) -> None:
    folder, told = done
    assert told.returncode == 0, told.stderr
    rows = table(folder)
    assert list(rows) == [
        "p", "extended Kalman filter beside p", "output predictor beside p", "reachability, gain found",
        "lpv_zoh, gain found", "constant gain, placed",
    ]  # fmt: skip
    assert "interval is left out: plant.phi[1]: this observer is for linear plants" in told.stdout
    assert "updated_sampling is left out: measurement.sampling" in told.stdout
    for name in rows:
        assert f"\n{name}  " in f"\n{told.stdout}"


def test_baselines_are_marked_and_have_nothing_proved(done: tuple[Path, Done]) -> None:
    rows = table(done[0])
    for name in ("extended Kalman filter beside p", "output predictor beside p"):
        row = rows[name]
        assert row["certificate"] == NO_CERTIFICATE and row["kind"] == "baseline" and row["remark"]
        assert not any(cell for column, cell in row.items() if column.endswith(("proved", "refuted")))
        assert float(row["rmse.theta"]) > 0 and row["measurements"] == rows["p"]["measurements"] == "21"
    for name in ("p", "lpv_zoh, gain found"):
        assert rows[name]["certificate"] == "proved"


def test_figures_are_those_of_the_artefacts(done: tuple[Path, Done]) -> None:
    folder, row = done[0], table(done[0])["p"]
    (own,) = [
        one.parent for one in folder.glob("results/p/compare/points/*/spec.yaml") if "1.3" in one.read_text()
    ]  # fmt: skip
    bounds = json.loads((own / "check.json").read_text())["bounds"]
    simulation = json.loads((own / "simulation.json").read_text())
    for column, name in (("period", "period_max"), ("rate", "decay_rate"), ("error.omega", "error.omega")):
        assert [row[f"{column}.{end}"] for end in ("proved", "refuted")] == [
            bounds[name]["proved"], bounds[name]["refuted"],
        ]  # fmt: skip
    states = simulation["comparison"]["states"]
    assert (
        float(row["rmse.omega"]) == states["omega"]["rmse"] and int(row["seeds"]) == simulation["comparison"]["seeds"]
    )
    assert float(table(folder)["extended Kalman filter beside p"]["rmse.omega"]) == states["omega"]["rmse_ekf"]
    assert float(row["rmse.omega"]) < float(row["error.omega.proved"])


def test_a_second_time_nothing_is_done_and_the_bytes_are_the_same(done: tuple[Path, Done]) -> None:
    folder, _ = done
    top = folder / "results/p/compare"
    names = ("compare.csv", "figures/compare_error.svg")
    before = [(top / name).read_bytes() for name in names]
    stood = {path: path.stat().st_mtime_ns for path in top.glob("points/*/*.json")}
    assert compare(folder, "p.yaml", "--jobs", "2").returncode == 0
    assert [(top / name).read_bytes() for name in names] == before
    assert {path: path.stat().st_mtime_ns for path in top.glob("points/*/*.json")} == stood
    page = (top / "compare.html").read_text()
    assert page.count("<tr>") == 7 and "<svg" in page and NO_CERTIFICATE in page


def test_the_exit_code_is_that_of_the_specs(tmp_path: Path) -> None:
    told = compare(tmp_path, "p.yaml", "--format", "json", p=WRONG)
    document = json.loads(told.stdout)
    assert told.returncode == document["exit_code"] == 1
    statuses = {one["spec"]: one["status"] for one in document["results"]}
    assert statuses["p"] == "finding" and statuses["reachability, gain found"] == "ok"
    assert table(tmp_path)["p"]["certificate"] == "refuted"


def test_specs_of_one_plant_and_of_two(tmp_path: Path) -> None:
    other = QUIET.replace("[1.3]", "[1.5]")
    told = compare(tmp_path, "p.yaml", "q.yaml", p=QUIET, q=other)
    names = list(table(tmp_path))
    assert told.returncode == 0 and names[0] == "p" and "q" in names and "output predictor beside q" in names
    assert sum(name.startswith("reachability, gain found") for name in names) == 1, "one measurement, one search"
    refused = compare(tmp_path, "p.yaml", "r.yaml", r=QUIET.replace("[1, 0]]\nmeas", "[2, 0]]\nmeas"))
    assert refused.returncode == 2 and "its plant is not that of p.yaml" in refused.stderr
    invalid = compare(tmp_path, "s.yaml", s=QUIET.replace("period", "perod"))
    assert invalid.returncode == 2 and "s.yaml:10" in invalid.stderr and "did you mean 'period'" in invalid.stderr
    assert compare(tmp_path, "none.yaml").returncode == 2


def test_without_noise_or_without_a_run_it_says_so(tmp_path: Path) -> None:
    two = PENDULUM.replace("C: [[1, 0]]", "C: [[1, 0], [0, 1]]").replace("  method: set\n", "")
    told = compare(tmp_path, "p.yaml", p=two.split("simulation:")[0])
    assert "Nothing is run" in told.stdout and "No constant gain is placed" in told.stdout
    assert not any(row["rmse.theta"] for row in table(tmp_path).values())
    assert not (tmp_path / "results/p/compare/figures").exists()


# ---------------------------------------------------------------- how it is written


def test_numbers_are_shortened_to_the_safe_side() -> None:
    error = Bound("0.123456789", "0.11", "", better="less")
    row = Figures("a", "spec", "proved", "every 1 s", Bound("1.23456789", "2"), Bound("0.5", None, "1/s"), {"x": error},
                  10, {"x": 0.1}, 1, 1.234)  # fmt: skip
    bare = Figures("b", "baseline", NO_CERTIFICATE, measurements=10, rmse={"x": 0.2})
    shown = columns([row, bare], ["x"])
    assert shown["period proved (s)"] == ["1.23456", "–"] and shown["error of x proved"] == ["0.123457", "–"]
    assert "rate refuted (1/s)" not in shown and shown["CPU (s)"] == ["1.23", "–"]
    first, *_ = csv.DictReader(compare_csv([row, bare], ["x"]).decode().splitlines())
    assert first["error.x.proved"] == "0.123456789" and "cpu" not in " ".join(first)
    chart = compare_chart([row, bare], ["x"])
    assert chart is not None
    assert [one.label for one in chart.panels[0].series] == ["a", f"b ({NO_CERTIFICATE})"]
    assert [list(one.y) for one in chart.panels[0].series] == [[0.1, 0.123456789], [0.2]]
    assert draw(chart)["svg"] and compare_chart([Figures("c", "spec", "proved")], ["x"]) is None
    wild = Figures("\x1b[31m<b>", "spec", "proved", remark="<script>")
    assert "\x1b" not in "".join(text_lines([wild, row], ["x"]))
    page = compare_page("<t>", [wild], ["x"], ["<i>"], None, {})
    assert b"<script>" not in page and b"<b>" not in page and b"<i>" not in page and b"<t>" not in page


def test_poles_are_placed_where_the_nonlinearity_couples_the_states(tmp_path: Path) -> None:
    coupled = QUIET.replace("A: [[0, 1], [0, 0]]", "A: [[0, 0], [0, 0]]")
    coupled = coupled.replace('"0", "sin(theta)"', '"sin(omega)", "0"').replace("[[0, 0], [1, 0]]", "[[0, 1], [0, 0]]")
    told = compare(tmp_path, "p.yaml", p=coupled)
    assert told.returncode == 1, told.stderr
    assert "poles are placed" not in told.stdout
    assert {"constant gain, placed", "output predictor beside p"} <= set(table(tmp_path))
    assert "Figure 1." in (tmp_path / "results/p/compare/compare.html").read_text()
