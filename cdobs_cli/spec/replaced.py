"""A spec with some of its fields replaced: by the same reader and the same checks, and written as a file."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.records import dataclass
from cdobs_cli.spec.model import load_document
from cdobs_cli.spec.reader import DecimalText, Document, FieldPath, Place, read_text, shown

_OWN_LINES = 2  # levels of a written spec whose keys have lines of their own
_OTHER_MEANING = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}  # to this reader or to another
_ASTRAL = re.compile("[\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Setting:
    """A field and what is put there, as YAML text."""

    field: str
    text: str

    @property
    def path(self) -> FieldPath:
        """`plant.A[0][1]` and `plant.A.0.1` are ("plant", "A", 0, 1)."""
        parts = self.field.replace("[", ".").replace("]", "").split(".")
        return tuple(int(part) if part.isdecimal() else part for part in parts)

    def __str__(self) -> str:
        return f"{self.field}={self.text}"


def replaced(document: Document, settings: Sequence[Setting]) -> Document:
    """The document with the fields set; mappings on the way that are not there are made.

    Raises:
        SpecError: a value is not YAML, or its field lies in something that has no such part.
    """
    root, values, keys = copy.deepcopy(document.root), dict(document.values), dict(document.keys)
    new = Document(document.file, root, values, keys, list(document.problems), set(document.refused))
    for setting in settings:
        try:
            _put(new, setting)
        except SpecError as error:
            raise SpecError(tuple(_told(one, [setting], document.file) for one in error.problems)) from None
    return new


def checked(document: Document, settings: Sequence[Setting], path: Path) -> Document:
    """The document with the fields set, once a spec can be made of it.

    Raises:
        SpecError: every mistake; of what was set, with the setting.
    """
    new = replaced(document, settings)
    try:
        load_document(replace(new, root=copy.deepcopy(new.root)), path)
    except SpecError as error:
        raise SpecError(tuple(_told(one, settings, document.file) for one in error.problems)) from None
    return new


def _put(document: Document, setting: Setting) -> None:
    at, file = _typed(document.root, setting.path), _file(setting)
    try:
        value = read_text(setting.text, file)
    except SpecError as error:
        raise SpecError(tuple(replace(one, field=(*at, *one.field)) for one in error.problems)) from None
    if value.root is None and setting.text.strip() not in ("null", "~"):
        raise SpecError.at(at, "a value is expected", got="nothing")
    inside = document.root
    for depth, part in enumerate(at):
        _must_hold(inside, at[: depth + 1])
        if depth + 1 < len(at) and isinstance(inside, dict) and inside.get(part) is None:
            inside[part] = {}
            _place(document, at[: depth + 1], file)
        if depth + 1 < len(at):
            inside = inside[part]
    _place(document, at, file)
    document.graft(at, value)


def _typed(root: Any, path: FieldPath) -> FieldPath:
    """With numbers as names where they are keys of a mapping."""
    typed: list[str | int] = []
    inside = root
    for part in path:
        name = part if isinstance(inside, list) else str(part)
        typed.append(name)
        known = isinstance(inside, dict) or (isinstance(inside, list) and isinstance(name, int) and name < len(inside))
        inside = (inside.get(name) if isinstance(inside, dict) else inside[name]) if known else {}
    return tuple(typed)


def _must_hold(inside: Any, at: FieldPath) -> None:
    """That the last part of a path can stand in what is around it. Raises: SpecError."""
    part = at[-1]
    if isinstance(inside, list):
        if not isinstance(part, int) or part >= len(inside):
            allowed = f"an index from 0 to {len(inside) - 1}" if inside else "nothing: the list is empty"
            raise SpecError.at(at[:-1], "the list has no such entry", str(part), allowed)
    elif not isinstance(inside, dict):
        raise SpecError.at(at[:-1], "has no fields of its own", shown(inside), hint=f"set {_dotted(at[:-1])} itself")


def _dotted(path: FieldPath) -> str:
    return Problem(path, "").path


def _place(document: Document, at: FieldPath, file: str) -> None:
    document.values[at] = document.keys[at] = Place(file, 1, 1)


def _file(setting: Setting) -> str:
    return f"--set {setting}"


def _told(problem: Problem, settings: Sequence[Setting], file: str) -> Problem:
    """A problem of what was set stands in the spec, without a line, and names the setting."""
    known = {_file(one): one for one in settings}
    setting = known.get(problem.file or _file(settings[0]))
    if setting is None:
        return problem
    hint = "; ".join(text for text in (problem.hint, f"set by --set {setting}") if text)
    return replace(problem, hint=hint, file=file, line=None, column=None)


# ---------------------------------------------------------------- written


def written(root: Mapping[str, Any]) -> str:
    """A spec's content as YAML that reads back as the same values; the upper levels on lines of their own."""
    return "".join(_lines(root, 0))


def _lines(mapping: Mapping[str, Any], depth: int) -> list[str]:
    rows = []
    for name, value in mapping.items():
        head = f"{'  ' * depth}{_quoted(name)}:"
        if isinstance(value, dict) and value and depth + 1 < _OWN_LINES:
            rows += [f"{head}\n", *_lines(value, depth + 1)]
        else:
            rows.append(f"{head} {flow_text(value)}\n")
    return rows


def flow_text(value: Any) -> str:
    """A value as YAML on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_quoted(name)}: {flow_text(one)}' for name, one in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(flow_text, value))}]"
    if value is None or isinstance(value, bool):
        return shown(value)
    return _quoted(value) if isinstance(value, str) and not isinstance(value, DecimalText) else str(value)


def _quoted(text: str) -> str:
    """In double quotes, ASCII: names that need none have none."""
    if re.fullmatch("[A-Za-z][A-Za-z0-9_]*", text) and text.lower() not in _OTHER_MEANING:
        return text
    parts = (f"\\U{ord(one):08x}" if _ASTRAL.match(one) else json.dumps(one)[1:-1] for one in text)
    return f'"{"".join(parts)}"'
