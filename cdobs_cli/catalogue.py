"""`cdobs theorems`: what is implemented, read from the docstrings that say `Source: ..`."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from cdobs_cli.codec import Noun
from cdobs_cli.records import dataclass

_SOURCE, _DEVIATES = (
    re.compile(rf"^\s*{word}:\s*(.+?)(?=^\s*\n|^\s*[A-Z][a-z]+:|\Z)", re.MULTILINE | re.DOTALL)
    for word in ("Source", "Deviates")
)


@dataclass(frozen=True)
class Entry(Noun):
    """One function that implements a published or derived statement."""

    name: str
    source: str
    summary: str
    deviates: str | None
    place: str


def catalogue() -> list[Entry]:
    """Every function or class of the package whose docstring names a source, by file and line."""
    package = Path(__file__).parent
    entries = []
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            text = (ast.get_docstring(node) if isinstance(node, ast.FunctionDef | ast.ClassDef) else None) or ""
            if (source := _SOURCE.search(text)) and isinstance(node, ast.FunctionDef | ast.ClassDef):
                place, deviates = f"{path.relative_to(package.parent)}:{node.lineno}", _DEVIATES.search(text)
                told = _line(deviates[1]) if deviates else None
                entries.append(Entry(node.name, _line(source[1]), _line(text.split("\n\n")[0]), told, place))
    return entries


def _line(text: str) -> str:
    return " ".join(text.split())


def catalogue_text() -> str:
    """The catalogue for reading, grouped by file."""
    lines: list[str] = []
    for entry in catalogue():
        lines.append(f"{entry.name}  [{entry.source}]  {entry.place}")
        lines.append(f"    {entry.summary}")
        if entry.deviates:
            lines.append(f"    Deviates: {entry.deviates}")
    return "\n".join(lines) + "\n"
