"""C99: compiled without a warning, clean under sanitizers, equal to the simulator."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from exporting import CASES, NAMES, Ready, ready

from cdobs_cli.export.c99_test import c99_files
from cdobs_cli.library import compiler

CC = compiler()
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
CHECKED = ["-fsanitize=address,undefined", "-fno-sanitize-recover"]
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler on this machine")


def run(folder: Path, one: Ready, real: str, flags: list[str]) -> subprocess.CompletedProcess[str]:
    """Compile the observer with its test, and run that."""
    for name, text in c99_files(one.portable, one.about, one.vectors, real).items():
        (folder / name).write_text(text)
    sources = sorted(path.name for path in folder.glob("*.c"))
    assert CC is not None
    made = subprocess.run(
        [CC, *STRICT, *flags, "-o", "test", *sources, "-lm"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    return subprocess.run([folder / "test"], cwd=folder, capture_output=True, text=True, check=False)


def distance(done: subprocess.CompletedProcess[str]) -> float:
    """What the test program measured."""
    found = re.search(r"simulation: (\S+) of at most", done.stdout)
    assert found is not None, done.stdout + done.stderr
    return float(found[1])


@needs_compiler
@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_it_is_as_the_simulator_is_and_clean(tmp_path: Path, case: tuple[str, str]) -> None:
    done = run(tmp_path, ready(case), "double", CHECKED)
    assert done.returncode == 0, done.stdout + done.stderr
    assert distance(done) <= 1e-9
    assert "bytes" in done.stdout and "us on this machine" in done.stdout


@needs_compiler
@pytest.mark.parametrize(
    "case", [("reachability", "multirate"), ("reachability", "late"), ("shipped", "updated_sampling_unstable")]
)
def test_single_precision(tmp_path: Path, case: tuple[str, str]) -> None:
    one = ready(case)
    done = run(tmp_path, one, "float", ["-O2", "-Wdouble-promotion"])
    assert done.returncode == 0, done.stdout + done.stderr
    assert 1e-12 < distance(done) <= 1e-4
    source = (tmp_path / f"{one.portable.name}.c").read_text()
    assert "double" not in source.split("*/", 1)[1]


@needs_compiler
def test_another_measurement_is_found(tmp_path: Path) -> None:
    one = ready(("reachability", "multirate"))
    calls = list(one.vectors.calls)
    at = next(k for k, call in enumerate(calls) if k > 5 and call.kind == "correct")
    calls[at] = replace(calls[at], y=(calls[at].y[0] + 1e-7, *calls[at].y[1:]))
    done = run(tmp_path, replace(one, vectors=replace(one.vectors, calls=tuple(calls))), "double", [])
    assert done.returncode == 1
    assert distance(done) > 1e-9


@needs_compiler
def test_a_sample_outside_the_law_is_told(tmp_path: Path) -> None:
    one = ready(("reachability", "multirate"))
    calls = [replace(call, dt=call.dt * 1.5) for call in one.vectors.calls]
    done = run(tmp_path, replace(one, vectors=replace(one.vectors, calls=tuple(calls))), "double", CHECKED)
    assert done.returncode == 1
    assert "a call was not answered as it should be" in done.stdout


@needs_compiler
def test_titles_end_no_comment(tmp_path: Path) -> None:
    one = ready(("reachability", "periodic"))
    hostile = replace(one.about, title='*/ int x; /* ??/ \\ " %s @NAME@ {} \n#error')
    done = run(tmp_path, replace(one, about=hostile), "double", [])
    assert done.returncode == 0, done.stdout + done.stderr


@needs_compiler
def test_the_makefile_prints_size_and_times(tmp_path: Path) -> None:
    one = ready(("reachability", "periodic"))
    for name, text in c99_files(one.portable, one.about, one.vectors).items():
        (tmp_path / name).write_text(text)
    done = subprocess.run(["make", f"CC={CC}"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("predict: ") == done.stdout.count("correct: ") == 2
    assert re.search(r"text\s+data\s+bss", done.stdout)
