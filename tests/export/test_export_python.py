"""The Python file: alone, and equal to the simulator."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from exporting import CASES, NAMES, ready

from cdobs_cli.export.python import python_text
from cdobs_cli.export.vectors import TOLERANCE


def loaded(text: str) -> dict[str, Any]:
    space: dict[str, Any] = {"__name__": "exported"}
    exec(compile(text, "exported.py", "exec"), space)
    return space


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_it_is_as_the_simulator_is(case: tuple[str, str]) -> None:
    one = ready(case)
    kinds = {call.kind for call in one.vectors.calls}
    assert kinds >= ({"sample", "arrive"} if one.portable.late else {"correct"})
    assert one.about.accuracy is not None and one.about.accuracy <= TOLERANCE
    space = loaded(python_text(one.portable, one.about, one.vectors))
    assert space["self_test"]() <= TOLERANCE
    first = next(k for k, row in enumerate(space["CALLS"]) if row[6])
    row = list(space["CALLS"][first])
    row[6] = (row[6][0] + 1e-8 * space["SCALE"][0], *row[6][1:])
    space["CALLS"] = (*space["CALLS"][:first], tuple(row), *space["CALLS"][first + 1 :])
    assert space["self_test"]() > TOLERANCE


def test_it_needs_the_standard_library_only(tmp_path: Path) -> None:
    one = ready(("reachability", "late_sensors"))
    (tmp_path / "observer.py").write_text(python_text(one.portable, one.about, one.vectors))
    done = subprocess.run(
        [sys.executable, "-I", "-S", "observer.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("largest distance from the simulation")


def test_a_late_value_is_refused_once_nothing_is_kept_of_its_sample() -> None:
    one = ready(("lpv_zoh", "late"))
    space = loaded(python_text(one.portable, one.about, one.vectors))
    observer = space["Observer"]((0.0, 0.0))
    ticket = observer.sample((0.0,))
    for _ in range(50):
        observer.predict(0.3, (0.0,))
        observer.sample((0.0,))
    before = observer.x_hat()
    assert observer.arrive(ticket, (1.0,)) is False
    assert observer.x_hat() == before


def test_messages_of_one_instant_may_come_in_any_order() -> None:
    one = ready(("reachability", "on_change"))
    text = python_text(one.portable, one.about, one.vectors)
    first, second = (loaded(text)["Observer"]((0.0, 0.0)) for _ in range(2))
    first.correct_a((1.0,), (0.0,))
    first.correct_b((0.7,), (0.0,))
    second.correct_b((0.7,), (0.0,))
    second.correct_a((1.0,), (0.0,))
    assert first.x_hat() == second.x_hat() != (0.0, 0.0)


def test_hostile_titles_are_text() -> None:
    one = ready(("reachability", "periodic"))
    hostile = replace(one.about, title='"""; raise SystemExit \\N{x} \\ \n raise SystemExit #')
    loaded(python_text(one.portable, hostile, one.vectors))
