"""`cdobs export` as a user runs it: files, messages, exit codes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from command import PENDULUM, forked, made

from cdobs_cli.store import sealed

FILES = {
    "c99": {"c99/Makefile", "c99/observer_p.c", "c99/observer_p.h", "c99/observer_p_test.c"},
    "python": {"observer_p.py"},
    "json": {"observer_p.json"},
    "mat": {"observer_p.mat"},
    "control": {"observer_p_control.py"},
}


@pytest.fixture
def folder(tmp_path: Path, finished: Path) -> Path:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path


def below(folder: Path) -> dict[str, bytes]:
    top = folder / "results/p/export"
    return {path.relative_to(top).as_posix(): path.read_bytes() for path in top.rglob("*") if path.is_file()}


@pytest.mark.parametrize("target", FILES)
def test_each_target_has_its_files_and_they_are_the_same_again(folder: Path, target: str) -> None:
    done = forked(["export", "p.yaml", "--to", target], folder)
    assert done.returncode == 0, done.stderr
    first = below(folder)
    assert set(first) == FILES[target]
    assert all(f"written: results/p/export/{name}" in done.stdout for name in first)
    forked(["export", "p.yaml", "--to", target, "--force"], folder)
    assert below(folder) == first
    design = json.loads((folder / "results/p/design.json").read_text())
    digest = design["digests"]["content"].encode()
    assert any(digest in content for content in first.values())


def test_precision_is_that_of_the_numbers_in_c(folder: Path) -> None:
    assert forked(["export", "p.yaml", "--to", "c99", "--precision", "float"], folder).returncode == 0
    assert b"typedef float observer_p_real;" in below(folder)["c99/observer_p.h"]


def test_without_a_design_the_command_that_makes_it_is_told(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(PENDULUM)
    done = forked(["export", "p.yaml", "--to", "json"], tmp_path)
    assert done.returncode == 2
    assert "no current design.json for this spec; run `cdobs check` first" in done.stderr


def test_another_spec_or_an_edited_artefact_is_refused(folder: Path) -> None:
    design = folder / "results/p/design.json"
    text = design.read_text()
    design.write_text(text.replace('"found"', '"given"'))
    done = forked(["export", "p.yaml", "--to", "json"], folder)
    assert done.returncode == 2 and "design.json was edited or damaged" in done.stderr
    changed = json.loads(text)
    changed["gain"]["K"][0][0] = "0.5"
    design.write_text(json.dumps(sealed(changed)))
    done = forked(["export", "p.yaml", "--to", "json"], folder)
    assert done.returncode == 2 and "no current check.json for this design" in done.stderr
    design.write_text(text)
    (folder / "p.yaml").write_text(PENDULUM.replace("0.6", "0.5"))
    assert forked(["export", "p.yaml", "--to", "json"], folder).returncode == 2
    assert below(folder) == {}


def test_a_target_is_asked_for(folder: Path) -> None:
    done = forked(["export", "p.yaml"], folder)
    assert done.returncode == 2 and "--to" in done.stderr
    assert forked(["export", "p.yaml", "--to", "fortran"], folder).returncode == 2


def test_what_is_not_proved_says_so_and_is_a_finding(tmp_path: Path) -> None:
    text = PENDULUM.replace("  method: set\n", "  gain: {K: [[-1], [-1.8361]]}\n")
    made(tmp_path, text, ("check",))
    done = forked(["export", "s.yaml", "--to", "c99", "--effort", "0", "-o", "out_of"], tmp_path)
    assert done.returncode == 2
    shutil.move(tmp_path / "out", tmp_path / "out_of/s")
    done = forked(["export", "s.yaml", "--to", "c99", "--effort", "0", "-o", "out_of"], tmp_path)
    assert done.returncode == 1, done.stderr
    header = (tmp_path / "out_of/s/export/c99/observer_s.h").read_text()
    assert "Verdict: refuted. NOT PROVED" in header


def test_without_a_simulation_there_is_no_test_program(tmp_path: Path) -> None:
    text = PENDULUM[: PENDULUM.index("simulation:")]
    made(tmp_path, text, ("check",))
    (tmp_path / "results").mkdir()
    shutil.move(tmp_path / "out", tmp_path / "results/s")
    for target in ("c99", "python", "json"):
        done = forked(["export", "s.yaml", "--to", target, "--effort", "0"], tmp_path)
        assert done.returncode == 0, done.stderr
    names = {path.name for path in (tmp_path / "results/s/export/c99").iterdir()}
    assert names == {"observer_s.c", "observer_s.h"}
    assert json.loads((tmp_path / "results/s/export/observer_s.json").read_text())["vectors"] is None


def test_where_no_observer_was_found_there_is_nothing_to_export(tmp_path: Path) -> None:
    text = PENDULUM.replace("C: [[1, 0]]", "C: [[0, 1]]").replace('"sin(theta)"', '"0"')
    text = text.replace("lipschitz: [[0, 0], [1, 0]]", "lipschitz: [[0, 0], [0, 0]]").replace("  method: set\n", "")
    made(tmp_path, text, ("check",))
    (tmp_path / "results").mkdir()
    shutil.move(tmp_path / "out", tmp_path / "results/s")
    done = forked(["export", "s.yaml", "--to", "json", "--effort", "0"], tmp_path)
    assert done.returncode == 2
    assert "there is no observer to export" in done.stderr
