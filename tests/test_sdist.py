"""The source distribution: what the tests need is in it, and nothing that a build or a run leaves."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path, PurePosixPath

import pytest
from command import ROOT

LEFT = (".venv", ".lowest", ".git", "results", "build", "dist", "__pycache__", ".*_cache", ".hypothesis", "*.egg-info")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the project as it is in a fresh clone."""
    folder = tmp_path_factory.mktemp("sdist") / "source"
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*LEFT))
    return folder


def test_the_source_distribution_holds_all_that_is_in_the_repository(source: Path) -> None:
    before = {path.relative_to(source).as_posix() for path in source.rglob("*") if path.is_file()}
    code = "from setuptools.build_meta import build_sdist; build_sdist('dist')"
    done = subprocess.run([sys.executable, "-c", code], cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (archive,) = (source / "dist").iterdir()
    with tarfile.open(archive) as packed:
        names = {
            PurePosixPath(*PurePosixPath(member.name).parts[1:]).as_posix() for member in packed if member.isfile()
        }
    made = {"PKG-INFO", "setup.cfg", *(name for name in names if name.startswith("cdobs.egg-info/"))}
    assert names - made == before - made - {".gitignore"}
    assert {"LICENSE", "tests/conftest.py", "specs/reachability_pendulum.yaml", "cdobs_cli/references.bib"} <= names


def test_the_licence_stands_as_an_expression() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["license"] == "MIT"
    assert project["project"]["license-files"] == ["LICENSE"]
    assert project["build-system"]["requires"] == ["setuptools>=77"]
