"""YAML text to plain values, each with its line and column; hostile input is refused on the way.

Built on PyYAML's events (its pure-Python parser keeps its own stack): what the user typed is followed 16 levels
deep and no further, and no tag, alias or anchor is ever acted on. Scalars follow YAML 1.2: `yes`, `no`, `on`, `off` are
strings, `1e-3` is a number; decimals stay text, so that they stay exact.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import yaml

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.records import dataclass
from cdobs_cli.regular import IrregularError, regular_bytes
from cdobs_cli.spec.yaml_words import plain_words

MAX_BYTES = 256 * 1024
MAX_NODES = 20_000
MAX_DEPTH = 16
MAX_SCALAR = 4_000
MAX_ENTRIES = 1_024
MAX_PROBLEMS = 100
LONGEST_FLOW = 40  # characters of a list or mapping that a message quotes

FieldPath = tuple[str | int, ...]

_NULL = {"", "~", "null", "Null", "NULL"}
_BOOLEAN = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?[0-9]+\Z")
_DECIMAL = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_NOT_FINITE = re.compile(r"([-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))\Z")
_SURROGATE = re.compile("[\ud800-\udfff]")
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\x80-\x84\x86-\x9f\ufffe\uffff]")


class DecimalText(str):
    """A number as it was typed, e.g. `1e-3`: text, so that nothing is rounded."""

    __slots__ = ()


@dataclass(frozen=True)
class Place:
    """Line and column, both from 1."""

    file: str
    line: int
    column: int


@dataclass
class Document:
    """What a file holds. `values` and `keys` give the place of each value and of each key by field path;
    under the paths in `refused` the value is not what was typed."""

    file: str
    root: Any = None
    values: dict[FieldPath, Place] = field(default_factory=dict)
    keys: dict[FieldPath, Place] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    refused: set[FieldPath] = field(default_factory=set)

    def place(self, path: FieldPath, *, key: bool = False) -> Place:
        """Of the value at `path` (of its key), or of the nearest thing around it that was typed."""
        if key and path in self.keys:
            return self.keys[path]
        while path and path not in self.values:
            path = path[:-1]
        return self.values.get(path, Place(self.file, 1, 1))

    def value(self, path: FieldPath) -> Any:
        """What stands at a path that was typed."""
        inside = self.root
        for part in path:
            inside = inside[part]
        return inside

    def graft(self, at: FieldPath, other: Document) -> None:
        """Put another file's content in the place of the value at `at`."""
        self.value(at[:-1])[at[-1]] = other.root
        for path in [path for path in self.values if path[: len(at)] == at and len(path) > len(at)]:
            del self.values[path]
            self.keys.pop(path, None)
        self.values |= {at + path: place for path, place in other.values.items()}
        self.keys |= {at + path: place for path, place in other.keys.items()}
        self.refused |= {at + path for path in other.refused}
        self.problems += [replace(problem, field=at + problem.field) for problem in other.problems]


def flow(value: Any, longest: int = LONGEST_FLOW) -> str | None:
    """A value as it is written on one line; None where that is long."""
    if isinstance(value, dict | list) and len(value) > longest // 3:
        return None
    if isinstance(value, dict):
        entries = [(f"{name}: ", flow(one, longest)) for name, one in value.items()]
    elif isinstance(value, list):
        entries = [("", flow(one, longest)) for one in value]
    else:
        return shown(value)
    if any(text is None for _, text in entries):
        return None
    told = ", ".join(f"{name}{text}" for name, text in entries)
    told = f"{{{told}}}" if isinstance(value, dict) else f"[{told}]"
    return told if len(told) <= longest and told.isprintable() else None


def shown(value: Any, limit: int = 60) -> str:
    """A value as a short text for a message."""
    if isinstance(value, dict):
        return flow(value) or (f"a mapping of {len(value)} key{'s' if len(value) > 1 else ''}")
    if isinstance(value, list):
        return flow(value) or f"a list of {len(value)} entries"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = str(value) if isinstance(value, int | DecimalText) else f'"{value}"'
    text = text.encode("unicode_escape").decode("ascii")
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def read(path: Path) -> Document:
    """Read one file.

    Raises:
        SpecError: the file cannot be read, is not YAML, or is beyond a limit. Duplicate keys, anchors,
            aliases, tags and numbers that are not finite are gathered in `Document.problems` instead.
    """
    file = str(path)
    return read_text(_decode(file, _bytes(path)), file)


def read_text(text: str, file: str) -> Document:
    """Read YAML text; `file` is what messages name. Raises: SpecError, as `read`."""
    text = text.removeprefix("\ufeff")  # the byte order mark that some editors write
    if (bad := _FORBIDDEN.search(text)) is not None:
        line, column = _line_column(text, bad.start())
        raise _refusal(file, "a character that YAML does not allow", line, column, got=f"U+{ord(bad.group()):04X}")
    reading = _Reading(file, text)
    try:
        reading.read()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        stopped = _line(text, mark.line) if mark else ""
        what, hint = plain_words(str(error.problem or error.context), stopped)
        raise reading.stop(what, (mark.line + 1, mark.column + 1) if mark else (1, 1), hint=hint) from None
    except (yaml.YAMLError, ValueError, OverflowError, IndexError, TypeError, AttributeError) as error:
        # PyYAML lets a few errors of its own through, e.g. for "\U99999999" in double quotes.
        what = str(error).splitlines()[0][:100] if str(error) else "unreadable"
        raise reading.stop(f"not YAML: {what}", reading.last) from None
    return reading.document


def _events(text: str) -> Iterator[yaml.Event]:
    loader = yaml.SafeLoader(text)
    try:
        while loader.check_event():
            yield loader.get_event()  # type: ignore[no-untyped-call]
    finally:
        loader.dispose()


def _refusal(file: str, what: str, line: int | None = 1, column: int | None = 1, *, got: str | None = None,
             allowed: str | None = None, hint: str | None = None) -> SpecError:  # fmt: skip
    return SpecError((Problem((), what, got, allowed, hint, file, line, column),))


def _bytes(path: Path) -> bytes:
    file = str(path)
    try:
        data = regular_bytes(path, MAX_BYTES)
    except FileNotFoundError:
        raise _refusal(file, "no such file", None, None) from None
    except IrregularError as error:
        raise _refusal(file, "a YAML file is expected", None, None, got=str(error)) from None
    except (OSError, ValueError) as error:
        reason = (error.strerror or "unreadable").lower() if isinstance(error, OSError) else "not a file name"
        raise _refusal(file, f"the file cannot be read: {reason}", None, None) from None
    if len(data) > MAX_BYTES:
        raise _refusal(file, "the file is too large", None, None, allowed=f"at most {MAX_BYTES} bytes")
    return data


def _decode(file: str, data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = _line_column(data[: error.start].decode("utf-8"), error.start)
        raise _refusal(file, "the file is not UTF-8", line, column, got=f"byte 0x{data[error.start]:02X}") from None


_LINE_ENDS = "\r\n|\r|\n"


def _line(text: str, index: int) -> str:
    """A line of the text, from 0; empty behind its end."""
    lines = re.split(_LINE_ENDS, text, maxsplit=index + 1)
    return lines[index] if index < len(lines) else ""


def _line_column(text: str, position: int) -> tuple[int, int]:
    before = re.split(_LINE_ENDS, text[:position])
    return len(before), len(before[-1]) + 1


class _Reading:
    """The events of one text, read by descent: at most MAX_DEPTH deep."""

    def __init__(self, file: str, text: str) -> None:
        self.document, self.events = Document(file), _events(text)
        self.around: list[FieldPath] = []  # the lists and mappings that are open
        self.nodes, self.last = 0, (1, 1)

    @property
    def here(self) -> Place:
        return Place(self.document.file, *self.last)

    def stop(
        self, what: str, at: tuple[int, int], *,
        allowed: str | None = None, got: str | None = None, hint: str | None = None,
    ) -> SpecError:  # fmt: skip
        """An error that ends the reading, with those gathered before it."""
        path = self.around[-1] if self.around else ()
        problem = Problem(path, what, got, allowed, hint, self.document.file, *at)
        return SpecError((*self.document.problems, problem))

    def refuse(self, path: FieldPath, what: str, **more: str | None) -> None:
        """A mistake that reading survives."""
        if len(self.document.problems) >= MAX_PROBLEMS:
            raise self.stop("too many mistakes", self.last)
        self.document.refused.add(path)
        line, column = self.last
        self.document.problems.append(Problem(path, what, **more, file=self.document.file, line=line, column=column))

    def next(self) -> yaml.Event | None:
        event = next(self.events, None)
        if event is not None and event.start_mark is not None:
            self.last = (event.start_mark.line + 1, event.start_mark.column + 1)
        return event

    def read(self) -> None:
        documents = 0
        while (event := self.next()) is not None:
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self.stop("a second document", self.last, allowed="one document a file")
                if event.tags:
                    raise self.stop("a %TAG directive", self.last, allowed="no tags")
                self.count(1)
                self.document.root = self.value(self.next(), (), kept=True)

    def value(self, event: yaml.Event | None, path: FieldPath, *, kept: bool) -> Any:
        """What the event begins; its place is noted where it is kept."""
        if isinstance(event, yaml.ScalarEvent):
            self.refuse_strange(event)
        elif not isinstance(event, yaml.AliasEvent) and len(self.around) >= MAX_DEPTH:
            raise self.stop("nested too deep", self.last, allowed=f"at most {MAX_DEPTH} levels")
        if kept:
            self.document.values[path] = self.here
        match event:
            case yaml.AliasEvent():
                self.refuse(path, "an alias", got=f"*{(event.anchor or '')[:40]}", hint="write the value out")
            case yaml.ScalarEvent():
                self.decorations(path, event)
                return self.scalar(event, path)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                self.decorations(path, event)
                self.around.append(path)
                is_list = isinstance(event, yaml.SequenceStartEvent)
                inside: Any = self.entries(path, kept) if is_list else self.mapping(path, kept)
                self.around.pop()
                return inside
        return None

    def scalar(self, event: yaml.ScalarEvent, path: FieldPath) -> Any:
        if event.style is not None or event.tag is not None:
            return event.value
        if _NOT_FINITE.match(event.value):
            hint = "leave an open end of an interval out with null"
            self.refuse(path, "a finite number is expected", got=event.value, hint=hint)
            return None
        return _resolve(event.value)

    def entries(self, path: FieldPath, kept: bool) -> list[Any]:
        entries: list[Any] = []
        while not isinstance(event := self.next(), yaml.SequenceEndEvent):
            self.count(len(entries) + 1)
            entries.append(self.value(event, (*path, len(entries)), kept=kept))
        return entries

    def mapping(self, path: FieldPath, kept: bool) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        keys = 0
        while not isinstance(event := self.next(), yaml.MappingEndEvent):
            keys += 1
            self.count(keys)
            name = self.key(event, path, entries, kept)
            first = kept and name is not None and name not in entries
            value = self.value(self.next(), (*path, "?" if name is None else name), kept=first)
            if name is not None:
                entries.setdefault(name, value)  # of a key that stands twice the first value is kept
        return entries

    def key(self, event: yaml.Event | None, path: FieldPath, before: dict[str, Any], kept: bool) -> str | None:
        """A key's name; None where it is none."""
        if not isinstance(event, yaml.ScalarEvent):
            at = (*path, "?")
            if isinstance(event, yaml.AliasEvent):
                self.value(event, at, kept=False)
            else:
                got = "{}" if isinstance(event, yaml.MappingStartEvent) else "[]"
                self.refuse(at, "a key is a name", got=got)
                self.value(event, path, kept=False)  # read past
            return None
        self.refuse_strange(event)
        name, at = event.value, (*path, event.value)
        if kept and name in before:
            self.refuse(at, f"the key {shown(name)} is already given at line {self.document.keys[at].line}")
        elif kept:
            self.document.keys[at] = self.here
        self.decorations(at, event)
        return name

    def refuse_strange(self, event: yaml.ScalarEvent) -> None:
        if len(event.value) > MAX_SCALAR:
            raise self.stop("a value that is too long", self.last, allowed=f"at most {MAX_SCALAR} characters")
        if (half := _SURROGATE.search(event.value)) is not None:
            raise self.stop("half of a surrogate pair is no character", self.last, got=f"\\u{ord(half.group()):04x}")

    def decorations(self, path: FieldPath, event: yaml.NodeEvent) -> None:
        if event.anchor is not None:
            self.refuse(path, "an anchor", got=f"&{event.anchor[:40]}", hint="write the value out where it is used")
        if (tag := getattr(event, "tag", None)) is not None:
            self.refuse(path, "a tag", got=str(tag)[:40], hint="plain values need none")

    def count(self, entries: int) -> None:
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise self.stop("too many values", self.last, allowed=f"at most {MAX_NODES}")
        if entries > MAX_ENTRIES:
            raise self.stop("too many entries", self.last, allowed=f"at most {MAX_ENTRIES}")


def _resolve(text: str) -> Any:
    if text in _NULL:
        return None
    if text in _BOOLEAN:
        return _BOOLEAN[text]
    if _INTEGER.match(text):
        # Very long integers stay text: their digits are counted with every other number's.
        return int(text) if len(text) <= 60 else DecimalText(text)
    if _DECIMAL.match(text):
        return DecimalText(text)
    return text
