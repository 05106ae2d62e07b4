"""Every shipped spec holds what it expects."""

from __future__ import annotations

from pathlib import Path

import pytest
from command import ROOT

from cdobs_cli.batch import Settings, run
from cdobs_cli.outcome import Job
from cdobs_cli.spec.model import load

SPECS = sorted((ROOT / "specs").glob("*.yaml"))


@pytest.mark.parametrize("path", SPECS, ids=[path.stem for path in SPECS])
def test_what_it_expects_holds(path: Path, tmp_path: Path) -> None:
    made = run(Job(path, tmp_path / path.stem), ("synthesize", "check", "simulate"), Settings())
    assert [str(message) for message in made.messages if message.severity == "error"] == []
    assert len(made.expected) == len(load(path).expect)


def test_they_expect_something() -> None:
    assert sum(len(load(path).expect) for path in SPECS) >= 190
    assert all(load(path).expect for path in SPECS)
