"""What `expect` decides of the stages that ran, what is left out, and what a time limit leaves."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest
from command import PENDULUM, forked
from documents import CHECKS

from cdobs_cli.batch import Settings, run
from cdobs_cli.findings import find
from cdobs_cli.outcome import Job, Result
from cdobs_cli.pipeline import Work, check, documents, simulate
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

EXPECT = """\
expect:
  - {quantity: design.outcome, equals: found}
  - {quantity: verdict, equals: proved}
  - {quantity: bounds.period_max.proved, at_least: 0.6}
  - {quantity: simulation.overall.diverged, equals: false}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("findings")
    (folder / "p.yaml").write_text(PENDULUM + EXPECT)
    return folder


def told(folder: Path, *stages: str) -> Result:
    os.chdir(folder)
    return run(Job(Path("p.yaml"), Path("results/p")), stages, Settings())


STIFF = """spec_version: 1
plant:
  states: [a, b]
  A: [[-1, 0], [1e5, -1e5]]
  phi: ["0", "0"]
  lipschitz: auto
measurement: {C: [[1, 0]], sampling: {period: 1}}
observer: {family: reachability, gain: {K: [["1/2"], [0]]}}
simulation: {horizon: 3, initial_state: [1, 0], initial_estimate: [0, 0]}
"""


def test_a_stiff_run_is_remarked_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.yaml").write_text(STIFF)
    result = told(tmp_path, "simulate")
    note = "the run is stiff and was integrated with an implicit method (Radau)"
    assert [(message.severity, message.text) for message in result.messages] == [("note", note)]
    assert result.status == "ok"
    assert [message.text for message in told(tmp_path, "simulate").messages] == [note]


@pytest.mark.parametrize(
    ("stages", "expected", "remarks"),
    [
        (("synthesize",), [0], ["2 expect entries about check were left out: check was not run",
                                "1 expect entry about simulate was left out: simulate was not run"]),
        (("simulate",), [0, 3], ["2 expect entries about check were left out: check was not run"]),
        (("check",), [0, 1, 2], ["1 expect entry about simulate was left out: simulate was not run"]),
        (("synthesize", "check", "simulate"), [0, 1, 2, 3], []),
    ],
)  # fmt: skip
def test_entries_of_stages_that_were_not_run_are_left_out_and_said_to_be(
    folder: Path, monkeypatch: pytest.MonkeyPatch, stages: tuple[str, ...], expected: list[int], remarks: list[str]
) -> None:
    monkeypatch.chdir(folder)
    result = told(folder, *stages)
    assert result.status == "ok"
    assert result.expected == tuple(f"expect[{number}]" for number in expected)
    assert [(message.severity, message.text) for message in result.messages] == [("note", text) for text in remarks]
    assert all(message.line for message in result.messages)
    assert not any(line.strip().startswith("fails") for line in result.summary)


@pytest.mark.parametrize("output", ["text", "json", "junit", "sarif", "github"])
def test_a_remark_is_no_finding_in_any_format(folder: Path, output: str) -> None:
    done = forked(["synthesize", "p.yaml", "--format", output], folder)
    assert done.returncode == 0
    assert "note: p.yaml:" in done.stderr
    if output == "junit":
        assert 'failures="0" errors="0"' in done.stdout
    if output == "github":
        assert "::notice file=p.yaml" in done.stdout
    CHECKS[output](done.stdout, 0)


def test_without_an_entry_about_it_the_verdict_is_expected_to_be_proved(tmp_path: Path) -> None:
    """The printed gain fails at a period ten times as long; an entry about something else does not excuse it."""
    spec = PENDULUM.replace("period: 0.6", "period: 6").replace(
        "  method: set", "  method: set\n  gain: {K: [[1], [1.8361]]}"
    )
    (tmp_path / "p.yaml").write_text(spec + "expect: [{quantity: design.outcome, equals: given}]\n")
    assert forked(["check", "p.yaml", "--effort", "0"], tmp_path).returncode == 1
    (tmp_path / "p.yaml").write_text(spec + "expect: [{quantity: verdict, equals: refuted}]\n")
    assert forked(["check", "p.yaml", "--effort", "0"], tmp_path).returncode == 0


@pytest.mark.parametrize("limit", ["0", "0.02", "0.1", "0.3", "0.6"])
def test_a_time_limit_turns_an_answer_into_undecided_and_nothing_else(tmp_path: Path, limit: str) -> None:
    """Wherever it strikes: what is stored by then is printed as it is stored, and the exit code is 0 or 1."""
    (tmp_path / "p.yaml").write_text(PENDULUM)
    done = forked(["run", "p.yaml", "--time-limit", limit, "--format", "json"], tmp_path)
    document = CHECKS["json"](done.stdout, done.returncode)
    (result,) = document["results"]
    assert done.returncode in (0, 1)
    assert bool(done.returncode) == any("undecided" in message["text"] for message in result["messages"])
    for name in ("design", "check", "simulation"):
        if result[name] is not None:
            assert result[name] == json.loads((tmp_path / "results" / "p" / f"{name}.json").read_text())


def test_a_stored_proof_is_told_when_the_time_runs_out_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: object) -> None:
        time.sleep(60)

    (tmp_path / "p.yaml").write_text(PENDULUM)
    monkeypatch.setattr("cdobs_cli.pipeline.simulate", hang)
    done = forked(["run", "p.yaml", "--time-limit", "8", "--format", "json"], tmp_path)
    (result,) = json.loads(done.stdout)["results"]
    assert done.returncode == 1
    assert (result["design"]["outcome"], result["check"]["verdict"], result["simulation"]) == ("found", "proved", None)
    assert "simulate, report not finished within 8 s" in result["messages"][-1]["text"]


def test_an_error_beyond_what_is_proved_for_all_time_is_a_finding(tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text("""
spec_version: 1
plant: {states: [x], A: [[-1]], phi: ["0"], lipschitz: [[0]], disturbance: {lower: [-0.1], upper: [0.1]}}
measurement: {C: [[1]], sampling: {period: 0.5}, noise: {lower: [-0.1], upper: [0.1]}}
observer: {family: reachability, gain: {K: [["0.5"]]}}
simulation: {horizon: 5, initial_state: [1], initial_estimate: [0]}
""")
    spec = load(tmp_path / "spec.yaml")
    work = Work(spec, Store(tmp_path / "results"))
    check(work)
    simulate(work)
    made = documents(work)
    stages = frozenset({"check", "simulate"})
    assert made["check"] is not None and made["simulation"] is not None and find(spec, made, stages) == []
    bound, most = made["check"]["bounds"]["error_transient.x"], made["simulation"]["overall"]["error_max"]["x"]
    assert 0.9 < most <= float(bound["proved"])
    made["check"]["bounds"]["error_transient.x"] = bound | {"proved": "0.5"}
    (told,) = find(spec, made, stages)
    assert "above the 0.5 that is proved" in told.text
