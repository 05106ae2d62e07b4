"""Nouns as JSON documents, and read back: strictly, driven by the fields of their dataclasses.

A document that is read holds exactly the keys of its noun, each of the type that the noun declares: a text where
a list is expected, `true` for 1, a missing or an unknown key is a ValueError, never a half-read noun.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from math import isfinite
from types import UnionType
from typing import Any, Literal, NoReturn, Self, TypeVar, Union, get_args, get_origin, get_type_hints

T = TypeVar("T")
MAX_DEPTH = 64
LARGEST_INTEGER = 2**63
# Of a field's metadata: its name in the document, where that differs; and whether it may be left out there.
KEY, OPTIONAL = "key", "optional"
_PLAIN = frozenset({type(None), bool, int, float, str})


class Noun:
    """A dataclass that is a JSON object: one key a field (`KEY`: under that name; `OPTIONAL`: only where not empty)."""

    def document(self) -> dict[str, Any]:
        """The object: lists, objects, texts and numbers."""
        document = {}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if value or not field.metadata.get(OPTIONAL):
                document[field.metadata.get(KEY, field.name)] = _written(value)
        return document

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Self:
        """Raises: KeyError, TypeError, ValueError on anything `document` did not write."""
        return read_fields(cls, document)


class Artefact(Noun):
    """A noun that is a file of its own."""

    def document(self) -> dict[str, Any]:
        """The object, with its schema version first."""
        return {"schema_version": 1, **super().document()}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Self:
        """Raises: as `Noun`; the version is the store's to look at."""
        return super().from_document({key: value for key, value in document.items() if key != "schema_version"})


def _written(value: Any) -> Any:
    if type(value) in _PLAIN:
        return value
    for write in ("document", "texts"):  # of a noun, of a matrix
        if hasattr(value, write):
            return getattr(value, write)()
    if isinstance(value, Mapping):
        return {key: _written(inner) for key, inner in value.items()}
    return [_written(inner) for inner in value] if isinstance(value, list | tuple) else value


def parse(content: bytes) -> Any:
    """A JSON text in UTF-8 as plain values, finite and of bounded depth.

    Raises:
        ValueError: what `json` refuses; a key twice, NaN, Infinity, a number beyond floats or 64 bits, a lone
            surrogate, lists and objects nested deeper than 64.
    """
    try:
        value = json.loads(
            content.decode("utf-8"), object_pairs_hook=_object, parse_constant=_refuse_constant, parse_float=_float,
            parse_int=_integer,
        )  # fmt: skip
    except RecursionError:
        raise ValueError("nested too deep") from None
    _refuse_strange(value, 0)
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key stands twice")
    return document


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


def _float(text: str) -> float:
    value = float(text)
    if not isfinite(value):
        raise ValueError("a number beyond floats")
    return value


def _integer(text: str) -> int:
    value = int(text) if len(text) <= 20 else LARGEST_INTEGER
    if abs(value) >= LARGEST_INTEGER:
        raise ValueError("a number beyond 64 bits")
    return value


def _refuse_strange(value: Any, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise ValueError("nested too deep")
    if isinstance(value, str):
        value.encode("utf-8")  # a lone surrogate is a UnicodeEncodeError
    elif isinstance(value, dict):
        for key, inner in value.items():
            key.encode("utf-8")
            _refuse_strange(inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _refuse_strange(inner, depth + 1)


def read(kind: type[T], value: Any) -> T:
    """A plain value as `kind`: a dataclass, a scalar, a Literal, a union, a tuple, list or mapping of these, or a
    class with a `from_document` of its own.

    Raises:
        ValueError, TypeError, KeyError: anything else than what a noun of this kind writes.
    """
    result: T = _read(kind, value)
    return result


def read_fields(kind: type[T], document: Any) -> T:
    """A dataclass from an object with exactly its fields as keys.

    Raises: as `read`.
    """
    if not isinstance(document, dict):
        raise TypeError(f"an object is expected for {kind.__name__}")
    hints, values, known = _hints(kind), {}, set()  # type: ignore[arg-type]
    for field in fields(kind):  # type: ignore[arg-type]
        name = field.metadata.get(KEY, field.name)
        known.add(name)
        if name in document:
            values[field.name] = _read(hints[field.name], document[name])
        elif not field.metadata.get(OPTIONAL):
            raise KeyError(name)
    if not document.keys() <= known:
        raise ValueError(f"unknown key in {kind.__name__}")
    return kind(**values)


@cache
def _hints(kind: type[Any]) -> dict[str, Any]:
    return get_type_hints(kind)


def _read(kind: Any, value: Any) -> Any:
    if kind is Any:
        return value
    if kind is float:
        return float(_scalar(value, (float, int)))
    if kind in (str, int, bool, type(None)):
        return _scalar(value, (kind,))
    if hasattr(kind, "from_document"):
        return kind.from_document(value)
    if is_dataclass(kind):
        return read_fields(kind, value)  # type: ignore[arg-type]
    return _COLLECTIONS[get_origin(kind)](get_args(kind), value)


def _scalar(value: Any, kinds: tuple[type[Any], ...]) -> Any:
    # By the type itself: True is an int, and is none here.
    if type(value) not in kinds:
        raise TypeError(f"{' or '.join(kind.__name__ for kind in kinds)} expected, not {type(value).__name__}")
    return value


def _literal(allowed: tuple[Any, ...], value: Any) -> Any:
    if not any(type(value) is type(one) and value == one for one in allowed):
        raise ValueError("a word that is not known")
    return value


def _union(kinds: tuple[Any, ...], value: Any) -> Any:
    if value is None and type(None) in kinds:
        return None
    (kind,) = (one for one in kinds if one is not type(None))
    return _read(kind, value)


def _list(kinds: tuple[Any, ...], value: Any) -> list[Any]:
    return [_read(kinds[0], item) for item in _scalar(value, (list,))]


def _tuple(kinds: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    if kinds[-1] is Ellipsis:
        return tuple(_list(kinds, value))
    return tuple(_read(kind, item) for kind, item in zip(kinds, _scalar(value, (list,)), strict=True))


def _mapping(kinds: tuple[Any, ...], value: Any) -> dict[str, Any]:
    return {key: _read(kinds[1], item) for key, item in _scalar(value, (dict,)).items()}


_COLLECTIONS: dict[Any, Callable[[tuple[Any, ...], Any], Any]] = {
    Literal: _literal, Union: _union, UnionType: _union, list: _list, tuple: _tuple, dict: _mapping, Mapping: _mapping,
}  # fmt: skip
