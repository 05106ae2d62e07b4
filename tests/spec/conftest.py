"""A good spec, and what loading a variation of it says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cdobs_cli.errors import SpecError
from cdobs_cli.spec.model import Spec, load

PENDULUM = """\
spec_version: 1
title: Pendulum
plant:
  states: [theta, omega]
  inputs: {u: {range: [-1, 1]}}
  parameters: {g: 1, k: "2*g"}
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)/g"]
  B: [[0], ["1/8"]]
  lipschitz: [[0, 0], [1, 0]]
  domain: {theta: [-4, null], where: ["omega <= k*theta + 10"]}
  disturbance: {lower: [0, -1e-3], upper: [0, .5]}
measurement:
  C: [[1, 0]]
  sampling: {period: 0.6}
  noise: {lower: [-0.01], upper: [0.01]}
observer:
  family: reachability
  gain: {K: [["1"], [1.8361]]}
simulation:
  horizon: 20
  initial_state: [1, 0]
  initial_estimate: [0, 0]
  runs: 3
  seed: 7
  signals: {u: "0.3 + 0.1*sin(t)", d: [0, "1e-3*cos(t)"], v: ["uniform(-0.01, 0.01)"]}
  sampling_times: "0.6 + 0.1*sin(t_k)"
expect:
  - {quantity: bounds.period_max.proved, at_least: 0.6, source: "Dinh2014, Section IV"}
"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a spec's text (or bytes) and give its path."""

    def make(text: str | bytes, name: str = "spec.yaml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


@pytest.fixture
def loaded(write: Callable[..., Path]) -> Callable[..., Spec]:
    """Load the pendulum with parts of its text replaced."""

    def make(*changes: tuple[str, str]) -> Spec:
        return load(write(changed(*changes)))

    return make


@pytest.fixture
def mistakes(write: Callable[..., Path]) -> Callable[..., list[str]]:
    """`line:column: field: text` of every mistake in a text."""

    def make(text: str | bytes) -> list[str]:
        path = write(text)
        with pytest.raises(SpecError) as caught:
            load(path)
        for problem in caught.value.problems:
            assert problem.file is not None
        return [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]

    return make


def changed(*changes: tuple[str, str]) -> str:
    """The pendulum's text with parts replaced; each part must be there once."""
    text = PENDULUM
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text
