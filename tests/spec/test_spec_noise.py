"""Noise and disturbance as they are typed: a box, a covariance, deviations, an intensity; and every mistake at its line."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

from fractions import Fraction

import jsonschema
import pytest
import yaml
from spec_pendulum import changed

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Plant
from cdobs_cli.spec.model import load
from cdobs_cli.spec.schema import json_schema

NOISE = "{lower: [-0.01], upper: [0.01]}"
DISTURBANCE = "{lower: [0, -1e-3], upper: [0, .5]}"
TWO = ("C: [[1, 0]]", "C: [[1, 0], [0, 1]]")
QUIET = ('u: "0.3 + 0.1*sin(t)", d: [0, "1e-3*cos(t)"], v: ["uniform(-0.01, 0.01)"]', 'u: "0"')
KINDS = "allowed: {lower: [..], upper: [..]}, {covariance: [[..]]} or {std: [..]}"
VALIDATOR = jsonschema.Draft7Validator(json_schema())


def typed(noise: str = NOISE, disturbance: str = DISTURBANCE, *more: tuple[str, str]) -> str:
    return changed(QUIET, TWO, ("gain: {K: [[\"1\"], [1.8361]]}", "objective: given_period"), (NOISE, noise), (DISTURBANCE, disturbance), *more)  # fmt: skip


@pytest.mark.parametrize(
    ("noise", "covariance"),
    [
        ("{covariance: [[1e-4, 0], [0, '1/3']]}", [["1e-4", "0"], ["0", "1/3"]]),
        ("{covariance: [[4, 2], [2, 1]]}", [["4", "2"], ["2", "1"]]),
        ("{covariance: [[0, 0], [0, 0]]}", [["0", "0"], ["0", "0"]]),
        ("{covariance: [[1e12, 0.5], [0.5, 1e-12]]}", [["1e12", "0.5"], ["0.5", "1e-12"]]),
        ("{std: [0.1, '1/3']}", [["0.01", "0"], ["0", "1/9"]]),
        ("{std: [1e6, 1e-6]}", [["1e12", "0"], ["0", "1e-12"]]),
        ("{std: [0, g]}", [["0", "0"], ["0", "1"]]),
    ],
)
def test_second_moments_are_exact(write, noise, covariance):
    text = typed(noise)
    plant = load(write(text)).plant
    assert (plant.noise, plant.covariance) == (None, ExactMatrix(covariance))
    assert plant.is_noisy and plant.is_disturbed
    VALIDATOR.validate(yaml.safe_load(text))


def test_deviations_that_are_no_fractions_have_exact_squares(write):
    covariance = load(write(typed('{std: ["sqrt(2)", "pi"]}'))).plant.covariance
    assert covariance is not None and (covariance[0, 0] - Exact(2)).ball().contains(0)
    assert float(covariance[1, 1]) == pytest.approx(9.8696044)


def test_irrational_covariances_are_decided_where_balls_can(write, mistakes):
    assert load(write(typed('{covariance: [["sqrt(2)", 1], [1, 1]]}'))).plant.covariance is not None
    (told,) = mistakes(typed('{covariance: [["sqrt(2)", 1], [1, "1/2"]]}'))
    assert "is not positive semidefinite" in told
    (told,) = mistakes(typed('{covariance: [["sqrt(2)", 1], [1, "1/sqrt(2)"]]}'))
    assert "is not shown to be positive semidefinite" in told and "decimals or fractions" in told


@pytest.mark.parametrize("intensity", ["[[0, 0], [0, '1/4']]", "[[2, 1], [1, 2]]", "[[1, -1], [-1, 1]]"])
def test_an_intensity_is_white(write, intensity):
    text = typed(NOISE.replace("[-0.01]", "[-0.01, 0]").replace("[0.01]", "[0.01, 0]"), f"{{intensity: {intensity}}}")
    spec = load(write(text))
    assert isinstance(spec.plant, Plant)
    assert spec.plant.disturbance is None and spec.plant.intensity == ExactMatrix(yaml.safe_load(intensity))
    assert spec.plant.is_disturbed and spec.plant.covariance is None
    VALIDATOR.validate(yaml.safe_load(text))


def test_kinds_and_values_change_what_results_depend_on(write):
    contents = [load(write(typed(noise))).normalised()["measurement"] for noise in ("{std: [1, 2]}", "{std: [1, 3]}")]
    assert contents[0]["covariance"] == [["1", "0"], ["0", "4"]] and contents[0] != contents[1]
    same = load(write(typed("{covariance: [[1, 0], [0, 4]]}"))).normalised()["measurement"]
    assert same == contents[0]


@pytest.mark.parametrize(
    ("noise", "told"),
    [
        ("{lower: [0, 0], upper: [1, 1], std: [1, 1]}", f"16:10: measurement.noise: one kind of noise is expected, these are 2; got {{lower: [..], upper: [..]}} and {{std: [..]}}; {KINDS}"),
        ("{covariance: [[1, 0], [0, 1]], std: [1, 1]}", f"16:10: measurement.noise: one kind of noise is expected, these are 2; got {{covariance: [[..]]}} and {{std: [..]}}; {KINDS}"),
        ("{}", f"16:10: measurement.noise: a kind of noise is expected; {KINDS}"),
        ("{std: null}", f"16:10: measurement.noise: a kind of noise is expected; {KINDS}"),
        ("{upper: [1, 1]}", "16:10: measurement.noise.lower: is required"),
        ("{std: [1]}", "16:16: measurement.noise.std: one number for each output is expected; got 1 numbers; allowed: 2 numbers"),
        ("{std: [1, -1]}", "16:20: measurement.noise.std[1]: a number that is not negative is expected; got -1"),
        ("{std: [1, nan]}", '16:20: measurement.noise.std[1]: unknown name \'nan\'; known: e, g, k, pi; got "nan"; a finite number is expected'),
        ("{std: [1, .nan]}", "16:20: measurement.noise.std[1]: a finite number is expected; got .nan; leave an open end of an interval out with null"),
        ("{covariance: [[1]]}", "16:23: measurement.noise.covariance: a matrix of another shape is expected; got 1 x 1; allowed: 2 x 2, a row and a column for each output"),
        ("{covariance: [[1, 0.5], [0.4, 1]]}", "16:35: measurement.noise.covariance[1][0]: a symmetric matrix is expected: this is not the entry of row 1, column 2; got 0.4; allowed: 0.5"),
        ("{covariance: [[1, 0], [0, -1]]}", "16:36: measurement.noise.covariance[1][1]: a variance is not negative; got -1; allowed: 0 or more"),
        ("{covariance: [[1, 2], [2, 1]]}", "16:23: measurement.noise.covariance: is not positive semidefinite; got [[1, 2], [2, 1]]; each |m_ij| is at most sqrt(m_ii m_jj), and so on: no combination has a negative variance"),
        ("{covariance: [[0, 1], [1, 0]]}", "16:23: measurement.noise.covariance: is not positive semidefinite; got [[0, 1], [1, 0]]; each |m_ij| is at most sqrt(m_ii m_jj), and so on: no combination has a negative variance"),
        ("{covariance: [[1, 1], [1, 0.999999999999999999999999999999]]}", "16:23: measurement.noise.covariance: is not positive semidefinite; got [[1, 1], [1, 0.999999999999999999999999999999]]; each |m_ij| is at most sqrt(m_ii m_jj), and so on: no combination has a negative variance"),
        ("{intensity: [[1, 0], [0, 1]]}", "16:11: measurement.noise.intensity: unknown key; allowed: covariance, lower, std, upper"),
        ("3", "16:10: measurement.noise: a mapping is expected; got 3; write noise: {lower: [-3], upper: [3]}, bounds, or noise: {std: [3]}, deviations"),
    ],
)  # fmt: skip
def test_mistakes_in_noise(mistakes, noise, told):
    assert mistakes(typed(noise)) == [told]
    if (
        "std: [1]" not in noise
        and "[[1]]" not in noise
        and "covariance: [[" not in noise
        and "nan" not in noise
        and "-1" not in noise
        and "null" not in noise
    ):
        assert not VALIDATOR.is_valid(yaml.safe_load(typed(noise)))


@pytest.mark.parametrize(
    ("disturbance", "told"),
    [
        ("{intensity: [[1]]}", "12:28: plant.disturbance.intensity: a matrix of another shape is expected; got 1 x 1; allowed: 2 x 2, a row and a column for each state"),
        ("{intensity: [[1, 0]]}", "12:28: plant.disturbance.intensity: a matrix of another shape is expected; got 1 x 2; allowed: 2 x 2, a row and a column for each state"),
        ("{intensity: [[1, 2], [2, 3]]}", "12:28: plant.disturbance.intensity: is not positive semidefinite; got [[1, 2], [2, 3]]; each |m_ij| is at most sqrt(m_ii m_jj), and so on: no combination has a negative variance"),
        ("{lower: [0, 0], upper: [0, 0], intensity: [[1, 0], [0, 1]]}", "12:16: plant.disturbance: one kind of disturbance is expected, these are 2; got {lower: [..], upper: [..]} and {intensity: [[..]]}; allowed: {lower: [..], upper: [..]} or {intensity: [[..]]}"),
        ("{std: [0, 1]}", "12:17: plant.disturbance.std: unknown key; allowed: intensity, lower, upper; of a white one, per unit of time: write {intensity: [[..]]}, the squares"),
    ],
)  # fmt: skip
def test_mistakes_in_a_disturbance(mistakes, disturbance, told):
    assert mistakes(typed("{std: [1, 1]}", disturbance)) == [told]


def test_a_white_disturbance_does_not_go_with_coordinates(write, mistakes):
    text = """\
spec_version: 1
plant:
  states: [a, b]
  dynamics: ["b + a", "-sin(a)"]
  output: ["a"]
  domain: {a: [-1, 1], b: [-2, 2]}
  coordinates: lie
  disturbance: {intensity: [[1, 0], [0, 1]]}
measurement: {sampling: {period: 0.1}, noise: {std: [0.1]}}
observer: {family: reachability}
"""
    (told,) = mistakes(text)
    assert told == (
        "8:28: plant.disturbance.intensity: a white disturbance does not go with `coordinates`: in them its intensity would "
        "depend on the state; leave `coordinates` out, or bound it: {lower: [..], upper: [..]}"
    )
    assert load(write(text.replace("  coordinates: lie\n", ""))).plant.intensity is not None
    without = load(write(text.replace("  disturbance: {intensity: [[1, 0], [0, 1]]}\n", ""))).plant
    assert without.covariance == ExactMatrix([[Fraction(1, 100)]]) and without.states == ("x1", "x2")


INTERVAL = """\
spec_version: 1
plant:
  states: [x, y]
  A: [[-1, 0], [0, -2]]
  phi: ["0", "0"]
  lipschitz: [[0, 0], [0, 0]]
  disturbance: {intensity: [[1, 0], [0, 1]]}
measurement: {C: [[1, 0]], sampling: {period: 0.1}, noise: {std: [0.1]}}
observer: {family: interval}
simulation: {horizon: 1, initial_box: {lower: [0, 0], upper: [1, 1]}}
"""


def test_the_interval_family_takes_boxes_only_and_says_why(write, mistakes):
    disturbed, noisy = mistakes(INTERVAL)
    why = "the bounds of this observer enclose the state in the worst case"
    assert disturbed == (
        f"7:16: plant.disturbance: a white disturbance has no bound: {why}; bound it: {{lower: [..], upper: [..]}}"
    )
    assert noisy == (
        f"8:60: measurement.noise: noise of a covariance has no bound: {why}; bound it, by three deviations for instance: "
        "{lower: [-0.3], upper: [0.3]}"
    )
    assert load(write(INTERVAL.replace("family: interval", "family: auto"))).observer.name != "interval"


def test_an_observer_that_chooses_its_samples_takes_boxes_only(mistakes):
    text = INTERVAL.replace("[[-1, 0], [0, -2]]", "[[0, 1], [0, 0]]").replace("{period: 0.1}", "{updated: true}")
    disturbed, noisy = mistakes(text.replace("family: interval", "family: updated_sampling"))
    assert "samples when its estimate says so" in disturbed and "lower: [-0.3]" in noisy


def test_huge_matrices_are_bounded_work(mistakes):
    """32 outputs and entries of thousands of digits: refused before the elimination, not after an hour."""
    size, long = 32, "0." + "7" * 980 + "3"
    rows = ", ".join("[" + ", ".join("200" if i == j else "z" for j in range(size)) + "]" for i in range(size))
    eye = ", ".join("[" + ", ".join("1" if i == j else "0" for j in range(size)) + "]" for i in range(size))
    names, zeros = ", ".join(f"x{i}" for i in range(size)), ", ".join(["'0'"] * size)
    text = f"""\
spec_version: 1
plant:
  states: [{names}]
  parameters: {{z: "{long}"}}
  A: [{eye}]
  phi: [{zeros}]
  lipschitz: auto
measurement: {{C: [{eye}], sampling: {{period: 0.1}}, noise: {{covariance: [{rows}]}}}}
observer: {{family: reachability}}
"""
    (told,) = mistakes(text)
    assert "grow beyond what is worked with" in told
