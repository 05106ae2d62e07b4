"""`delay` and `delays` as they are typed, and every mistake at its line."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import jsonschema
import pytest
import yaml
from command import made
from spec_pendulum import changed

from cdobs_cli.delays import Delay, arrival_words
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.model import load
from cdobs_cli.spec.schema import json_schema

PERIOD = "sampling: {period: 0.6}"
LAW = ('  sampling_times: "0.6 + 0.1*sin(t_k)"\n', "")
TWO = """\
measurement:
  sensors:
    gyro: {C: [[0, 1]], period: 0.3}
    camera: {C: [[1, 0]], period: 0.6, delay: DELAY}
"""
VALIDATOR = jsonschema.Draft7Validator(json_schema())


def typed(delay: str, *more: tuple[str, str]) -> str:
    return changed(LAW, (PERIOD, f"{PERIOD}\n  {delay}"), *more)


def sensors(delay: str) -> str:
    text = changed(LAW, ("  gain: {K: [[\"1\"], [1.8361]]}\n", ""), (', v: ["uniform(-0.01, 0.01)"]', ""))  # fmt: skip
    before, _, rest = text.partition("measurement:\n")
    return before + TWO.replace("DELAY", delay) + "observer:" + rest.partition("observer:")[2]


@pytest.mark.parametrize(
    ("delay", "low", "high"),
    [
        ("delay: 0.05", "0.05", "0.05"),
        ("delay: [0, 0.05]", "0", "0.05"),
        ('delay: ["k/100", "1/3"]', "0.02", "1/3"),
        ("delay: [0, 1]\n  delays: recompute", "0", "1"),
    ],
)
def test_delays_of_one_sensor(write, delay, low, high):
    text = typed(delay)
    plant = load(write(text)).plant
    assert plant.delays == (Delay("", (0,), Exact(low), Exact(high)),)
    assert plant.sampling == SamplingLaw.periodic(Exact("0.6"))
    VALIDATOR.validate(yaml.safe_load(text))


def test_delays_of_sensors(write):
    text = sensors("[0, 0.1]")
    plant = load(write(text)).plant
    assert [(one.name, one.outputs, str(one.lower), str(one.upper)) for one in plant.delays] == [
        ("gyro", (0,), "0", "0"), ("camera", (1,), "0", "0.1"),
    ]  # fmt: skip
    assert plant.sampling == load(write(sensors("0"))).plant.sampling
    VALIDATOR.validate(yaml.safe_load(text))


def test_what_is_not_late_changes_no_key(write):
    texts = (changed(LAW), typed("delay: 0"), typed("delay: 1"))
    plain, at_once, late = (load(write(text)).normalised() for text in texts)
    assert plain == at_once and "delays" not in plain["measurement"] and "latest" not in plain["simulation"]
    assert late != plain and late["measurement"].pop("delays") and late == plain


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        (typed("delay: -1"), 16, "measurement.delay: a delay that is not negative is expected; got -1"),
        (typed("delay: [0.2, 0.1]"), 16, "the least delay is above the largest; got [0.2, 0.1]; write [0.1, 0.2]"),
        (typed("delay: [0.2]"), 16, "a delay is a number, or the least and the largest: [lo, hi]"),
        (typed("delay: {at_most: 1}"), 16, "a delay is a number, or the least and the largest: [lo, hi]"),
        (typed("delay: .nan"), 16, "measurement.delay"),
        (typed("delays: recompute"), 16, "measurement.delays: goes with `delay`, which is not given"),
        (typed("delay: 1\n  delays: innovation"), 17, "measurement.delays: adding the innovation of the stamp on arrival is not taken yet; got innovation; allowed: recompute; write delays: recompute"),
        (typed("delay: 1\n  delays: naive"), 17, "allowed: recompute or innovation"),
        (typed("delay: 1").replace("period: 0.6", "updated: true"), 16, "does not go with instants that the observer chooses"),
        (typed("delay: [0, 1]").replace("period: 0.6", "max_period: 0.6"), 16, "with min_period 0 any number of samples may overtake one that is late; got [0, 1]; give a min_period above 0, or hold every sample until the largest delay and write delay: 1"),
        (sensors("[0, 0.1]").replace("  sensors:", "  delay: 1\n  sensors:"), 14, "measurement.delay: does not go with `sensors`; give it to each sensor: delay"),
        (sensors("-0.1"), 16, "measurement.sensors.camera.delay: a delay that is not negative is expected"),
        (typed("delay: 1").replace('u: "0.3 + 0.1*sin(t)"', 'u: "-theta"'), 27, "simulation.signals.u: an input that reads the estimate does not go with measurements that arrive late"),
        (typed("delay: 1", ("family: reachability\n  gain: {K: [[\"1\"], [1.8361]]}", "family: interval")), 16, "measurement.delay: family reachability takes measurements that arrive late; got interval; write family: reachability"),
        (typed("delay: 1", ("gain: {K: [[\"1\"], [1.8361]]}", "error_at_most: {theta: 1}")), 20, "the error that is kept in a search is that of an estimate without delays; say it in `expect`"),
        (changed(LAW, ("  seed: 7\n", "  seed: 7\n  delays: latest\n")), 26, "simulation.delays: needs measurements that arrive late: measurement.delay, which is not given"),
    ],
)  # fmt: skip
def test_mistakes_are_told_at_their_line(write, text, line, told):
    with pytest.raises(SpecError) as caught:
        load(write(text))
    places = [(one.line, str(one)) for one in caught.value.problems]
    assert any(at == line and told in sentence for at, sentence in places), places


def test_the_held_innovation_takes_one_delay(write):
    text = sensors("0.1").replace("period: 0.3", "period: 0.6").replace("family: reachability", "family: lpv_zoh")
    with pytest.raises(SpecError, match="family reachability takes sensors with delays of their own"):
        load(write(text))


def test_words():
    late = (Delay("gyro", (0,), Exact("0"), Exact("0")), Delay("camera", (1,), Exact("0"), Exact("0.1")))
    assert arrival_words(late, "s") == "samples of gyro arrive at once, of camera 0 to 0.1 s later"
    assert arrival_words([Delay("", (0,), Exact("2"), Exact("2"))]) == "samples arrive 2 later"
    assert arrival_words(()) == ""


HELD = """\
spec_version: 1
plant:
  states: [p, v]
  A: [[0,1],[0,-0.1]]
  phi: ["0","0"]
  lipschitz: [[0,0],[0,0]]
measurement: {C: [[1,0]], sampling: {period: 0.1}, delay: 0.05}
observer: {family: lpv_zoh}
"""


@pytest.mark.parametrize("family", ["lpv_zoh", "reachability"])
def test_a_late_position_is_proved(tmp_path, family):
    check = made(tmp_path, HELD.replace("lpv_zoh", family), ("synthesize", "check")).check
    late = next(one for one in check["claims"] if one["id"] == "late")
    assert check["verdict"] == "proved" and late["status"] == "proved"
    assert "samples arrive 0.05 later" in late["statement"] and check["bounds"]["delay_max"]["proved"] == "inf"
