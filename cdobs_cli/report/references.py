"""The reference list: entries of references.bib by key."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

_ENTRY = re.compile(r"@(\w+)\s*\{\s*([^,\s]+)\s*,")
_FIELD = re.compile(r"\s*(\w+)\s*=\s*")


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
        where = (self.fields.get(name, "") for name in ("journal", "booktitle", "publisher", "institution"))
        parts = [
            authors,
            self.fields.get("title", ""),
            *where,
            self.fields.get("year", ""),
            self.fields.get("note", ""),
        ]
        return ", ".join(_plain(part) for part in parts if part) + "."


def parse_bibliography(text: str) -> dict[str, Reference]:
    """Entries by key. Reads `@type{key, field = {value}, ..}` with nested braces or quotes; what is
    between entries is ignored."""
    found: dict[str, Reference] = {}
    position = 0
    while entry := _ENTRY.search(text, position):
        position = entry.end()
        fields: dict[str, str] = {}
        while name := _FIELD.match(text, position):
            value, position = _value(text, name.end())
            fields[name[1].lower()] = value
            while position < len(text) and text[position] in ", \t\r\n":
                position += 1
        found[entry[2]] = Reference(entry[2], fields)
    return found


def _value(text: str, start: int) -> tuple[str, int]:
    """A braced, quoted or bare value and where it ends."""
    opening = text[start : start + 1]
    if opening not in ("{", '"'):
        bare = re.compile(r"[^,}\s]*").match(text, start)
        assert bare is not None
        return bare[0], bare.end()
    depth = 0
    for position in range(start, len(text)):
        character = text[position]
        depth += (character == "{") - (character == "}")
        closes = character == "}" if opening == "{" else character == '"' and position > start
        if depth == 0 and closes:
            return " ".join(text[start + 1 : position].split()), position + 1
    return text[start + 1 :], len(text)


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
