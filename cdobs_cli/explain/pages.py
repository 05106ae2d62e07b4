"""The pages as nouns: read from the Markdown files of this room, found by their ids."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from typing import Any

from cdobs_cli.records import dataclass

# Titles of the kinds, in the order of the list.
KINDS = {
    "claim": "Claims", "bound": "Bounds", "verdict": "Verdicts, kinds and outcomes", "message": "Messages",
    "method": "Methods and ways of proof", "topic": "Topics",
}  # fmt: skip
PARTS = ("What it is", "Why", "Next")
_SHOWN = 6  # nearest names
_ALIKE = 0.7  # of them, as a ratio of letters
_OPEN = re.compile(r"<([a-z_]+)>")
_COUNTED = ("i", "j", "k")  # placeholders that stand for numbers


@dataclass(frozen=True)
class Page:
    """One page: the ids that it is about (`<..>` stands for a name of the spec), their kinds, and its three parts."""

    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    what: str
    why: str
    next: str

    @property
    def first_sentence(self) -> str:
        return re.split(r"(?<=[.?])\s+(?=[A-Z`(])", self.what, maxsplit=1)[0]

    @property
    def parts(self) -> tuple[tuple[str, str], ...]:
        """Title and text of each part."""
        return tuple(zip(PARTS, (self.what, self.why, self.next), strict=True))

    def document(self) -> dict[str, Any]:
        return {
            "ids": list(self.ids), "kinds": list(self.kinds), "what": self.what, "why": self.why, "next": self.next,
        }  # fmt: skip


@cache
def pages() -> tuple[Page, ...]:
    """All pages, in the order of the files and within them."""
    room = sorted(files(__package__).iterdir(), key=lambda file: file.name)
    return tuple(page for file in room if file.name.endswith(".md") for page in read(file.read_text(encoding="utf-8")))


def read(text: str) -> Iterable[Page]:
    """The pages of one file.

    Raises:
        ValueError: a page without its kinds or one of its parts.
    """
    for chapter in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        heading, kinds, *told = (" ".join(block.split()) for block in chapter.strip().split("\n\n"))
        ids, named = tuple(re.findall(r"`([^`]+)`", heading)), tuple(kinds.split(", "))
        begins = [f"**{part}.** " for part in PARTS]
        if not ids or not set(named) <= KINDS.keys() or len(told) != len(PARTS):
            raise ValueError(f"a page without ids, kinds or parts: {heading}")
        if not all(map(str.startswith, told, begins)):
            raise ValueError(f"a page whose parts are not {', '.join(PARTS)}: {heading}")
        yield Page(ids, named, *(block.removeprefix(begin) for block, begin in zip(told, begins, strict=True)))


def find(identifier: str) -> Page | None:
    """The page of an id: that which names it, else the one whose pattern it fits with the fewest open places."""
    named = _named().get(identifier)
    if named is not None:
        return named
    return next((page for pattern, page in _patterns() if pattern.fullmatch(identifier)), None)


@cache
def _named() -> dict[str, Page]:
    return {one: page for page in pages() for one in page.ids}


@cache
def _patterns() -> list[tuple[re.Pattern[str], Page]]:
    """Of the ids with open places, the most particular first: few places, and numbers before names."""
    opened = [(one, page) for one, page in _named().items() if _OPEN.search(one)]
    opened.sort(key=lambda pair: (len(_OPEN.findall(pair[0])), any(k not in _COUNTED for k in _OPEN.findall(pair[0]))))
    return [(_pattern(one), page) for one, page in opened]


def _pattern(identifier: str) -> re.Pattern[str]:
    """`slopes.<i>.<j>` fits `slopes.2.1`, `error.<state>` fits `error.omega`."""
    parts = re.split(r"(<[a-z_]+>)", identifier)
    return re.compile("".join(_place(part) if _OPEN.fullmatch(part) else re.escape(part) for part in parts))


def _place(part: str) -> str:
    return "[0-9]+" if part[1:-1] in _COUNTED else r"[^.\s]+"


def nearest(identifier: str) -> list[str]:
    """Ids that may have been meant: those that begin with the word or hold it, then those spelt alike, open places
    filled in."""
    word, known = identifier.casefold(), list(_named())
    inside = [one for one in known if word and word in one.casefold()]
    inside.sort(key=lambda one: (not one.casefold().startswith(word), len(one)))
    filled = {_filled(one, identifier): one for one in known}
    alike = (filled[one] for one in get_close_matches(identifier, filled, _SHOWN, _ALIKE))
    return list(dict.fromkeys([*inside, *alike]))[:_SHOWN]


def _filled(one: str, identifier: str) -> str:
    """`error.<state>` with the names of another id, `eror.omega`, in its open places."""
    parts, names = one.split("."), identifier.split(".")
    if len(parts) != len(names):
        return one
    return ".".join(name if _OPEN.fullmatch(part) else part for part, name in zip(parts, names, strict=True))
