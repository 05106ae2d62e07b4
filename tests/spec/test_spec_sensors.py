"""`measurement.sensors`: what is taken, and what is shown to those who write it otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest
from command import made

CART = """\
spec_version: 1
plant:
  states: [p, v]
  A: [[0, 1], [0, -0.1]]
  phi: ["0", "0"]
  lipschitz: [[0, 0], [0, 0]]
measurement: {C: [[1, 0], [0, 1]], sampling: [{period: 0.1}, {period: 0.5}]}
observer: {family: reachability}
"""
LINE = CART.splitlines()[6]
SENSORS = "sensors: {s1: {C: [[1, 0]], period: 0.1}, s2: {C: [[0, 1]], period: 0.5}}"
LISTED = "sensors: [{C: [[1, 0]], sampling: {period: 0.1}}, {C: [[0, 1]], sampling: {period: 0.5}}]"


def with_measurement(text: str, spec: str = CART) -> str:
    return spec.replace(LINE, f"measurement: {{{text}}}")


def refused(folder: Path, text: str) -> list[str]:
    """What is said of each wrong field, with its line."""
    result = made(folder, text, ("check",))
    assert result.status == "invalid"
    return [f":{one.line}: {one.field}: {one.text}" for one in result.messages]


@pytest.mark.parametrize(("text", "shown"), [
    (CART, f"write, for C and sampling, {SENSORS}"),
    (with_measurement(LISTED), f"write {SENSORS}"),
])  # fmt: skip
def test_lists_are_shown_as_sensors_that_run(tmp_path: Path, text: str, shown: str) -> None:
    (problem,) = refused(tmp_path, text)
    assert shown in problem and ":7:" in problem
    result = made(tmp_path, with_measurement(shown.partition("sampling, ")[2] or shown.removeprefix("write ")))
    assert result.status == "ok" and result.check is not None and result.check["verdict"] == "proved"


@pytest.mark.parametrize("family", ["lpv_zoh", "interval", "updated_sampling"])
def test_a_family_that_reads_all_outputs_at_once_says_what_to_do(tmp_path: Path, family: str) -> None:
    spec = with_measurement(SENSORS, CART.replace("reachability", family))
    (told,) = [one for one in refused(tmp_path, spec) if "measurement.sensors" in one]
    assert "write family: reachability, or read all of them at one period" in told


@pytest.mark.parametrize(("times", "ends"), [
    ("[0.1, 0.3, 0.7]", "{min_period: 0.2, max_period: 0.4}"), ("[]", "{min_period: .., max_period: ..}"),
    ("[0, 1, 1]", "{min_period: .., max_period: ..}"), ("[a, {}]", "{min_period: .., max_period: ..}"),
    ("{a: 1}", "{min_period: .., max_period: ..}"),
    ('["1/8", "3/8", 1e9]', "{min_period: 0.25, max_period: 1000000000}"),
])  # fmt: skip
def test_listed_instants_are_shown_as_an_interval(tmp_path: Path, times: str, ends: str) -> None:
    (problem,) = refused(tmp_path, with_measurement(f"C: [[1, 0]], sampling: {{times: {times}}}"))
    assert f"write sampling: {ends}" in problem and "simulation.sampling_times" in problem and "sensors" in problem


def test_the_interval_that_is_shown_runs(tmp_path: Path) -> None:
    result = made(tmp_path, with_measurement("C: [[1, 0]], sampling: {min_period: 0.2, max_period: 0.4}"), ("check",))
    assert result.check is not None and result.check["verdict"] == "proved"


@pytest.mark.parametrize(("sensors", "told"), [
    ("{}", "1 to 16 sensors are taken"),
    ("{a: {C: [[1, 0]], period: 0.1, offset: 0.1}}", "is not below the sensor's period"),
    ("{a: {C: [[1, 0]], period: 0.1, offset: -1}}", "offset"),
    ("{a: {C: [[1, 0]], period: 0}}", "period"),
    ("{a: {C: [[1, 0]]}}", "measurement.sensors.a.period: is required"),
    ("{a: {period: 1}}", "what the sensor measures is expected"),
    ("{a: {C: [[1, 0]], output: [p], period: 1}}", "what the sensor measures is expected, once"),
    ("{a: {output: [p], period: 1}}", "goes with `dynamics`"),
    ("{a: {C: [[1, 0, 0]], period: 1}}", "column for each state"),
    ("{a: {C: [[1, 0]], period: 1e-6}, b: {C: [[0, 1]], period: 1000000.0000005}}", "only after"),
    ("{a: {C: [[1, 0]], period: 1}, b: {C: [[0, 1]], period: pi}}", "no rational multiple"),
    ("{a: {C: [[1, 0]], period: 1, offset: 0.1}, b: {C: [[0, 1]], period: 1, offset: 0.2}}", "has the offset 0"),
    ("{a: {C: [[1, 0]], period: 1, lag: 2}}", "unknown key"),
    ("{'a b': {C: [[1, 0]], period: 1}}", "a b"), ("{'a+b': {C: [[1, 0]], period: 1}}", "a+b"),
    ("{a.b: {C: [[1, 0]], period: 1}}", "a.b"), ("{1: {C: [[1, 0]], period: 1}}", "1"),
    ("{a: 3}", "measurement.sensors.a"), ("{a: {C: [[1, 0]], period: .nan}}", "finite"),
    ("{a: {C: [[1, 0]], period: 1, noise: {std: [1]}}, b: {C: [[0, 1]], period: 2, noise: {lower: [-1], upper: [1]}}}",
     "noise of all sensors is of one kind"),
    ("{a: {C: [[1, 0]], period: 1, noise: {std: [1, 2]}}}", "noise"),
])  # fmt: skip
def test_what_no_sensor_is(tmp_path: Path, sensors: str, told: str) -> None:
    problems = refused(tmp_path, with_measurement(f"sensors: {sensors}"))
    assert any(told in problem and ":7:" in problem for problem in problems), problems


@pytest.mark.parametrize(("gain", "told"), [
    ("{K: {radar: [[1], [0]]}}", "radar"), ("{K: {s1: [[1], [0]]}}", "s2"),
    ("{K: {s1: [[1, 2], [0, 1]], s2: [[1], [0]]}}", "s1"), ("{K: {s1+s1: [[1], [0]], s2: [[1], [0]]}}", "s1"),
    ("{K: [[[1], [0]]]}", "K"), ("{K: {}}", "K"), ("{L: [[1, 0], [0, 1]]}", "L"),
    ("{K: {s1: x, s2: [[1], [0]]}}", "s1"),
])  # fmt: skip
def test_gains_of_other_sensors_are_refused(tmp_path: Path, gain: str, told: str) -> None:
    spec = with_measurement(SENSORS).replace("reachability}", f"reachability, gain: {gain}}}")
    problems = refused(tmp_path, spec)
    assert any(told in problem and ":8:" in problem for problem in problems), problems


@pytest.mark.parametrize(("low", "high", "fits"), [
    ("pi/10", "pi/10", True), ("pi/5", "2*pi/10", True), ("sqrt(2)/5", "sqrt(2)/4", True), ("pi/4", "2*pi/10", False),
])  # fmt: skip
def test_ends_of_a_period_that_are_no_decimals_are_compared(tmp_path: Path, low: str, high: str, fits: bool) -> None:
    unit = "pi/10" if "pi" in low else "sqrt(2)/10"
    timed = f'min_period: "{low}", max_period: "{high}"'
    spec = with_measurement(f'sensors: {{s1: {{C: [[1, 0]], period: "{unit}"}}, s2: {{C: [[0, 1]], {timed}}}}}')
    result = made(tmp_path, spec, ("synthesize",))
    assert (result.status == "ok") is fits
    assert [one.text[:29] for one in result.messages] == ([] if fits else ["min_period is above max_period"[:29]])
