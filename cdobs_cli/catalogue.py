"""`cdobs theorems`: what is implemented, read from the docstrings that say `Source: ..`."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_SOURCE = re.compile(r"^\s*Source:\s*(.+?)(?=^\s*\n|^\s*[A-Z][a-z]+:|\Z)", re.MULTILINE | re.DOTALL)
_DEVIATES = re.compile(r"^\s*Deviates:\s*(.+?)(?=^\s*\n|^\s*[A-Z][a-z]+:|\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Entry:
    """One function that implements a published or derived statement."""

    name: str
    source: str
    summary: str
    deviates: str | None
    place: str

    def document(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "source": self.source,
            "summary": self.summary,
            "deviates": self.deviates,
            "place": self.place,
        }


def catalogue() -> list[Entry]:
    """Every function or class of the package whose docstring names a source, by file and line."""
    package = Path(__file__).parent
    entries = []
    for path in sorted(package.rglob("*.py")):
        for node in _definitions(ast.parse(path.read_text(encoding="utf-8"))):
            text = ast.get_docstring(node) or ""
            source = _SOURCE.search(text)
            if source:
                deviates = _DEVIATES.search(text)
                place = f"{path.relative_to(package.parent)}:{node.lineno}"
                entries.append(
                    Entry(
                        node.name,
                        _line(source[1]),
                        _line(text.split("\n\n")[0]),
                        _line(deviates[1]) if deviates else None,
                        place,
                    )
                )
    return entries


def _definitions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node


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
