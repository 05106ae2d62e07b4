"""An output that never sees a state is told by `validate` as a warning, from ranks and patterns alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdobs_cli.batch import Settings, run
from cdobs_cli.outcome import Job

TEXT = """
spec_version: 1
plant: {{states: [x, y], A: {A}, phi: {phi}, lipschitz: {slopes}}}
measurement: {{C: {C}, sampling: {{period: 0.1}}}}
observer: {{family: reachability}}
"""
ZERO = "[[0, 0], [0, 0]]"


@pytest.mark.parametrize(
    ("A", "C", "slopes", "told"),
    [
        ("[[0, 1], [0, 0]]", "[[1, 0]]", ZERO, None),
        ("[[0, 1], [0, 0]]", "[[0, 1]]", ZERO, "no output ever sees x: its error is"),
        ("[[0, 0], [1, 0]]", "[[1, 0]]", ZERO, "no output ever sees y"),
        ("[[0, 0], [1, 0]]", "[[1, 0]]", "[[0, 1], [0, 0]]", "where entries are 0, which the bounds of the slopes"),
        ("[[0, 0], [1, 0]]", "[[1, 0]]", "[[0, [0.5, 1]], [0, 0]]", None),
        ("[[0, 2], [1, 0]]", "[[1, 0]]", "[[0, 1], [0, 0]]", None),
        ("[[0, 0], [0, 0]]", "[[1, 1]]", ZERO, "the outputs see 1 of 2 independent combinations"),
        ("[[1, 0], [0, 2]]", "[[1, 1]]", ZERO, None),
        ("[[1, 0], [0, 1]]", '[["sqrt(2)", 1]]', ZERO, None),
    ],
)
def test_what_the_outputs_do_not_see(A: str, C: str, slopes: str, told: str | None, tmp_path: Path) -> None:
    path = tmp_path / "spec.yaml"
    phi = '["y", "0"]' if slopes != ZERO else '["0", "0"]'
    path.write_text(TEXT.format(A=A, C=C, slopes=slopes, phi=phi))
    result = run(Job(path, tmp_path / "results"), (), Settings())
    assert result.status == "ok"
    if told is None:
        assert not result.messages
    else:
        (message,) = result.messages
        assert message.severity == "warning" and message.text.startswith(told) and message.line == 4


def test_the_measured_sum_of_a_plant_in_its_own_coordinates(tmp_path: Path) -> None:
    path = tmp_path / "spec.yaml"
    path.write_text("""
spec_version: 1
plant: {states: [x, y], dynamics: ["-x", "x - y"], output: [x]}
measurement: {sampling: {period: 0.1}}
observer: {family: reachability}
""")
    (message,) = run(Job(path, tmp_path / "results"), (), Settings()).messages
    assert message.severity == "warning" and "sees y" in message.text and message.line == 3
