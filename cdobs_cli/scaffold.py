"""`cdobs init`: the commented spec of a family, written where nothing is lost, and the schema that it names."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.parser import nearest
from cdobs_cli.store import write_atomically

SCHEMA_FILE = "cdobs-spec.schema.json"  # as the first line of the examples names it


def schema_text() -> str:
    """The JSON Schema of a spec."""
    from cdobs_cli.spec.schema import json_schema

    return json.dumps(json_schema(), indent=2)


def example(family: str = "auto") -> str:
    """The family's example; `auto`: the shortest useful spec, which leaves the family open.

    Raises:
        UsageError: there is no such family.
    """
    from cdobs_cli.families import FAMILIES

    if family == "auto":
        return files("cdobs_cli.spec").joinpath("example.yaml").read_text(encoding="utf-8")
    known = [*FAMILIES, "auto"]
    if family not in FAMILIES:
        raise UsageError(f"unknown family {family!r}{nearest(family, known)}; known: {', '.join(known)}")
    return FAMILIES[family].example()


def write_new(path: Path, text: str) -> None:
    """Write a spec that does not exist yet, and beside it the schema; an older schema is written anew.

    Raises:
        UsageError: the spec exists, which is not overwritten, or has the schema's name.
    """
    if path.exists():
        raise UsageError(f"{path} exists already; choose another name")
    if path.name == SCHEMA_FILE:
        raise UsageError(f"{path} is the name of the schema; choose another name")
    write_atomically(path, text.encode())
    write_schema(path.with_name(SCHEMA_FILE))


def write_schema(path: Path) -> None:
    """Write the schema, over an older one."""
    write_atomically(path, f"{schema_text()}\n".encode())
