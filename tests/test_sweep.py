"""Sweeps: fields and grids, what is told of wrong ones, one table whatever the order, and nothing done twice."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from command import PENDULUM, ROOT, Done, forked

from cdobs_cli.certificate import Bound
from cdobs_cli.errors import SpecError, UsageError
from cdobs_cli.report.data import chart_csv
from cdobs_cli.report.figures import draw
from cdobs_cli.spec.model import load
from cdobs_cli.spec.reader import read, read_text
from cdobs_cli.spec.replaced import Setting, checked, replaced, written
from cdobs_cli.sweep import points as points_module
from cdobs_cli.sweep.charts import sweep_charts
from cdobs_cli.sweep.grid import MAX_POINTS, Axis, Shard, axes, points
from cdobs_cli.sweep.points import Point, Row

GIVEN = PENDULUM.split("simulation:")[0] + "  gain: {K: [[1], [1.8361]]}\n"
PERIODS = ("--set", "measurement.sampling.period=0.3:1.5:5")
SHIPPED = sorted((ROOT / "specs").glob("*.yaml"))


def sweep(folder: Path, *arguments: str, before: Any = lambda: None) -> Done:
    if not (folder / "p.yaml").exists():
        (folder / "p.yaml").write_text(GIVEN)
    return forked(["sweep", "p.yaml", "--effort", "0", *arguments], folder, before)


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "results/p/sweep/sweep.csv").read_text().splitlines()))


def content(folder: Path) -> dict[str, bytes]:
    """All files of the sweep but the times."""
    top = folder / "results/p/sweep"
    files = (path for path in top.rglob("*") if path.is_file() and "time" not in path.name)
    return {str(path.relative_to(top)): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    done = sweep(folder, *PERIODS)
    assert done.returncode == 1, done.stderr
    return folder


# ---------------------------------------------------------------- fields and values


@pytest.mark.parametrize(
    ("text", "field", "values"),
    [
        ("a.b=0.1:0.7:3", "a.b", ("0.1", "0.4", "0.7")),
        ("a=1:0:3", "a", ("1", "0.5", "0")),
        ("a=0:1:4", "a", ("0", '"1/3"', '"2/3"', "1")),
        ("a=1e-3:1/8:2", "a", ("0.001", "0.125")),
        ("plant.A[0][1]=1, sqrt(2)", "plant.A[0][1]", ("1", "sqrt(2)")),
        ("a=[[1], [2]],[[3],[4]]", "a", ("[[1], [2]]", "[[3],[4]]")),
        ('a={x: 1, y: "p,q"},max(1,2)', "a", ('{x: 1, y: "p,q"}', "max(1,2)")),
        ("a=b=c", "a", ("b=c",)),
    ],
)
def test_values(text: str, field: str, values: tuple[str, ...]) -> None:
    assert axes([text]) == (Axis(field, values),)


@pytest.mark.parametrize(
    ("texts", "told"),
    [
        ([], "no field"),
        (["a"], "no field and values"),
        (["=1"], "no field and values"),
        (["a..b=1"], "no field and values"),
        (["a[x]=1"], "no field and values"),
        (["a="], "a value is empty"),
        (["a=1,,2"], "a value is empty"),
        (["a=1,2,1"], "the value 1 stands twice"),
        (["a=2:2:3"], "the value 2 stands twice"),
        (["a=1", "a=2"], "--set a stands twice"),
        (["a=0:1:1"], "2 to 10000 values"),
        (["a=1/0:1:2"], "divided by 0"),
        (["a=0:1:200", "b=0:1:200"], "40000 points; allowed: at most 10000"),
    ],
)
def test_what_is_no_field_or_value(texts: list[str], told: str) -> None:
    with pytest.raises(UsageError, match=told):
        axes(texts)


def test_the_last_field_changes_first_and_parts_hold_every_point_once() -> None:
    grid = points(axes(["a=1,2", "b=3,4,5"]))
    assert [" ".join(map(str, one)) for one in grid[:4]] == ["a=1 b=3", "a=1 b=4", "a=1 b=5", "a=2 b=3"]
    for count in (1, 2, 5):
        parts = [[k for k in range(6) if Shard.of(f"{i}/{count}").holds(k)] for i in range(1, count + 1)]
        assert (
            sorted(k for part in parts for k in part) == list(range(6))
            and max(map(len, parts)) - min(map(len, parts)) <= 1
        )
    for text in ("0/2", "3/2", "1", "1/0", "a/b"):
        with pytest.raises(UsageError, match="i/n is expected"):
            Shard.of(text)
    assert len(axes([f"a=0:1:{MAX_POINTS}"])[0].values) == MAX_POINTS


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_spec_that_is_written_reads_back_as_it_was(path: Path) -> None:
    root = read(path).root
    again = read_text(written(root), "again").root
    assert again == root and repr(again) == repr(root)


def test_any_text_is_written_as_it_is() -> None:
    root = {"a": {"b": ['yes "no"', "1", "0x1", "null", "\u2028\x85 é \U0001f600", "#", ": ", ""], "y": {}}, "c": None}
    assert read_text(written(root), "f").root == root


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("measurement.sampling.perod=1", "measurement.sampling.perod: unknown key; allowed: .*did you mean 'period'"),
        ("measurment.sampling.period=1", "measurment: unknown key; .*did you mean 'measurement'"),
        ("measurement.sampling.period=-1", "measurement.sampling.period: .*positive.*got -1"),
        ("plant.A[2][0]=1", r"plant.A: the list has no such entry; got 2; allowed: an index from 0 to 1"),
        ("plant.A.x=1", r"plant.A: the list has no such entry; got x"),
        ("plant.phi[1].k=1", r'plant.phi\[1\]: has no fields of its own; got "sin\(theta\)"'),
        ("plant.phi[1]=sine(theta)", r"plant.phi\[1\]: .*did you mean 'sin'"),
        ("observer.family=lpv", "observer.family: .*allowed: .*lpv_zoh"),
        ("plant.A=[[1", r"plant.A\[0\]: not YAML"),
        ("plant.title=&a 1", "plant.title: an anchor"),
        ("measurement.sampling.period=nothing here", "measurement.sampling.period: "),
    ],
)
def test_a_wrong_field_or_value_is_told_with_its_path(tmp_path: Path, setting: str, told: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(GIVEN)
    field, _, text = setting.partition("=")
    with pytest.raises(SpecError, match=told) as caught:
        checked(read(path), [Setting(field, text)], path)
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{path}: ") and str(problem).endswith(f"set by --set {setting}")


def test_what_was_wrong_before_is_told_at_its_line(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(GIVEN.replace("phi: ", "phy: "))
    with pytest.raises(SpecError) as caught:
        checked(read(path), [Setting("measurement.sampling.period", "0.5")], path)
    assert any(one.line == 6 and "--set" not in str(one) for one in caught.value.problems)


def test_a_field_set_is_the_field_typed(tmp_path: Path) -> None:
    path, other = tmp_path / "p.yaml", tmp_path / "q.yaml"
    path.write_text(GIVEN)
    other.write_text(GIVEN.replace("0.6", "0.7").replace("[1, 0]]\nmeas", '[0.5, "1/3"]]\nmeas'))
    settings = [
        Setting("measurement.sampling.period", "0.7"), Setting("plant.lipschitz.1.0", "0.5"),
        Setting("plant.lipschitz[1][1]", '"1/3"'),
    ]  # fmt: skip
    document = read(path)
    new = replaced(document, settings)
    path.write_text(written(new.root))
    assert load(path).normalised() == load(other).normalised()
    assert document.root["measurement"]["sampling"]["period"] == "0.6", "the spec itself stays as it is"


# ---------------------------------------------------------------- carried out


def test_the_table_holds_what_the_checks_say_in_the_order_of_the_grid(whole: Path) -> None:
    rows = table(whole)
    assert [row["measurement.sampling.period"] for row in rows] == ["0.3", "0.6", "0.9", "1.2", "1.5"]
    assert [row["verdict"] for row in rows] == ["proved", "proved", "undecided", "refuted", "refuted"]
    assert [row["status"] for row in rows] == ["ok"] * 2 + ["finding"] * 3
    for row in rows:
        (found,) = [
            folder for folder in (whole / "results/p/sweep/points").iterdir()
            if f"period={row['measurement.sampling.period']}\n" in (folder / "spec.yaml").read_text()
        ]  # fmt: skip
        check = json.loads((found / "check.json").read_text())
        for name in ("period_max", "decay_rate"):
            ends = check["bounds"].get(name, {})
            assert [row[f"{name}.{end}"] for end in ("proved", "refuted")] == [
                ends.get(end) or "" for end in ("proved", "refuted")
            ]
    times = list(csv.DictReader((whole / "results/p/sweep/sweep_times.csv").read_text().splitlines()))
    assert all(0 < float(row["cpu_seconds"]) < 60 for row in times) and len(times) == 5
    assert (whole / "results/p/sweep/figures/sweep_period.svg").read_bytes().startswith(b"<?xml")


def test_several_at_a_time_leave_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    assert sweep(tmp_path, *PERIODS, "--jobs", "2").returncode == 1
    assert content(tmp_path) == content(whole)


def test_a_sweep_that_was_killed_goes_on(whole: Path, tmp_path: Path) -> None:
    def dies_after_two() -> None:
        keep, kept = Point.keep, []

        def counted(self: Point, result: Any) -> Row:
            kept.append(keep(self, result))
            if len(kept) == 2:
                os.kill(os.getpid(), signal.SIGKILL)
            return kept[-1]

        points_module.Point.keep = counted  # type: ignore[method-assign]

    assert sweep(tmp_path, *PERIODS, before=dies_after_two).returncode == -signal.SIGKILL
    top = tmp_path / "results/p/sweep"
    stood = {path: path.stat().st_mtime_ns for path in top.glob("points/*/point.json")}
    assert len(stood) == 2 and not (top / "sweep.csv").exists()
    done = sweep(tmp_path, *PERIODS)
    assert done.returncode == 1 and done.stdout.count("(stands)") == 2
    assert {path: path.stat().st_mtime_ns for path in stood} == stood
    assert content(tmp_path) == content(whole)
    assert sweep(tmp_path, *PERIODS).stdout.count("(stands)") == 5


def test_parts_make_the_whole(whole: Path, tmp_path: Path) -> None:
    first = sweep(tmp_path, *PERIODS, "--shard", "1/2")
    assert "3 of 5 points are done; --merge writes the table" in first.stdout
    early = sweep(tmp_path, *PERIODS, "--merge")
    assert early.returncode == 2 and "2 of 5 points are not done yet" in early.stderr and "=0.6" in early.stderr
    second = sweep(tmp_path, *PERIODS, "--shard", "2/2")
    assert second.returncode == 1 and second.stdout.count("p.yaml (") == 2
    assert not (tmp_path / "results/p/sweep/sweep.csv").exists()
    merged = sweep(tmp_path, *PERIODS, "--merge", before=lambda: os.environ.update(PATH=""))
    assert merged.returncode == 1 and content(tmp_path) == content(whole)
    assert sweep(tmp_path, *PERIODS, "--merge", "--shard", "1/2").returncode == 2


def test_what_a_limit_ended_and_what_was_edited_is_done_again(tmp_path: Path) -> None:
    periods = ("--set", "measurement.sampling.period=0.6,0.9")
    assert sweep(tmp_path, *periods, "--time-limit", "0.001").returncode == 1
    assert [row["status"] for row in table(tmp_path)] == ["finding"] * 2
    assert "not finished within" in table(tmp_path)[0]["message"]
    done = sweep(tmp_path, *periods)
    assert "(stands)" not in done.stdout and [row["status"] for row in table(tmp_path)] == ["ok", "finding"]
    before = content(tmp_path)
    (edited,) = [
        path for path in (tmp_path / "results/p/sweep").glob("points/*/point.json") if '"undecided"' in path.read_text()
    ]
    edited.write_text(edited.read_text().replace('"undecided"', '"proved"'))
    assert sweep(tmp_path, *periods).stdout.count("(stands)") == 1
    assert content(tmp_path) == before


def test_a_title_and_comments_cost_nothing_and_effort_does(tmp_path: Path) -> None:
    one = ("--set", "measurement.sampling.period=0.6")
    assert sweep(tmp_path, *one).returncode == 0
    (tmp_path / "p.yaml").write_text("# a comment\n" + GIVEN.replace("title: Pendulum", "title: another"))
    assert "(stands)" in sweep(tmp_path, *one).stdout
    assert "(stands)" not in sweep(tmp_path, *one, "--effort", "1").stdout
    assert "(stands)" not in sweep(tmp_path, *one, "--force").stdout


def test_a_wrong_value_is_told_before_anything_is_done(tmp_path: Path) -> None:
    done = sweep(tmp_path, "--set", "measurement.sampling.period=0.6,0,-1", "--set", "observer.method=set,sets",
                 "--format", "json")  # fmt: skip
    document = json.loads(done.stdout)
    assert done.returncode == document["exit_code"] == 2
    fields = [message["field"] for message in document["results"][0]["messages"]]
    assert fields == ["measurement.sampling.period"] * 2 + ["observer.method"]
    assert not (tmp_path / "results").exists()


def test_a_combination_that_cannot_be_is_a_row(tmp_path: Path) -> None:
    done = sweep(tmp_path, "--set", "measurement.noise.lower=[-0.01],[0.03]",
                 "--set", "measurement.noise.upper=[0.04],[0.02]")  # fmt: skip
    rows = table(tmp_path)
    assert done.returncode == 2 and [row["status"] for row in rows] == ["ok", "ok", "ok", "invalid"]
    assert rows[3]["verdict"] == "" and "0.03" in rows[3]["message"]


def test_the_plants_own_file(tmp_path: Path) -> None:
    plant = GIVEN.split("plant:\n")[1].split("measurement:")[0]
    (tmp_path / "p.yaml").write_text(GIVEN.replace(plant, "  file: a.plant.yaml\n"))
    (tmp_path / "a.plant.yaml").write_text("".join(line[2:] + "\n" for line in plant.splitlines()))
    done = sweep(tmp_path, "--set", "plant.lipschitz[1][0]=1,2", "--format", "json")
    document = json.loads(done.stdout)
    assert done.returncode == 0 and [one["check"]["verdict"] for one in document["results"]] == ["proved"] * 2
    assert float(table(tmp_path)[0]["period_max.proved"]) > float(table(tmp_path)[1]["period_max.proved"])


# ---------------------------------------------------------------- figures


def row(**bounds: Bound) -> Row:
    return Row("ok", "proved", "reachability", "given", False, bounds)


def test_figures_of_one_field_two_fields_and_three() -> None:
    rows = [row(period_max=Bound(str(k + 1), str(k + 2)), **{"error.x": Bound(str(k), None)}) for k in range(6)]
    (one, error) = sweep_charts(axes(["a=3:1:6"]), [["3", "2.6", "2.2", "1.8", "1.4", "1"]], rows)
    proved = one.panels[0].series[0]
    assert list(proved.x) == [1.0, 1.4, 1.8, 2.2, 2.6, 3.0] and list(proved.y) == [6, 5, 4, 3, 2, 1]
    assert error.name == "sweep_error" and {s.label for s in error.panels[0].series} == {"proved"}
    two, _ = sweep_charts(axes(["a=1,100", "b=x,y,z"]), [["1", "100"], ["x", "y", "z"]], rows)
    cells, verdicts = two.panels[0].series
    assert list(zip(cells.x, cells.y, cells.y2, strict=True))[:4] == [(1, 1, 1), (1, 2, 2), (1, 3, 3), (100, 1, 4)]
    assert two.panels[0].x_scale == "log" and two.panels[0].y_label == "b: 1 x, 2 y, 3 z"
    assert verdicts.label == "proved" and draw(two)["svg"] and b",100.0,1.0,4.0" in chart_csv(two)
    assert sweep_charts(axes(["a=1", "b=1", "c=1"]), [["1"]] * 3, rows[:1]) == []
    assert sweep_charts(axes(["a=1"]), [["1"]], [row()]) == []


def test_what_the_spec_expects_is_of_its_own_values(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(GIVEN + "expect:\n  - {quantity: verdict, equals: refuted}\n")
    done = sweep(tmp_path, "--set", "measurement.sampling.period=0.3,0.4")
    assert done.returncode == 0, done.stderr
    assert {row["message"] for row in table(tmp_path)} == {""}
