"""The reference list: entries of references.bib by key."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from importlib.resources import files

from cdobs_cli.records import dataclass

_ENTRY = re.compile(r"^@\w+\{(\w+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*)\},?$", re.MULTILINE)
_PARTS = ("title", "journal", "booktitle", "publisher", "institution", "year", "note")


@dataclass(frozen=True)
class Reference:
    """One source."""

    key: str
    fields: dict[str, str]

    @property
    def text(self) -> str:
        """`A. Author, B. Author, Title, where, year.`"""
        names = [_plain(name) for name in re.split(r"\s+and\s+", self.fields.get("author", "")) if name]
        authors = ", ".join(" ".join(reversed(name.split(", "))) for name in names)
        parts = [authors, *(self.fields.get(name, "") for name in _PARTS)]
        return ", ".join(_plain(part) for part in parts if part) + "."


def parse_bibliography(text: str) -> dict[str, Reference]:
    """Entries by key: `@type{key,` on a line, then each `field = {value},` on one, then `}`."""
    return {entry[1]: Reference(entry[1], dict(_FIELD.findall(entry[2]))) for entry in _ENTRY.finditer(text)}


def _plain(text: str) -> str:
    return " ".join(text.replace("{", "").replace("}", "").replace("~", " ").replace("--", "–").split())


@cache
def bibliography() -> dict[str, Reference]:
    """All entries of references.bib."""
    return parse_bibliography((files("cdobs_cli") / "references.bib").read_text(encoding="utf-8"))


def cited(sources: Iterable[str]) -> tuple[Reference, ...]:
    """The entries whose key occurs in any of the sources, in order of key."""
    words = {word for source in sources for word in re.findall(r"[A-Za-z]+\d{4}[a-z]?", source)}
    return tuple(reference for key, reference in sorted(bibliography().items()) if key in words)
