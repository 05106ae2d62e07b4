"""Every command, whatever happens, in every format: the exit code, and output that its readers accept."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import documents
import pytest
from command import PENDULUM, Done, forked

from cdobs_cli.batch import Settings, run
from cdobs_cli.outcome import STAGES, Job
from cdobs_cli.store import sealed

REFUTED = PENDULUM.replace("  method: set\n", "  method: set\n  gain: {K: [[-1], [-1.8361]]}\n")
FINDING = (
    REFUTED
    + "expect:\n- {quantity: design.outcome, equals: none}\n"
    + "- {quantity: simulation.overall.error_final, at_most: 1e-9}\n"
)
CODES = {
    "validate": {
        "holds": 0,
        "finding": 0,
        "undecided": 0,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 0,
        "interrupt": 3,
    },
    "synthesize": {
        "holds": 0,
        "finding": 1,
        "undecided": 0,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 3,
        "interrupt": 3,
    },
    "check": {
        "holds": 0,
        "finding": 1,
        "undecided": 1,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 3,
        "interrupt": 3,
    },
    "simulate": {
        "holds": 0,
        "finding": 1,
        "undecided": 0,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 3,
        "interrupt": 3,
    },
    "report": {
        "holds": 0,
        "finding": 1,
        "undecided": 1,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 3,
        "interrupt": 3,
    },
    "run": {
        "holds": 0,
        "finding": 1,
        "undecided": 1,
        "invalid": 2,
        "no spec": 2,
        "crash": 3,
        "unwritable": 3,
        "interrupt": 3,
    },
}


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory, finished: Path) -> Path:
    """Folders with a spec each and its results, ready to be copied."""
    place = tmp_path_factory.mktemp("prepared")
    shutil.copytree(finished, place / "holds")
    (place / "finding").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place / "finding")
        Path("p.yaml").write_text(FINDING)
        run(Job(Path("p.yaml"), Path("results/p")), STAGES, Settings())
    shutil.copytree(place / "holds", place / "undecided")
    path = place / "undecided" / "results" / "p" / "check.json"
    check = json.loads(path.read_text())
    for claim in check["claims"]:
        claim["status"] = "undecided" if claim["id"] == "convergence" else claim["status"]
    path.write_text(json.dumps(sealed({**check, "verdict": "undecided"})))
    return place


def crash() -> None:
    def load(path: Path) -> Any:
        raise RuntimeError("broken on purpose\x07")

    pytest.MonkeyPatch().setattr("cdobs_cli.spec.model.load", load)


def killed() -> None:
    def load(path: Path) -> Any:
        os.kill(os.getpid(), signal.SIGKILL)

    pytest.MonkeyPatch().setattr("cdobs_cli.spec.model.load", load)


def interrupt() -> None:
    started_by = os.getpid()

    def load(path: Path) -> Any:
        os.kill(started_by, signal.SIGINT)
        time.sleep(30)

    pytest.MonkeyPatch().setattr("cdobs_cli.spec.model.load", load)


def full_disk() -> None:
    def replace(*paths: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    patch = pytest.MonkeyPatch()
    patch.setattr("os.replace", replace)
    patch.setattr("cdobs_cli.report.files.render", lambda report, drawings: {"report.md": b"#"})
    patch.setattr("cdobs_cli.report.drawings.Drawings.drawn", lambda *given: ({}, {}))  # figures take their time


BROKEN: dict[str, Callable[[], None]] = {
    "crash": crash,
    "killed": killed,
    "interrupt": interrupt,
    "unwritable": full_disk,
}


def carried_out(prepared: Path, folder: Path, command: str, condition: str, output: str) -> Done:
    if not folder.exists():
        shutil.copytree(prepared / (condition if condition in ("finding", "undecided") else "holds"), folder)
        if condition == "invalid":
            (folder / "p.yaml").write_text(PENDULUM.replace("states", "stats"))
    arguments = [command, "results" if condition == "no spec" else "p.yaml", "--format", output]
    if condition == "unwritable" and command != "validate":
        arguments.append("--force")
    return forked(arguments, folder, BROKEN.get(condition, lambda: None))


@pytest.mark.parametrize("condition", CODES["run"])
@pytest.mark.parametrize("command", CODES)
def test_exit_codes_and_documents(prepared: Path, tmp_path: Path, command: str, condition: str) -> None:
    code = CODES[command][condition]
    for output, check in documents.CHECKS.items():
        done = carried_out(prepared, tmp_path / "here", command, condition, output)
        assert (output, done.returncode) == (output, code), done.stderr
        check(done.stdout, code)
        assert "Traceback" not in done.stderr
        assert done.stderr or code == 0
        if condition == "interrupt":
            assert "interrupted" in done.stderr


@pytest.mark.parametrize("command", STAGES)
def test_a_process_that_dies_is_a_failure(prepared: Path, tmp_path: Path, command: str) -> None:
    done = carried_out(prepared, tmp_path / "here", command, "killed", "json")
    assert done.returncode == 3
    (result,) = documents.json_document(done.stdout, 3)["results"]
    assert "SIGKILL" in result["messages"][0]["text"]


def test_what_fails_is_told_where_with_expected_and_found(prepared: Path, tmp_path: Path) -> None:
    done = carried_out(prepared, tmp_path / "here", "run", "finding", "json")
    (result,) = documents.json_document(done.stdout, 1)["results"]
    messages = {message["field"]: message for message in result["messages"]}
    assert [path for path in messages if path.startswith("expect")] == ["expect[0]", "expect[1]"]
    first = messages["expect[0]"]
    assert FINDING.splitlines()[first["line"] - 1].startswith("- {quantity: design.outcome")
    assert "equals none" in first["text"] and "given" in first["text"]
    assert result["check"]["verdict"] == "refuted"
    assert done.stderr.count("p.yaml:") == len(messages)


def test_artefacts_stand_whole_in_the_document(prepared: Path, tmp_path: Path) -> None:
    done = carried_out(prepared, tmp_path / "here", "run", "holds", "json")
    (result,) = documents.json_document(done.stdout, 0)["results"]
    for name in ("design", "check", "simulation"):
        assert result[name] == json.loads((tmp_path / "here/results/p" / f"{name}.json").read_text())


def test_junit_has_a_case_for_each_claim_and_expectation(prepared: Path, tmp_path: Path) -> None:
    done = carried_out(prepared, tmp_path / "here", "run", "finding", "junit")
    root = documents.junit(done.stdout, 1)
    cases = {case.attrib["name"]: [child.tag for child in case] for case in root.iter("testcase")}
    assert cases["convergence"] == cases["expect[0]"] == cases["expect[1]"] == ["failure"]
    assert cases["slopes.2.1"] == []


@pytest.mark.parametrize("output", ["json", "junit", "sarif", "github"])
@pytest.mark.parametrize(
    "arguments", [["run"], ["check", "p.yaml", "--effort", "9"], ["frobnicate"], ["run", "p.yaml", "--frobnicate"]]
)
def test_a_wrong_command_line_is_told_in_the_format_asked_for(
    tmp_path: Path, arguments: list[str], output: str
) -> None:
    done = forked([*arguments, f"--format={output}"], tmp_path)
    assert done.returncode == 2
    documents.CHECKS[output](done.stdout, 2)
    assert done.stderr


PLACES = {
    "the gain": (REFUTED, "  gain:"),
    "the period": (
        PENDULUM.replace("C: [[1, 0]]", "C: [[0, 0]]").replace("{period: 0.6}", "\n    # often\n    period: 0.6"),
        "    period:",
    ),
    "the slope entry": (PENDULUM.replace("[[0, 0], [1, 0]]", "\n  - [0, 0]\n  - [0.5, 0]"), "  - [0.5, 0]"),
    "the entry of expect": (
        PENDULUM + "expect:\n- quantity: bounds.period_max.proved\n  at_least: 99\n",
        "- quantity:",
    ),
}


@pytest.mark.parametrize("place", PLACES)
def test_annotations_point_at_the_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    from cdobs_cli.formats import render

    monkeypatch.chdir(tmp_path)
    content, expected = PLACES[place]
    Path("p.yaml").write_text(content)
    result = run(Job(Path("p.yaml"), Path("results/p")), ("check",), Settings(effort=0))
    assert result.status == "finding", result.messages
    lines = content.splitlines()
    told = documents.github(render("github", "check", [result], result.exit_code), 1)
    assert any(
        lines[int(properties["line"]) - 1].startswith(expected) for _, properties, _ in told if "line" in properties
    ), told
    regions = [
        found["locations"][0]["physicalLocation"]["region"]
        for found in documents.sarif(render("sarif", "check", [result], result.exit_code), 1)["runs"][0]["results"]
    ]
    assert [region["startLine"] for region in regions] == [
        int(properties["line"]) for _, properties, _ in told if "line" in properties
    ]
