"""YAML text to plain values, each with its line and column; hostile input is refused on the way.

Built on PyYAML's events (its pure-Python parser keeps its own stack), so nothing recurses on what the user
typed and no tag, alias or anchor is ever acted on. Scalars follow YAML 1.2: `yes`, `no`, `on`, `off` are
strings, `1e-3` is a number; decimals stay text, so that they stay exact.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from cdobs_cli.errors import Problem, SpecError

MAX_BYTES = 256 * 1024
MAX_NODES = 20_000
MAX_DEPTH = 16
MAX_SCALAR = 4_000
MAX_ENTRIES = 1_024
MAX_PROBLEMS = 100

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
        container = self.root
        for part in at[:-1]:
            container = container[part]
        container[at[-1]] = other.root
        for path in [path for path in self.values if path[: len(at)] == at and len(path) > len(at)]:
            del self.values[path]
            self.keys.pop(path, None)
        self.values |= {at + path: place for path, place in other.values.items()}
        self.keys |= {at + path: place for path, place in other.keys.items()}
        self.refused |= {at + path for path in other.refused}
        self.problems += [replace(problem, field=at + problem.field) for problem in other.problems]


def shown(value: Any, limit: int = 60) -> str:
    """A value as a short text for a message."""
    if isinstance(value, dict):
        return f"a mapping of {len(value)} keys" if value else "{}"
    if isinstance(value, list):
        return f"a list of {len(value)} entries" if value else "[]"
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
    if text.startswith("\ufeff"):
        raise _refusal(file, "a byte order mark", hint="save the file as UTF-8 without BOM")
    if (bad := _FORBIDDEN.search(text)) is not None:
        line, column = _line_column(text, bad.start())
        raise _refusal(file, "a character that YAML does not allow", line, column, got=f"U+{ord(bad.group()):04X}")
    builder = _Builder(file)
    try:
        for event in _events(text):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = f"not YAML: {error.problem or error.context}"
        raise builder.stop(what, (mark.line + 1, mark.column + 1) if mark else (1, 1)) from None
    except (yaml.YAMLError, ValueError, OverflowError, IndexError, TypeError, AttributeError) as error:
        # PyYAML lets a few errors of its own through, e.g. for "\U99999999" in double quotes.
        raise builder.stop(
            f"not YAML: {str(error).splitlines()[0][:100] if str(error) else 'unreadable'}", builder.last
        ) from None
    return builder.document


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
        _require_regular(file, os.stat(path).st_mode)  # opening a device may already do something
        # Without O_NONBLOCK a named pipe would wait for a writer for ever.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise _refusal(file, "no such file", None, None) from None
    except (OSError, ValueError) as error:
        reason = (error.strerror or "unreadable").lower() if isinstance(error, OSError) else "not a file name"
        raise _refusal(file, f"the file cannot be read: {reason}", None, None) from None
    with os.fdopen(handle, "rb") as stream:
        _require_regular(file, os.fstat(handle).st_mode)
        try:
            data = stream.read(MAX_BYTES + 1)
        except OSError as error:
            raise _refusal(
                file, f"the file cannot be read: {(error.strerror or 'unreadable').lower()}", None, None
            ) from None
    if len(data) > MAX_BYTES:
        raise _refusal(file, "the file is too large", None, None, allowed=f"at most {MAX_BYTES} bytes")
    return data


def _require_regular(file: str, mode: int) -> None:
    if not stat.S_ISREG(mode):
        got = "a directory" if stat.S_ISDIR(mode) else "not a regular file"
        raise _refusal(file, "a YAML file is expected", None, None, got=got)


def _decode(file: str, data: bytes) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = _line_column(data[: error.start].decode("utf-8"), error.start)
        raise _refusal(file, "the file is not UTF-8", line, column, got=f"byte 0x{data[error.start]:02X}") from None


def _line_column(text: str, position: int) -> tuple[int, int]:
    before = re.split("\r\n|\r|\n", text[:position])
    return len(before), len(before[-1]) + 1


class _Skip:
    """Stands where a value is not kept (a second value of a key, the value of a key that is not a name)."""


@dataclass
class _Frame:
    path: FieldPath
    container: dict[str, Any] | list[Any]
    kept: bool
    key: str | None = None
    key_kept: bool = True
    awaits_key: bool = True
    count: int = 0


class _Builder:
    def __init__(self, file: str) -> None:
        self.document = Document(file)
        self.frames: list[_Frame] = []
        self.nodes = 0
        self.documents = 0
        self.last = (1, 1)

    def stop(self, what: str, at: tuple[int, int], *, allowed: str | None = None, got: str | None = None) -> SpecError:
        """An error that ends the reading, with those gathered before it."""
        path = self.frames[-1].path if self.frames else ()
        problem = Problem(path, what, got, allowed, None, self.document.file, *at)
        return SpecError((*self.document.problems, problem))

    def refuse(self, path: FieldPath, what: str, **more: str | None) -> None:
        """A mistake that reading survives."""
        if len(self.document.problems) >= MAX_PROBLEMS:
            raise self.stop("too many mistakes", self.last)
        self.document.refused.add(path)
        self.document.problems.append(
            Problem(path, what, **more, file=self.document.file, line=self.last[0], column=self.last[1])
        )

    def take(self, event: yaml.Event) -> None:
        if event.start_mark is not None:
            self.last = (event.start_mark.line + 1, event.start_mark.column + 1)
        match event:
            case yaml.DocumentStartEvent():
                self.documents += 1
                if self.documents > 1:
                    raise self.stop("a second document", self.last, allowed="one document a file")
                if event.tags:
                    raise self.stop("a %TAG directive", self.last, allowed="no tags")
            case yaml.AliasEvent():
                path = self.add(None)
                self.refuse(path, "an alias", got=f"*{(event.anchor or '')[:40]}", hint="write the value out")
            case yaml.ScalarEvent():
                self.scalar(event)
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                self.open(event)
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                self.frames.pop()

    def scalar(self, event: yaml.ScalarEvent) -> None:
        if len(event.value) > MAX_SCALAR:
            raise self.stop("a value that is too long", self.last, allowed=f"at most {MAX_SCALAR} characters")
        if (half := _SURROGATE.search(event.value)) is not None:
            raise self.stop("half of a surrogate pair is no character", self.last, got=f"\\u{ord(half.group()):04x}")
        frame = self.frames[-1] if self.frames else None
        if frame is not None and isinstance(frame.container, dict) and frame.awaits_key:
            self.key(frame, event)
            return
        value = _resolve(event.value) if event.style is None and event.tag is None else event.value
        path = self.add(None if isinstance(value, _Skip) else value)
        self.decorations(path, event)
        if isinstance(value, _Skip):
            self.refuse(
                path,
                "a finite number is expected",
                got=event.value,
                hint="leave an open end of an interval out with null",
            )

    def key(self, frame: _Frame, event: yaml.ScalarEvent) -> None:
        self.count(frame)
        name = event.value
        path = (*frame.path, name)
        frame.key, frame.key_kept, frame.awaits_key = name, True, False
        if frame.kept and isinstance(frame.container, dict) and name in frame.container:
            first = self.document.keys[path]
            # The first value is kept; the second is read past.
            frame.key_kept = False
            if self.frames[-1].kept:
                self.refuse(path, f"the key {shown(name)} is already given at line {first.line}")
        elif frame.kept:
            self.document.keys[path] = Place(self.document.file, *self.last)
        self.decorations(path, event)

    def open(self, event: yaml.MappingStartEvent | yaml.SequenceStartEvent) -> None:
        if len(self.frames) >= MAX_DEPTH:
            raise self.stop("nested too deep", self.last, allowed=f"at most {MAX_DEPTH} levels")
        container: dict[str, Any] | list[Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
        frame = self.frames[-1] if self.frames else None
        if frame is not None and isinstance(frame.container, dict) and frame.awaits_key:
            self.count(frame)
            frame.key, frame.key_kept, frame.awaits_key = "?", False, False
            self.refuse((*frame.path, "?"), "a key is a name", got=shown(container))
            # Its content is read past; the frame below stands for the key, then a value follows.
            self.frames.append(_Frame(frame.path, container, kept=False))
            return
        kept = frame is None or (frame.kept and (not isinstance(frame.container, dict) or frame.key_kept))
        path = self.add(container)
        self.decorations(path, event)
        self.frames.append(_Frame(path, container, kept))

    def decorations(self, path: FieldPath, event: yaml.NodeEvent) -> None:
        if event.anchor is not None:
            self.refuse(path, "an anchor", got=f"&{event.anchor[:40]}", hint="write the value out where it is used")
        if (tag := getattr(event, "tag", None)) is not None:
            self.refuse(path, "a tag", got=str(tag)[:40], hint="plain values need none")

    def count(self, frame: _Frame | None) -> None:
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise self.stop("too many values", self.last, allowed=f"at most {MAX_NODES}")
        if frame is not None:
            frame.count += 1
            if frame.count > MAX_ENTRIES:
                raise self.stop("too many entries", self.last, allowed=f"at most {MAX_ENTRIES}")

    def add(self, value: Any) -> FieldPath:
        """Put a value where it belongs; returns its path."""
        place = Place(self.document.file, *self.last)
        if not self.frames:
            self.count(None)
            self.document.root = value
            self.document.values[()] = place
            return ()
        frame = self.frames[-1]
        if isinstance(frame.container, list):
            self.count(frame)
            path: FieldPath = (*frame.path, len(frame.container))
            frame.container.append(value)
            if frame.kept:
                self.document.values[path] = place
            return path
        if frame.awaits_key:
            # An alias in the place of a key.
            frame.key, frame.key_kept, frame.awaits_key = "?", False, False
            return (*frame.path, "?")
        path = (*frame.path, frame.key or "")
        frame.awaits_key = True
        if frame.key_kept:
            frame.container[frame.key or ""] = value
            if frame.kept:
                self.document.values[path] = place
        return path


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
    return _Skip() if _NOT_FINITE.match(text) else text
