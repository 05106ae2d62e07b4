"""An input's signal over the estimate and the last measurement: what it may read, and what it may not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from spec_pendulum import changed

from cdobs_cli.spec.model import Spec, load

Loaded = Callable[..., Spec]
SIGNAL = 'u: "0.3 + 0.1*sin(t)"'


def signal(text: str) -> tuple[str, str]:
    return SIGNAL, f'u: "{text}"'


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("-0.1*theta - 0.2*omega", {"hat.theta", "hat.omega"}),
        ("-0.1*y", {"y.0"}),
        ("y1/8 + 0*t", {"y.0"}),
        ("tanh(theta - y)*sin(t)/k", {"hat.theta", "y.0", "t"}),
        ("0", set()),
    ],
)
def test_states_stand_for_their_estimates_and_y_for_the_measurement(
    loaded: Loaded, typed: str, meant: set[str]
) -> None:
    spec = loaded(signal(typed))
    assert spec.simulation is not None
    assert spec.simulation.signals["u"].variables == spec.signals["u"].variables == meant


def test_names_of_the_plant_come_before_the_measurement(loaded: Loaded) -> None:
    spec = loaded(signal("0.1*y"), ('k: "2*g"', 'k: "2*g", y: 3'))
    assert spec.signals["u"].variables == set()
    spec = loaded(signal("0.1*y + y1"), ("states: [theta, omega]", "states: [theta, y]"), ("omega <= k", "y <= k"))
    assert spec.signals["u"].variables == {"hat.y", "y.0"}


@pytest.mark.parametrize(
    ("typed", "told"),
    [
        ("-2*thetta", "unknown name 'thetta', did you mean 'theta'?"),
        ("-2*u", "u is an input, which has no estimate"),
        ("theta + u/2", "u is an input, which has no estimate"),
        ("y2", "unknown name 'y2'"),
        ("hat", "unknown name 'hat'"),
        ("hat.theta", "only + - * / **, numbers, names and functions are allowed"),
        ("uniform(-theta, theta)", "uniform"),
        ("d", "unknown name 'd'"),
        ("elapsed", "unknown name 'elapsed'"),
        ("t_k", "unknown name 't_k'"),
        ("__import__", "unknown name"),
        ("theta(1)", "unknown function 'theta'"),
    ],
)
def test_what_a_signal_may_not_read_is_told_at_its_line(
    mistakes: Callable[..., list[str]], typed: str, told: str
) -> None:
    (text,) = mistakes(changed(signal(typed)))
    assert text.startswith("26:16: simulation.signals.u: ") and told in text


def test_only_inputs_feed_back(mistakes: Callable[..., list[str]]) -> None:
    told = mistakes(changed(('d: [0, "1e-3*cos(t)"]', "d: [0, theta]"), ('"uniform(-0.01, 0.01)"', "y")))
    assert [text.split(": ")[1] for text in told] == ["simulation.signals.d[1]", "simulation.signals.v[0]"]
    (told_,) = mistakes(changed(('sampling_times: "0.6 + 0.1*sin(t_k)"', 'sampling_times: "0.6 + theta"')))
    assert "unknown name 'theta'" in told_


def test_of_several_outputs_each_has_a_number(write: Callable[..., Path], mistakes: Callable[..., list[str]]) -> None:
    two = (("C: [[1, 0]]", "C: [[1, 0], [0, 1]]"), ("lower: [-0.01], upper: [0.01]", "lower: [0, 0], upper: [0, 0]"),
           ('v: ["uniform(-0.01, 0.01)"]', "v: [0, 0]"), ('[["1"], [1.8361]]', "[[1, 0], [0, 1]]"))  # fmt: skip
    spec = load(write(changed(*two, signal("y1 - y2"))))
    assert spec.signals["u"].variables == {"y.0", "y.1"}
    (text,) = mistakes(changed(*two, signal("y")))
    assert "unknown name 'y', did you mean 'y2'?" in text


def test_a_wrong_name_of_a_state_is_told_once(mistakes: Callable[..., list[str]]) -> None:
    told = mistakes(changed(("states: [theta, omega]", "states: [theta, 3]"), signal("theta + omega + y")))
    assert all("simulation.signals" not in text for text in told)


def test_a_long_feedback_is_bounded(mistakes: Callable[..., list[str]]) -> None:
    (text,) = mistakes(changed(signal("+".join(["theta"] * 500))))
    assert "at most 2000 characters" in text
