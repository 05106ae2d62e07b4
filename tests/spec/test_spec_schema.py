"""The JSON Schema takes what the models take and refuses what an editor can refuse."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import json

import jsonschema
import pytest
import yaml
from spec_pendulum import PENDULUM, changed

from cdobs_cli.families import FAMILIES
from cdobs_cli.scaffold import example
from cdobs_cli.spec.schema import json_schema

SCHEMA = json_schema()
OBSERVER = 'observer:\n  family: reachability\n  gain: {K: [["1"], [1.8361]]}\n'
VALIDATOR = jsonschema.Draft7Validator(SCHEMA)


def test_it_is_a_draft_7_schema_without_loose_ends():
    jsonschema.Draft7Validator.check_schema(SCHEMA)
    text = json.dumps(SCHEMA)
    assert "$defs" not in text
    names = {part.split('"')[0] for part in text.split("#/definitions/")[1:]}
    assert names <= set(SCHEMA["definitions"])
    assert [*FAMILIES, "auto"] == SCHEMA["properties"]["observer"]["properties"]["family"]["enum"]


def described(schema, path=()):
    """(path, description) of every property, at any depth."""
    if isinstance(schema, list):
        schema = dict(enumerate(schema))
    if not isinstance(schema, dict):
        return
    # What stands under `if` tells families apart, and describes nothing.
    for key, part in schema.items():
        if key == "properties":
            yield from (((*path, name), entry.get("description")) for name, entry in part.items())
        if key != "if":
            yield from described(part, (*path, key))


def test_every_key_is_described():
    told = dict(described(SCHEMA))
    assert len(told) > 100
    assert [path for path, words in told.items() if not words or not words.endswith(".")] == []


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (("[[0, 0], [1, 0]]\n  domain", "auto\n  domain"),),
        (("[[0, 0], [1, 0]]\n  domain", "[[0, auto], [[-1, '1/2'], 0]]\n  domain"),),
        (("{period: 0.6}", "{updated: true}"),),
        (("{period: 0.6}", "{max_period: 'pi'}"),),
        (("at_least: 0.6", "equals: proved"),),
        ((OBSERVER, ""),),
        ((OBSERVER, "observer:\n"),),
        ((OBSERVER, "observer: {family: auto, objective: max_period, rate_at_least: '1/8'}\n"),),
        (("states: [theta, omega]", "time_unit: min\n  states: {theta: rad, omega: null}"),),
    ],
)
def test_good_specs_pass(changes):
    VALIDATOR.validate(yaml.safe_load(changed(*changes)))


@pytest.mark.parametrize(
    "change",
    [
        ("title: Pendulum", "titel: x"), ("spec_version: 1\n", ""), ("states: [theta, omega]", "states: theta"), ("C: [[1, 0]]", "D: [[1, 0]]"),
        ("{period: 0.6}", "{perod: 0.6}"), ("{period: 0.6}", "{period: [1]}"), ("family: reachability", "family: reach"),
        ("  family: reachability\n", ""), ("gain: {K:", "gain: {L:"), ("horizon: 20", "horizn: 20"), ("runs: 3", "runs: 0"),
        (OBSERVER, "observer: {family: auto, gain: {K: [[1]]}}\n"), (OBSERVER, "observer: {}\n"), (OBSERVER, "observer: 3\n"),
        ("at_least: 0.6", "atleast: 0.6"), ("bounds.period_max.proved", ""), ("quantity: bounds.period_max.proved, ", ""),
    ],
)  # fmt: skip
def test_what_an_editor_underlines(change):
    assert not VALIDATOR.is_valid(yaml.safe_load(changed(change)))


def test_a_plant_file_and_every_family_example_pass():
    VALIDATOR.validate(
        yaml.safe_load(
            f"spec_version: 1\nplant: {{file: p.plant.yaml}}\nmeasurement:{PENDULUM.split('measurement:')[1]}"
        )
    )
    for family in FAMILIES.values():
        VALIDATOR.validate(yaml.safe_load(family.example()))
    VALIDATOR.validate(yaml.safe_load(example()))
