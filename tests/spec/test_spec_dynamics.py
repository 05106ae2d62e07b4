"""Plants typed as dynamics and output, in coordinates of the user's own."""

# ruff: noqa: E501 - sentences stand on one line

from __future__ import annotations

import pytest

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.spec.model import load

pytest.importorskip("cdobs_cli.coordinates")

HEAD = """\
spec_version: 1
plant:
  states: [a, b]
  inputs: {u: {range: [0, 1]}}
  dynamics: ["b + a", "-sin(a) + u"]
  output: ["a"]
  domain: {a: [-1, 1], b: [-2, 2]}
"""
TAIL = """\
measurement: {sampling: {period: 0.1}}
observer: {family: reachability}
simulation: {horizon: 5, initial_state: [1, 0.5], initial_estimate: [0, 0], signals: {u: "0"}}
"""


def test_without_coordinates_the_states_stay(write):
    spec = load(write(HEAD + TAIL))
    assert spec.plant.states == ("a", "b")
    assert spec.coordinates is None
    assert spec.typed is not None and spec.typed.coordinates is None
    assert spec.plant.C.texts() == [["1", "0"]]


def test_lie_coordinates_take_the_simulation_along(write):
    spec = load(write(HEAD + "  coordinates: lie\n" + TAIL))
    assert spec.plant.states == ("x1", "x2")
    assert spec.plant.is_canonical
    assert spec.coordinates is not None and [str(one) for one in spec.coordinates.map] == ["a", "a + b"]
    assert spec.simulation is not None
    assert spec.simulation.initial_state == (Exact(1), Exact("3/2"))
    assert spec.normalised()["plant"]["states"] == ["a", "b"]


@pytest.mark.parametrize(
    ("extra", "told"),
    [
        (
            "  coordinates: {map: [a, x1], inverse: [x1, b]}\n",
            [
                "8:26: plant.coordinates.map[1]: unknown name 'x1'; known: a, b, e, pi; got \"x1\"; in this expression the states are a, b",
                "8:45: plant.coordinates.inverse[1]: unknown name 'b'; known: e, pi, x1, x2; got \"b\"; in this expression the states are x1, x2",
            ],
        ),
        (
            "  coordinates: {map: [a]}\n",
            [
                "8:16: plant.coordinates.inverse: is required",
                "8:22: plant.coordinates.map: one expression for each state is expected; got 1 entries; "
                "allowed: 2 entries",
            ],
        ),
        (
            "  coordinates: li\n",
            ["8:16: plant.coordinates: one of a few values is expected; got \"li\"; allowed: lie; did you mean 'lie'?"],
        ),
        (
            "  coordinates: lie\n  phi: ['0', '-sin(a)']\n",
            [
                "9:14: plant.phi[1]: unknown name 'a'; known: e, pi, u, x1, x2 (at character 6); got \"-sin(a)\"; in this expression the states are x1, x2"
            ],
        ),
    ],
)
def test_mistakes_in_coordinates(mistakes, extra, told):
    assert mistakes(HEAD + extra + TAIL) == told


def test_what_the_change_of_coordinates_finds_is_told_with_its_place(mistakes):
    (told,) = mistakes(HEAD.replace('output: ["a"]', 'output: ["a", "b"]') + "  coordinates: lie\n" + TAIL)
    assert told.startswith("8:16: plant.coordinates: ")


def test_output_and_coordinates_need_dynamics(mistakes):
    text = HEAD.replace(
        '  dynamics: ["b + a", "-sin(a) + u"]\n', '  A: [[1, 1], [0, 0]]\n  phi: ["0", "u"]\n  lipschitz: auto\n'
    )
    told = mistakes(text + "  coordinates: lie\n" + TAIL)
    assert told[0] == "8:11: plant.output: goes with `dynamics`, which is not given"
    assert told[1] == "10:16: plant.coordinates: goes with `dynamics`, which is not given"
