"""What the README shows for Makefiles, CI and hooks is run as it stands there."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import documents
import pytest
import yaml
from command import PENDULUM, ROOT

from cdobs_cli.batch import Settings, run
from cdobs_cli.outcome import STAGES, Job
from cdobs_cli.scaffold import example

NUMBER = re.compile(r"\d+(?:\.\d+)?")
README = (ROOT / "README.md").read_text(encoding="utf-8")
HOOKS: list[dict[str, Any]] = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """specs/good.yaml with its results, and a `cdobs` to be found on the PATH."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "specs").mkdir()
    (folder / "specs" / "good.yaml").write_text(PENDULUM)
    (folder / "specs" / "shared.plant.yaml").write_text("states: [x]\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(Job(Path("specs/good.yaml"), Path("results/good")), STAGES, Settings()).status == "ok"
    (folder / "bin").mkdir()
    command = folder / "bin" / "cdobs"
    command.write_text(
        f'#!/bin/sh\nPYTHONPATH={shlex.quote(str(ROOT))} exec {shlex.quote(sys.executable)} -m cdobs_cli "$@"\n'
    )
    command.chmod(0o755)
    return folder


@pytest.fixture
def project(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "project")
    return tmp_path / "project"


def shell(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.run(
        line, shell=True, cwd=folder, env=env, capture_output=True, text=True, timeout=120, check=False
    )


def test_the_example_is_what_init_writes_and_its_result_is_what_is_printed(project: Path) -> None:
    shown, (console,) = blocks("yaml")[0], blocks("console")
    command, *told = console.splitlines()
    assert command == "$ cdobs run pendulum.yaml" and shown == example()
    assert shell("cdobs init -o pendulum.yaml", project).returncode == 0
    printed = shell(f"{command.removeprefix('$ ')} --no-report", project).stdout
    # Searches may end a little elsewhere with other versions of the solver; the words are the same.
    lines = {NUMBER.sub("#", line): line for line in printed.splitlines()}
    for line in told[1:]:
        found = [float(number) for number in NUMBER.findall(lines[NUMBER.sub("#", line)])]
        assert found == pytest.approx([float(number) for number in NUMBER.findall(line)], rel=0.02)
    assert told[0] in printed


def test_the_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).is_file()] == []


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_the_makefile_rule(project: Path) -> None:
    (rule,) = blocks("make")
    (project / "Makefile").write_text(rule)
    spec, report = project / "specs" / "good.yaml", project / "results" / "good" / "report.html"
    assert shell("make", project).returncode == 0
    assert "Nothing to be done" in shell("make", project).stdout
    # A comment costs a look, and no work.
    before = (project / "results" / "good" / "design.json").stat().st_mtime_ns
    spec.write_text(spec.read_text() + "# a comment\n")
    os.utime(spec, ns=(report.stat().st_mtime_ns + 10**9,) * 2)
    assert "cdobs run" in shell("make", project).stdout
    assert (project / "results" / "good" / "design.json").stat().st_mtime_ns == before
    # A spec that does not hold fails, every time, and the others are still made.
    (project / "specs" / "bad.yaml").write_text(PENDULUM.replace("states", "stats"))
    for _ in range(2):
        done = shell("make -k", project)
        assert done.returncode == 2
        assert "specs/bad.yaml:4" in done.stderr
    assert report.exists()


def test_a_finding_does_not_count_as_made(project: Path) -> None:
    (rule,) = blocks("make")
    (project / "Makefile").write_text(rule)
    spec = project / "specs" / "good.yaml"
    spec.write_text(spec.read_text() + "expect:\n- {quantity: bounds.period_max.proved, at_least: 99}\n")
    for _ in range(2):
        done = shell("make", project)
        assert done.returncode == 2
        assert "expect[0]" in done.stderr and "Error 1" in done.stderr
    assert (project / "results" / "good" / "report.md").exists()


def test_the_workflow(project: Path) -> None:
    (workflow,) = [block for block in blocks("yaml") if "runs-on" in block]
    steps = yaml.safe_load(workflow)["jobs"]["observers"]["steps"]
    lines = [step["run"] for step in steps if "run" in step]
    assert lines[0] == "pip install cdobs"
    for line in lines[1:]:
        done = shell(line, project)
        assert done.returncode == 0, done.stderr
        documents.github(done.stdout, 0)
        (project / "specs" / "bad.yaml").write_text(PENDULUM.replace("states", "stats"))
        done = shell(line, project)
        assert done.returncode == 2
        assert any(properties.get("file") == "specs/bad.yaml" for _, properties, _ in documents.github(done.stdout, 2))


@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: hook["id"])
def test_the_hooks(project: Path, hook: dict[str, Any]) -> None:
    names = ["specs/good.yaml", "specs/deeper/x.yml", "specs/shared.plant.yaml", "other.yaml", "specs/notes.txt"]
    meant = [name for name in names if re.search(hook["files"], name) and not re.search(hook["exclude"], name)]
    assert meant == names[:2]
    assert hook["language"] == "python"
    assert shell(f"{hook['entry']} specs/good.yaml", project).returncode == 0
    (project / "specs" / "bad.yaml").write_text("spec_version: 1\n")
    assert shell(f"{hook['entry']} specs/good.yaml specs/bad.yaml", project).returncode == 2


def test_the_readme_names_hooks_that_exist() -> None:
    (config,) = [yaml.safe_load(block) for block in blocks("yaml") if "repos:" in block]
    asked = {hook["id"] for repository in config["repos"] for hook in repository["hooks"]}
    assert asked <= {hook["id"] for hook in HOOKS}
