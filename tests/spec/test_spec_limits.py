"""What `validate` sees of a simulation: a start outside the domain, a signal outside its declared range."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from spec_pendulum import changed

from cdobs_cli.spec.model import Spec, load

Mistakes = Callable[..., list[str]]
START = ("initial_state: [1, 0]", "initial_state: [{}, {}]")
LIE = """\
spec_version: 1
plant:
  states: [X, S]
  parameters: {k: 2}
  dynamics: ["-X*S", "X*S - S"]
  output: [X]
  coordinates: {map: ["X", "X*S"], inverse: ["x1", "x2/x1"]}
  domain: {X: [0.1, 1], S: [0, 1], where: ["X + S <= 1.5"]}
measurement: {sampling: {period: 0.1}}
observer: {family: lpv_zoh}
simulation: {horizon: 1, initial_state: START}
"""


def started(x: object, y: object) -> str:
    return changed((START[0], START[1].format(x, y)))


def test_a_state_outside_the_box_of_the_domain_is_told_at_its_entry(mistakes: Mistakes) -> None:
    (told,) = mistakes(started("-4.5", 0))
    assert told.startswith("22:19: simulation.initial_state[0]: lies outside the domain; ")
    assert told.endswith("got theta = -4.5; allowed: theta in [-4, inf]")


def test_a_state_outside_an_affine_limit_is_told(mistakes: Mistakes) -> None:
    (told,) = mistakes(started(0, "10.5"))
    assert "simulation.initial_state: lies outside the domain" in told
    assert "= -0.5" in told


@pytest.mark.parametrize(("x", "y"), [(-4, 0), ("-4.0", 2), (0, 10), (1e90, 0)])
def test_the_border_belongs_to_the_domain(write: Callable[..., Path], x: object, y: object) -> None:
    assert isinstance(load(write(started(x, y))), Spec)


def test_an_end_that_balls_cannot_tell_is_no_mistake(write: Callable[..., Path]) -> None:
    text = changed(("theta: [-4, null]", 'theta: ["-sqrt(2)", null]'), (START[0], 'initial_state: ["-2/sqrt(2)", 0]'))
    assert isinstance(load(write(text)), Spec)
    wrong = text.replace('["-2/sqrt(2)", 0]', '["-1.4143", 0]')
    assert text != wrong
    with pytest.raises(Exception, match="lies outside the domain"):
        load(write(wrong))


BOX = ("  initial_state: [1, 0]\n", "  initial_box: {{lower: {}, upper: {}}}\n")


@pytest.mark.parametrize(
    ("lower", "upper", "field"),
    [
        ("[-4.5, 0]", "[1, 0.5]", "simulation.initial_box.lower[0]"),
        ("[-4, 0]", "[1, 11]", "simulation.initial_box"),  # theta = -4, omega = 11
    ],
)
def test_both_ends_of_a_box_lie_in_the_domain(mistakes: Mistakes, lower: str, upper: str, field: str) -> None:
    (told,) = mistakes(changed((BOX[0], BOX[1].format(lower, upper))))
    assert f": {field}: lies outside the domain" in told


def test_a_box_in_the_domain_is_taken(write: Callable[..., Path]) -> None:
    assert isinstance(load(write(changed((BOX[0], BOX[1].format("[-4, 0]", "[1, 2]"))))), Spec)


def test_original_coordinates_count(mistakes: Mistakes, write: Callable[..., Path]) -> None:
    assert isinstance(load(write(LIE.replace("START", "[0.5, 0.5]"))), Spec)
    (told,) = mistakes(LIE.replace("START", "[0.05, 0.5]"))
    assert "simulation.initial_state[0]: lies outside the domain; got X = 0.05; allowed: X in [0.1, 1]" in told
    (told,) = mistakes(LIE.replace("START", "[0.9, 0.9]"))
    assert "got " in told and "-0.3" in told


SIGNAL = ('u: "0.3 + 0.1*sin(t)"', 'u: "{}"')


@pytest.mark.parametrize(
    ("typed", "got"),
    [
        ("1.0001", "got 1.0001;"),
        ("-sqrt(2)", "got -sqrt(2);"),
        ("2 + sin(t)", "got 2 to 2.94898 for t in [0, 1.25]"),
        ("t", "got 1.25 to 2.5 for t in [1.25, 2.5]"),
        ("1.5 + 1.5*tanh(1e3*(t - 12.4))", "for t in [12.5, 13.75]"),
    ],
)
def test_a_signal_that_is_certainly_outside_its_range_is_told(mistakes: Mistakes, typed: str, got: str) -> None:
    (told,) = mistakes(changed((SIGNAL[0], SIGNAL[1].format(typed))))
    assert "simulation.signals.u: the signal leaves its declared interval; " in told
    assert got in told and told.endswith("allowed: [-1, 1]")


@pytest.mark.parametrize("typed", ["1", "sin(t)", "1.0000001*sin(100*t)", "2*sin(t)*cos(t)", "min(t, 1)", "1/(t - 3)"])
def test_what_may_stay_is_left_to_the_run(write: Callable[..., Path], typed: str) -> None:
    assert isinstance(load(write(changed((SIGNAL[0], SIGNAL[1].format(typed))))), Spec)


def test_disturbances_and_noise_have_their_declared_boxes(mistakes: Mistakes, write: Callable[..., Path]) -> None:
    (told,) = mistakes(changed(("d: [0,", "d: [1e-9,")))
    assert "simulation.signals.d[0]: the signal leaves its declared interval; got 1e-9; allowed: [0, 0]" in told
    (told,) = mistakes(changed(('v: ["uniform(-0.01, 0.01)"]', 'v: ["1 + uniform(-0.01, 0.01)"]')))
    assert (
        "simulation.signals.v[0]: the signal leaves its declared interval; got 0.99 to 1.01 for t in [0, 1.25]" in told
    )
    assert isinstance(load(write(changed(("uniform(-0.01, 0.01)", "0.02 + normal(0.1)")))), Spec)


def test_a_signal_made_to_be_costly_is_read_in_bounded_work(write: Callable[..., Path]) -> None:
    deep = "2 + " + "*".join(["(t + 1)**64"] * 25)
    with pytest.raises(Exception, match="the signal leaves its declared interval"):
        load(write(changed((SIGNAL[0], SIGNAL[1].format(deep)))))
