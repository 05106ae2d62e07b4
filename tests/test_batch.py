"""Which specs a PATH means, what a second run costs, what a killed run leaves, and what terminals and pipes get."""

from __future__ import annotations

import json
import os
import pty
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import documents
import pytest
from command import ROOT, Cdobs, forked

from cdobs_cli.batch import jobs
from cdobs_cli.outcome import readable


def found(paths: list[Path], out: Path) -> dict[str, str]:
    return {str(job.spec): job.refused or str(job.folder) for job in jobs(paths, out)}


def touch(*paths: str) -> None:
    for path in paths:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).touch()


def test_a_directory_means_the_specs_below_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    touch(
        "d/b.yaml",
        "d/a.yml",
        "d/deep/er/c.yaml",
        "d/x.plant.yaml",
        "d/x.plant.yml",
        "d/.hidden/h.yaml",
        "d/.h.yaml",
        "d/notes.txt",
    )
    touch("d/results/old/design.yaml", "elsewhere/far.yaml")
    os.symlink("../elsewhere", "d/link")
    os.symlink("..", "d/deep/loop")
    expected = {"d/a.yml": "d/results/a", "d/b.yaml": "d/results/b", "d/deep/er/c.yaml": "d/results/deep/er/c"}
    assert found([Path("d")], Path("d/results")) == expected
    assert list(found([Path("d")], Path("d/results"))) == list(expected)
    # A link that is given itself is followed; a spec given twice is one job.
    assert found([Path("d/link"), Path("elsewhere"), Path("d/link/far.yaml")], Path("r")) == {
        "d/link/far.yaml": "r/far"
    }


def test_what_cannot_be_carried_out_costs_its_own_row_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    touch("d/a.yaml", "e/a.yaml", "d/c.yaml")
    Path("empty").mkdir()
    told = found([Path("empty"), Path("d"), Path("e")], Path("r"))
    assert told == {
        "empty": "no spec (*.yaml, *.yml) below this directory",
        "d/a.yaml": "r/a", "d/c.yaml": "r/c",
        "e/a.yaml": "d/a.yaml has its results in r/a already; give one of them another name or another --out",
    }  # fmt: skip


def test_what_only_reads_takes_equal_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    touch("d/a.yaml", "e/a.yaml")
    assert [job.refused for job in jobs([Path("d/a.yaml"), Path("e/a.yaml")], Path("r"), writing=False)] == [None, None]


def test_a_folder_that_cannot_be_read_is_not_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    touch("d/a.yaml", "d/locked/b.yaml")
    scandir = os.scandir

    def refused(path: str) -> object:
        if str(path).endswith("locked"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refused)
    assert found([Path("d")], Path("r")) == {"d/locked": "cannot be read: Permission denied", "d/a.yaml": "r/a"}


def test_unreadable_specs_and_names_that_are_no_text(tmp_path: Path, pendulum: str, finished: Path) -> None:
    folder = tmp_path / "d"
    shutil.copytree(finished, folder)
    os.rename(os.fsencode(folder / "p.yaml"), os.fsencode(folder) + b"/p\xff.yaml")
    os.rename(os.fsencode(folder / "results/p"), os.fsencode(folder) + b"/results/p\xff")
    (folder / "dead.yaml").symlink_to("nowhere")
    (folder / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for output, check in documents.CHECKS.items():
        done = forked(["check", ".", "--format", output], folder)
        assert done.returncode == 2
        check(done.stdout, 2)
        assert "Traceback" not in done.stderr
        assert "dead.yaml" in done.stderr and "binary.yaml" in done.stderr
    assert readable("p\udcff") == "p\ufffd"


def seconds(cdobs: Cdobs, *arguments: str) -> float:
    """CPU time of a command and of its workers."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = cdobs(*arguments)
    assert done.returncode == 0, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_a_second_run_costs_less_than_two_validations(tmp_path: Path, cdobs: Cdobs, finished: Path) -> None:
    (tmp_path / "specs").mkdir()
    for name in ("a", "b", "c"):
        shutil.copy(finished / "p.yaml", tmp_path / "specs" / f"{name}.yaml")
        shutil.copytree(finished / "results" / "p", tmp_path / "results" / name)
    cdobs("run", "specs")  # the reports carry the new names
    runs, validations = [], []
    for _ in range(3):
        runs.append(seconds(cdobs, "run", "specs"))
        validations.append(seconds(cdobs, "validate", "specs"))
    assert min(runs) < 2 * min(validations)


def test_a_killed_run_leaves_whole_files_and_the_next_goes_on(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    for number in range(4):
        (tmp_path / f"p{number}.yaml").write_text(pendulum)
    process = subprocess.Popen(
        [sys.executable, "-m", "cdobs_cli", "check", "."],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("results/*/design.json")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=30)
    for path in (tmp_path / "results").rglob("*.json"):
        json.loads(path.read_text())
    first = tmp_path / "results" / "p0" / "design.json"
    before = first.stat().st_mtime_ns
    # What a kill in the middle of a write leaves behind.
    (first.parent / ".design.json.abcd1234").write_text('{"schema_version": 1, "fam')
    (first.parent / ".check.json.abcd1234").write_bytes(b"")
    done = cdobs("check", ".")
    assert done.returncode == 0, done.stderr
    assert first.stat().st_mtime_ns == before
    assert len(list(tmp_path.glob("results/*/check.json"))) == 4


def in_terminal(arguments: list[str], folder: Path, **env: str) -> tuple[str, str]:
    """stdout (a pipe) and stderr (a terminal of 24 lines) of a command."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "cdobs_cli", *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=theirs,
        stdin=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100", "LINES": "24"} | env,
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    while select.select([ours], [], [], 30)[0]:
        try:
            part = os.read(ours, 65536)
        except OSError:
            break
        if not part:
            break
        shown += part
    assert process.stdout is not None
    output = process.stdout.read().decode()
    process.wait(timeout=30)
    os.close(ours)
    return output, shown.decode()


def test_terminals_get_a_live_table_and_pipes_get_lines(tmp_path: Path, finished: Path) -> None:
    shutil.copytree(finished, tmp_path / "d")
    (tmp_path / "d" / "q.yaml").write_text("spec_version: 1\n")
    output, shown = in_terminal(["check", "."], tmp_path / "d")
    assert [line.split()[:2] for line in output.splitlines()] == [["ok", "p.yaml"], ["invalid", "q.yaml"], ["1", "ok,"]]
    assert "\033" not in output
    assert "running" in shown and "1/2" in shown
    assert "\033[2K" in shown  # the table is taken away line by line
    assert "\033[31merror" in shown
    _, plain = in_terminal(["check", "."], tmp_path / "d", NO_COLOR="1")
    assert "error: q.yaml" in plain and "\033[31m" not in plain
    _, dumb = in_terminal(["check", ".", "--no-color"], tmp_path / "d", TERM="dumb")
    assert "\033" not in dumb
    _, quiet = in_terminal(["check", ".", "-q"], tmp_path / "d")
    assert "running" not in quiet and "q.yaml" in quiet


def test_a_single_spec_is_followed_too(tmp_path: Path, pendulum: str) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    output, shown = in_terminal(["check", "p.yaml", "-v"], tmp_path)
    assert "running" in shown and "synthesize" in shown and "running" not in output
    assert re.search(r"synthesize \d+\.\d\d s, check \d+\.\d\d s", shown)
    _, read = in_terminal(["validate", "p.yaml"], tmp_path)
    assert "running" not in read


def test_figures_are_what_is_asked_for(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    spec = tmp_path / "p.yaml"
    spec.write_text(pendulum)
    figures = tmp_path / "results" / "p" / "figures"
    assert cdobs("run", "p.yaml", "--no-report").returncode == 0
    assert (tmp_path / "results" / "p" / "simulation.json").exists()
    assert not figures.exists() and not (figures.parent / "report.html").exists()
    assert cdobs("run", "p.yaml").returncode == 0
    drawn = {path.name: path.stat().st_mtime_ns for path in figures.glob("*.svg")}
    assert {"states.svg", "error.svg", "periods.svg"} <= set(drawn) and not list(figures.glob("*.png"))
    spec.write_text(pendulum + "report: {figures: [png, pdf]}\n")
    assert cdobs("report", "p.yaml").returncode == 0
    assert (figures / "states.png").read_bytes().startswith(b"\x89PNG")
    assert (figures / "states.pdf").read_bytes().startswith(b"%PDF")
    spec.write_text(pendulum + "report: {figures: [gif]}\n")
    told = cdobs("validate", "p.yaml")
    assert told.returncode == 2 and "report.figures[0]" in told.stderr and "svg, png or pdf" in told.stderr


def test_logs_get_one_line_a_spec(tmp_path: Path, finished: Path) -> None:
    shutil.copytree(finished, tmp_path / "d")
    folder = tmp_path / "d"
    shutil.copytree(folder / "results" / "p", folder / "results" / "sub" / "p")
    (folder / "sub").mkdir()
    shutil.copy(folder / "p.yaml", folder / "sub" / "p.yaml")
    done = forked(["check", ".", "--jobs", "2"], folder)
    assert [line.split()[:3] for line in done.stdout.splitlines()] == [
        ["ok", "p.yaml", "proved;"], ["ok", "sub/p.yaml", "proved;"], ["2", "ok", "of"],
    ]  # fmt: skip
    assert done.stderr == ""
    loud = forked(["check", ".", "-v"], folder).stdout
    assert loud.count("claims:") == 2
    assert forked(["check", ".", "-q"], folder).stdout.splitlines() == ["2 ok of 2 specs"]
    logged = forked(["check", ".", "--format", "json"], folder)
    assert [line.split()[:2] for line in logged.stderr.splitlines()] == [["ok", "p.yaml"], ["ok", "sub/p.yaml"]]
    assert forked(["check", ".", "--format", "json", "-q"], folder).stderr == ""


@pytest.mark.parametrize("arguments", [["theorems"], ["check", "p.yaml", "--format", "json"], ["check", "p.yaml"]])
def test_a_reader_that_leaves_is_no_accident(finished: Path, arguments: list[str]) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "cdobs_cli", *arguments], cwd=finished, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    told = process.stderr.read()
    assert process.wait(timeout=30) == 3
    assert told == ""
