"""The targets of an export, and the files of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from cdobs_cli.certificate import Check
from cdobs_cli.codegen import DOUBLE
from cdobs_cli.design import Design
from cdobs_cli.export.about import About
from cdobs_cli.export.c99_test import c99_files
from cdobs_cli.export.control import control_text
from cdobs_cli.export.data import json_text, mat_bytes
from cdobs_cli.export.fmu import fmu_bytes
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.proof import proof_files
from cdobs_cli.export.python import python_text
from cdobs_cli.export.vectors import Vectors
from cdobs_cli.families.base import Family
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

Target = Literal["c99", "python", "mat", "json", "control", "fmu", "proof"]


@dataclass(frozen=True)
class Exported:
    """Everything there is to write down."""

    portable: Portable
    about: About
    vectors: Vectors | None
    plant: Plant
    design: Design
    check: Check
    card: Family


def files(target: Target, one: Exported, real: str = DOUBLE) -> dict[str, bytes]:
    """The files of a target, by their names below the folder of exports; equal for equal artefacts.

    Raises: UsageError for an observer that the target cannot express.
    """
    portable, name = one.portable, one.portable.name
    writers: Mapping[Target, Callable[[], dict[str, bytes | str]]] = {
        "c99": lambda: {f"c99/{file}": text for file, text in
                        c99_files(portable, one.about, one.vectors, real).items()},
        "python": lambda: {f"{name}.py": python_text(portable, one.about, one.vectors)},
        "json": lambda: {f"{name}.json": json_text(
            portable, one.about, one.vectors, one.plant, one.design, one.check)},
        "mat": lambda: {f"{name}.mat": mat_bytes(portable, one.about, one.plant, one.design)},
        "control": lambda: {f"{name}_control.py": control_text(
            portable, one.about, one.vectors, one.design.sampling)},
        "fmu": lambda: {f"{name}.fmu": fmu_bytes(portable, one.about, one.vectors, one.design.sampling)},
        "proof": lambda: {**proof_files(one.about, one.card, one.plant, one.design)},
    }  # fmt: skip
    written = writers[target]()
    return {file: content.encode() if isinstance(content, str) else content for file, content in written.items()}
