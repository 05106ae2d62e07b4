"""The JSON Schema (draft-07) of a spec, for editors: made from the models that read it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic.json_schema import models_json_schema

from cdobs_cli.families import FAMILIES
from cdobs_cli.spec.auto_block import AUTO, AutoBlock
from cdobs_cli.spec.expect import ExpectBlock
from cdobs_cli.spec.gain_file import letters_of
from cdobs_cli.spec.measurement_block import MeasurementBlock
from cdobs_cli.spec.plant_block import PlantBlock
from cdobs_cli.spec.report_block import ReportBlock
from cdobs_cli.spec.simulation_block import SimulationBlock

DRAFT = "http://json-schema.org/draft-07/schema#"
_TEMPLATE = "#/definitions/{model}"
_FAMILY = "The kind of observer; auto takes, of the kinds that fit, the one that does best, and says why."


def json_schema() -> dict[str, Any]:
    """The whole schema. Editors that speak draft-07 (YAML language server, VS Code) take it as it is."""
    families: dict[str, type[Any]] = {**FAMILIES, AUTO: AutoBlock}
    own = (PlantBlock, MeasurementBlock, SimulationBlock, ReportBlock, ExpectBlock)
    blocks: list[type[Any]] = [*own, *families.values()]
    names, schema = models_json_schema([(block, "validation") for block in blocks], ref_template=_TEMPLATE)
    definitions = schema["$defs"]
    refs = {block: names[(block, "validation")] for block in blocks}
    for name, definition in definitions.items():
        _require(name, definition)
    plant_file = {
        "type": "object", "required": ["file"], "additionalProperties": False,
        "properties": {"file": {"type": "string", "description": "Its name, in the folder of the spec or below."}},
        "description": "The plant in a file of its own, e.g. pendulum.plant.yaml.",
    }  # fmt: skip
    gain_file = {
        "type": "object", "required": ["file"], "additionalProperties": False,
        "properties": {
            "file": {"type": "string", "description": "A MATLAB file in the folder of the spec or below."},
            "variables": {"type": "object", "additionalProperties": {"type": "string"},
                          "description": "What its variables are called, where that is not K or L."},
        },
        "description": "The gain from another tool, e.g. {file: design.mat}.",
    }  # fmt: skip
    for family, block in families.items():
        definition = definitions[refs[block]["$ref"].rsplit("/", 1)[1]]
        if letters_of(family):
            definition["properties"]["gain"]["anyOf"].append(gain_file)
        definition["properties"]["family"] = {"const": family, "description": _FAMILY}
        definition["required"] = sorted({*definition.get("required", []), "family"})
    return {
        "$schema": DRAFT, "title": "cdobs spec", "type": "object",
        "properties": {
            "spec_version": _said("Of this format.", {"const": 1}),
            "title": _said("Of reports; the file's name where left out.", {"type": "string", "maxLength": 200}),
            "plant": _said("What is observed.", {"anyOf": [refs[PlantBlock], plant_file]}),
            "measurement": _said("What is measured, and when.", {"allOf": [refs[MeasurementBlock]]}),
            "observer": _said(
                "The kind of observer and what is wanted of it; left out: family auto.", _by_family(refs, families)
            ),
            "simulation": _said("What is run; nothing where left out.", _or_null(refs[SimulationBlock])),
            "report": _said("What is drawn.", _or_null(refs[ReportBlock])),
            "expect": _said(
                "What must hold, for the exit code to be 0; that all is proved, where left out.",
                _or_null({"type": "array", "items": refs[ExpectBlock]}),
            ),
        },
        "required": ["spec_version", "plant", "measurement"], "additionalProperties": False,
        "definitions": definitions,
    }  # fmt: skip


def _said(words: str, part: dict[str, Any]) -> dict[str, Any]:
    return {"description": words, **part}


def _or_null(part: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [part, {"type": "null"}]}


def _require(name: str, definition: dict[str, Any]) -> None:
    """The keys that a block asks for itself (`Block.required`)."""
    required = next((block.required for block in _blocks() if block.__name__ == name), ())
    if required:
        definition["required"] = sorted({*definition.get("required", []), *required})
        for field in required:
            # None stands for "not given" in the model; an editor should not offer it.
            entry = definition["properties"][field]
            entry["anyOf"] = [option for option in entry["anyOf"] if option != {"type": "null"}]
            entry.pop("default", None)


def _blocks() -> list[Any]:
    from cdobs_cli.spec.block import Block

    blocks, stack = [], [Block]
    while stack:
        block = stack.pop()
        blocks.append(block)
        stack.extend(block.__subclasses__())
    return blocks


def _by_family(refs: dict[type[Any], Any], families: Mapping[str, type[Any]]) -> dict[str, Any]:
    """The observer's block, told apart by `family`: if/then, so that an editor names the mistake in the
    family that was meant."""
    told = {"type": "object", "required": ["family"]}
    known = {name: told | {"properties": {"family": {"const": name}}} for name in families}
    branches = [{"if": known[name], "then": refs[block]} for name, block in families.items()]
    names = {"family": {"enum": list(families), "description": _FAMILY}}
    return {"type": ["object", "null"], "required": ["family"], "properties": names, "allOf": branches}
