"""The functions for notebooks: what the commands do, the same artefacts, nothing printed, errors with every mistake."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path

import pytest
from command import PENDULUM, forked, made

from cdobs_cli import api
from cdobs_cli.cli import app
from cdobs_cli.design import Design
from cdobs_cli.errors import SpecError, UsageError
from cdobs_cli.run import Run

GIVEN = PENDULUM.replace("  method: set\n", "  gain: {K: [[1], [1.3]]}\n")


@pytest.fixture
def spec(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.yaml").write_text(GIVEN)
    return Path("p.yaml")


def test_no_command_is_missing() -> None:
    called = {"init": "example", "run_all": "run"}
    commands = {
        name or "" for name in (one.name or one.callback.__name__ for one in app.registered_commands if one.callback)
    }
    assert {called.get(name, name) for name in commands} <= set(api.__all__)
    for name in api.__all__:
        assert inspect.getdoc(getattr(api, name)), name


def test_the_artefacts_are_those_of_the_commands(
    spec: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    designed = api.synthesize(spec, effort=0)
    checked = api.check(api.load(spec), effort=0)
    simulated = api.simulate(spec, effort=0)
    page = api.report(spec, effort=0)
    assert isinstance(designed.design, Design) and designed.design == checked.design
    assert isinstance(simulated.run, Run) and simulated.run.trajectories
    (tmp_path / "there").mkdir()
    assert made(tmp_path / "there", GIVEN).check == json.loads(Path("results/p/check.json").read_text())
    assert checked.verdict == "proved" and checked.claims["convergence"].status == "proved"
    assert float(checked.bounds["period_max"].proved or 0) > 0.6
    assert page == Path("results/p/report.html") and page.is_file()
    assert capfd.readouterr() == ("", "")


def test_what_is_current_is_not_done_again(spec: Path) -> None:
    api.check(spec, effort=0)
    before = {path: path.stat().st_mtime_ns for path in Path("results").rglob("*.json")}
    api.check(spec, effort=0)
    assert {path: path.stat().st_mtime_ns for path in Path("results").rglob("*.json")} == before
    api.check(spec, effort=0, force=True)
    assert Path("results/p/design.json").stat().st_mtime_ns > before[Path("results/p/design.json")]


def test_notebooks_show_them(spec: Path) -> None:
    shown = {
        "Observer": api.synthesize(spec, effort=0)._repr_html_(),
        "proved": api.check(spec, effort=0)._repr_html_(),
        "<svg": api.simulate(spec, effort=0)._repr_html_(),
    }
    for html in shown.values():
        assert " href=" not in html and "src=" not in html
    assert "<math" in shown["Observer"] and "1.3" in shown["Observer"]
    assert "The estimate converges" in shown["proved"] and "<table" in shown["proved"]
    assert shown["<svg"].count("<svg") >= 2
    assert repr(api.check(spec, effort=0)) == "<p: proved>"


def test_mistakes(spec: Path) -> None:
    wrong = GIVEN.replace("horizon: 6", "horizn: 6").replace("states:", "stats:")
    with pytest.raises(SpecError) as caught:
        api.parse(wrong, "w")
    told = api.validate(spec)
    assert len(caught.value.problems) >= 2 and not told
    spec.write_text(wrong)
    assert [one.severity for one in api.validate(spec)] == ["error"] * len(caught.value.problems)
    with pytest.raises(UsageError, match="no simulation block"):
        api.simulate(api.parse(GIVEN.split("simulation:")[0], "quiet"), effort=0)
    with pytest.raises(UsageError, match="no counterexample"):
        api.replay(api.parse(GIVEN), "convergence", effort=0)


def test_a_counterexample_is_run(spec: Path) -> None:
    document = api.replay(api.parse(GIVEN.replace("period: 0.6", "period: 9"), "late"), "convergence", effort=0)
    assert document["claim"] == "convergence"


def test_a_counterexample_is_no_run_of_what_is_expected(tmp_path: Path) -> None:
    expected = GIVEN + "expect:\n  - {quantity: simulation.overall.error_final, at_most: 0.1}\n"
    (tmp_path / "p.yaml").write_text(expected)
    done = forked(["simulate", "p.yaml", "--witness", "period_max", "--effort", "0"], tmp_path)
    assert done.returncode == 0 and "fails expect" not in done.stdout, done.stdout


def test_what_is_written_for_use_elsewhere(spec: Path) -> None:
    files = api.export(spec, "python", effort=0)
    assert files and all(path.is_file() for path in files)


@pytest.mark.parametrize("jobs", [1, 2])
def test_many_specs(spec: Path, jobs: int) -> None:
    (spec.parent / "w.yaml").write_text("spec_version: 1")
    good, wrong = api.run("p.yaml", "w.yaml", effort=0, jobs=jobs)
    assert (good.status, wrong.status) == ("ok", "invalid")
    assert good.check is not None and Path("results/p/report.html").is_file()


def test_a_sweep_returns_its_table(spec: Path) -> None:
    rows = api.sweep(spec, {"measurement.sampling.period": [0.3, 9], "observer.gain.K": "[[1], [1.3]]"}, effort=0)
    assert [row["verdict"] for row in rows] == ["proved", "refuted"]
    assert Path("results/p/sweep/sweep.csv").is_file()
    with pytest.raises(SpecError, match="perod"):
        api.sweep(spec, {"measurement.sampling.perod": [1]})


def test_a_comparison_returns_its_rows(spec: Path) -> None:
    found = api.compare(spec, effort=0)
    assert found.rows[0].name == "p" and found.page.is_file()
    assert any(row.certificate == "no certificate" for row in found.rows) and found.notes


def test_what_needs_no_spec() -> None:
    assert "convergence" in api.explain("convergence")
    assert api.schema()["$schema"] and api.theorems()
    assert re.search("family: auto", api.example()) and "lpv_zoh" in api.example("lpv_zoh")
