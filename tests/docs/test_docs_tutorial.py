"""The tutorial, typed as it stands: each command does what the page says it prints."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT
from docs_pages import WRITTEN, builder, commands

TUTORIAL = WRITTEN["tutorial.md"]
build = builder()
EFFORT = ("run", "check", "synthesize", "simulate")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With the tutorial's specs, and a `cdobs` to be found that takes the least effort."""
    for spec, name in zip(build.blocks(TUTORIAL, "yaml"), build.TUTORIAL, strict=True):
        (tmp_path / name).write_text(spec, encoding="utf-8")
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "cdobs"
    command.write_text(
        "#!/bin/sh\n"
        f'case "$1" in {"|".join(EFFORT)}) set -- "$@" --effort 0 ;; esac\n'
        f'PYTHONPATH={shlex.quote(str(ROOT))} exec {shlex.quote(sys.executable)} -m cdobs_cli "$@"\n'
    )
    command.chmod(0o755)
    return tmp_path


def shell(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    env = os.environ | {"PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.run(
        line, shell=True, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=120, check=False,
    )  # fmt: skip


def pattern(line: str) -> str:
    """Of a printed line; `..` stands for what is left out."""
    return r"^\s*" + ".*".join(map(re.escape, line.strip().split("..")))


def test_the_tutorial_runs_as_it_stands(folder: Path) -> None:
    for block in build.blocks(TUTORIAL, "console"):
        (line,) = commands(block)
        done = shell(line, folder)
        assert done.returncode == 0, f"{line}: {done.stdout}"
        for told in block.splitlines()[1:]:
            assert re.search(pattern(told), done.stdout, re.MULTILINE), f"{line} does not print: {told}\n{done.stdout}"
    assert {"first.yaml", "cdobs-spec.schema.json"} <= {path.name for path in folder.iterdir()}
    for name, (words, figures) in build.TUTORIAL.items():
        assert f"$ cdobs {words[0]} {shlex.join([name, *words[1:]])}" in TUTORIAL
        for figure in figures:
            assert (folder / "results" / Path(name).stem / "figures" / figure).is_file()
            assert f"(figures/{figure})" in TUTORIAL


def test_what_is_not_printed_would_be_seen() -> None:
    assert re.search(pattern("ok  a.yaml  (..) at .. s"), "ok  a.yaml  (1 s) at 3 s", re.MULTILINE)
    assert not re.search(pattern("the period is .. s"), "the rate is 3 s", re.MULTILINE)
