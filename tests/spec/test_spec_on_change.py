"""Sensors that send on change as they are typed, and every mistake at its line."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import jsonschema
import pytest
import yaml

from cdobs_cli.spec.model import load
from cdobs_cli.spec.schema import json_schema

TEXT = """\
spec_version: 1
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
measurement:
  sensors: {a: {C: [[1, 0]], send_on_delta: 0.1}, b: {C: [[0, 1]], send_on_delta: "1/3"}}
observer: {family: reachability}
simulation: {horizon: 5, initial_state: [1, 0], initial_estimate: [0, 0]}
"""
SENSORS = '{a: {C: [[1, 0]], send_on_delta: 0.1}, b: {C: [[0, 1]], send_on_delta: "1/3"}}'
FAMILY = "{family: reachability}"


def typed(sensors: str = SENSORS, family: str = FAMILY) -> str:
    return TEXT.replace(SENSORS, sensors).replace(FAMILY, family)


def test_thresholds_are_exact(write):
    plant = load(write(TEXT)).plant
    law = plant.sampling
    assert law.is_on_change and [(one.name, str(one.delta)) for one in law.thresholds] == [("a", "0.1"), ("b", "1/3")]
    assert plant.gain_shape == (2, 2) and not law.is_checked
    jsonschema.Draft7Validator(json_schema()).validate(yaml.safe_load(TEXT))


def test_times_of_comparisons_may_be_written_differently(write):
    every = "{a: {C: [[1, 0]], send_on_delta: 0.1, check_every: 0.2}, b: {C: [[0, 1]], send_on_delta: 1, check_every: '1/5'}}"
    law = load(write(typed(every))).plant.sampling
    assert law.is_checked and str(law.T_max) == "0.2"


def test_noise_stands_beside_each_sensor(write):
    noisy = "{a: {C: [[1, 0]], send_on_delta: 0.1, noise: {lower: [-0.01], upper: [0.02]}}, b: {C: [[0, 1]], send_on_delta: 1}}"
    assert [str(end) for end in load(write(typed(noisy))).plant.noise.upper] == ["0.02", "0"]


@pytest.mark.parametrize(
    "K", ["[[1, 0.5], [0.7, 1]]", "{a: [[1], [0.7]], b: [[0.5], [1]]}", "{b: [[0.5], [1]], a: [[1], [0.7]]}"]
)
def test_gains_are_typed_by_sensors_or_as_one(write, K):
    card = load(write(typed(family=f"{{family: reachability, gain: {{K: {K}}}}}"))).observer
    assert card.given()["K"].texts() == [["1", "0.5"], ["0.7", "1"]]


A = "C: [[1, 0]], send_on_delta: 0.1"


@pytest.mark.parametrize(
    ("sensors", "told"),
    [
        (f"{{a: {{{A}, period: 0.1}}}}", "sensors.a.period: does not go with send_on_delta; check_every says"),
        (f"{{a: {{{A}, offset: 0.1}}}}", "sensors.a.offset: does not go with send_on_delta"),
        (f"{{a: {{{A}}}, b: {{C: [[0, 1]], period: 1}}}}", "sensors.b.period: all sensors send on change, or none"),
        (f"{{a: {{{A}}}, b: {{C: [[0, 1]]}}}}", "sensors.b.period: is required; or send_on_delta"),
        ("{a: {C: [[1, 0], [0, 1]], send_on_delta: 1}}", "sensors.a.send_on_delta: one output sends for itself; got 2 outputs"),
        ("{a: {C: [[1, 0]], send_on_delta: 0}}", "sensors.a.send_on_delta: a positive number is expected"),
        ("{a: {C: [[1, 0]], send_on_delta: -1}}", "sensors.a.send_on_delta: a positive number is expected"),
        ("{a: {C: [[1, 0]], send_on_delta: [1]}}", "sensors.a.send_on_delta: "),
        (f"{{a: {{{A}, check_every: 0}}}}", "sensors.a.check_every: a positive number is expected"),
        ("{a: {C: [[1, 0]], period: 1, check_every: 1}}", "sensors.a.check_every: goes with send_on_delta"),
        (f"{{a: {{{A}, check_every: 1}}, b: {{C: [[0, 1]], send_on_delta: 1}}}}", "sensors.b: sensors that send on change compare at the same times; got all the time; allowed: 1"),
        (f"{{a: {{{A}, check_every: 1}}, b: {{C: [[0, 1]], send_on_delta: 1, check_every: 2}}}}", "sensors.b.check_every: sensors that send on change compare at the same times; got 2; allowed: 1"),
        (f"{{a: {{{A}, noise: {{std: [1]}}}}}}", "measurement.sensors: noise of a covariance has no bound: messages"),
        (f"{{a: {{{A}, check_every: 1e-9}}}}", "simulation.horizon: too many samples"),
    ],
)  # fmt: skip
def test_mistakes_of_sensors(mistakes, sensors, told):
    assert any(told in one for one in mistakes(typed(sensors))), mistakes(typed(sensors))


@pytest.mark.parametrize(
    ("family", "told"),
    [
        ("{family: lpv_zoh}", "measurement.sensors: family reachability takes sensors that send on change; got lpv_zoh; write family: reachability"),
        ("{family: updated_sampling}", "measurement.sensors: family reachability takes sensors that send on change"),
        ("{family: interval}", "measurement.sensors: family reachability takes sensors that send on change"),
        ("{family: reachability, objective: max_period}", "observer.objective: sensors that send on change have no period"),
        ("{family: reachability, objective: decay_rate}", "observer.objective: the rate has no end"),
        ("{family: reachability, method: set}", "observer.method: the set of matrices is built for one period"),
        ("{family: reachability, gain: {K: {a: [[1], [1]]}}}", "observer.gain.K: no gain for a sensor that sends; got a; allowed: b"),
        ("{family: reachability, gain: {K: {a+b: [[1, 0], [0, 1]]}}}", "observer.gain.K.a+b: each sensor sends for itself"),
        ("{family: reachability, gain: {K: {a: [[1]], b: [[1], [1]]}}}", "observer.gain.K.a: one row per state and one column, of a; got 1 x 1; allowed: 2 x 1"),
        ("{family: reachability, gain: {K: [[1], [1]]}}", "K has one row per state and one column per output; got 2 x 1; allowed: 2 x 2"),
        ("{family: reachability, gain: {K: [[[1], [1]], [[1], [1]]]}}", "gains of their own belong to sensors with periods of their own"),
    ],
)  # fmt: skip
def test_mistakes_of_families(mistakes, family, told):
    assert any(told in one for one in mistakes(typed(family=family))), mistakes(typed(family=family))


def test_gains_of_phases_do_not_go_with_thresholds(mistakes):
    text = TEXT.replace("measurement:\n", "measurement:\n  gains: one\n")
    assert any("measurement.gains: goes with sensors that have periods" in one for one in mistakes(text))


def test_outputs_that_are_not_linear(mistakes):
    text = """\
spec_version: 1
plant:
  states: [theta, omega]
  dynamics: [omega, "-sin(theta)"]
  domain: {theta: [-1, 1]}
measurement:
  sensors: {a: {output: ["sin(theta)"], send_on_delta: 0.1}}
observer: {family: reachability}
"""
    assert any(
        "sensors.a: a sensor that sends on change measures an output that is linear" in one for one in mistakes(text)
    )
