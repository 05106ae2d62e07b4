"""`plant: {file: name}`: which file may be meant, and its content. Nothing is quoted of a file that is no plant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.spec.reader import Document, read, shown

SUFFIXES = (".yaml", ".yml")


def read_plant_file(spec: Path, name: str) -> Document:
    """The document of a plant's file beside or below its spec.

    Raises:
        SpecError: the file may not be meant, cannot be read, or holds no plant. A problem without a line is
            about the name.
    """
    path = spec.parent / name
    if (refusal := name_refusal(spec, name, "a plant's file", "a YAML file", SUFFIXES)) is not None:
        raise SpecError((refusal,))
    try:
        document = read(path)
    except SpecError as error:
        raise SpecError(tuple(_unquoted(problem) for problem in error.problems)) from None
    if not isinstance(document.root, dict) or not {"states", "file"} & set(document.root):
        raise SpecError((Problem((), "the file holds no plant", allowed="a mapping with `states`"),))
    return document


def name_refusal(spec: Path, name: str, what: str, kind: str, suffixes: tuple[str, ...]) -> Problem | None:
    """Why a file of that name may not be meant by a spec: it lies outside its folder, or is of another kind."""
    below = f"{what} stands below the folder of its spec"
    typed = Path(name)
    if typed.is_absolute() or typed.drive or ".." in typed.parts:
        return Problem((), below, shown(name), hint="move it there")
    if not name.endswith(suffixes):
        return Problem((), f"{what} is {kind}", shown(name), f"a name that ends with {' or '.join(suffixes)}")
    try:
        if not (spec.parent / typed).resolve().is_relative_to(spec.parent.resolve()):
            return Problem((), below, shown(name), hint="the link leads out of it")
    except (OSError, RuntimeError, ValueError):
        return Problem((), "the file cannot be read", shown(name))
    return None


def _unquoted(problem: Problem) -> Problem:
    """Where reading failed, and what it is, without what stands there."""
    return replace(problem, what=problem.what.split(":")[0], got=None) if problem.line is not None else problem
