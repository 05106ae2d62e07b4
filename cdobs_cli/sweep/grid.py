"""`--set field=v1,v2` and `--set field=lo:hi:count`: the values of each field, and the points of their grid."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import product

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.records import dataclass
from cdobs_cli.spec.replaced import Setting, flow_text

MAX_POINTS = 10_000
_FIELD = re.compile(r"[^\s.\[\]=]+(\.[^\s.\[\]=]+|\[[0-9]{1,4}\])*")
_NUMBER = r"[-+]?(?:[0-9]{1,30}\.?[0-9]{0,30}|\.[0-9]{1,30})(?:[eE][-+]?[0-9]{1,2})?|[-+]?[0-9]{1,30}/[0-9]{1,30}"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER}):([0-9]{{1,9}})")
_PAIRS = {"[": "]", "{": "}", "(": ")"}
_HOW = "write --set field=v1,v2 or --set field=lo:hi:count"


@dataclass(frozen=True)
class Axis:
    """A field, and the values it takes as YAML text, in order."""

    field: str
    values: tuple[str, ...]

    @property
    def settings(self) -> tuple[Setting, ...]:
        return tuple(Setting(self.field, value) for value in self.values)


@dataclass(frozen=True)
class Shard:
    """Part `index` of `count` (from 1): every count-th point, so that parts take equally long."""

    index: int = 1
    count: int = 1

    @staticmethod
    def of(text: str) -> Shard:
        """`2/4`. Raises: UsageError."""
        match = re.fullmatch("([0-9]{1,6})/([0-9]{1,6})", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise UsageError(f"--shard {text}: i/n is expected, with i from 1 to n")
        return Shard(int(match[1]), int(match[2]))

    def holds(self, number: int) -> bool:
        """Whether the point of this number, from 0, is in this part."""
        return number % self.count == self.index - 1


def axes(texts: Sequence[str]) -> tuple[Axis, ...]:
    """The fields and their values.

    Raises:
        UsageError: a text is none of the two forms, a field or a value stands twice, or the points are too many.
    """
    found = tuple(map(_axis, texts))
    if not found:
        raise UsageError(f"no field to sweep over; {_HOW}")
    for field in (axis.field for axis in found):
        if sum(axis.field == field for axis in found) > 1:
            raise UsageError(f"--set {field} stands twice")
    count = 1
    for axis in found:
        count *= len(axis.values)
    if count > MAX_POINTS:
        raise UsageError(f"the grid has {count} points; allowed: at most {MAX_POINTS}")
    return found


def axes_of(fields: Mapping[str, Sequence[object] | str]) -> tuple[Axis, ...]:
    """The same of values, or of `lo:hi:count`, by field. Raises: UsageError, as `axes`."""
    told = {
        name: values if isinstance(values, str) else ",".join(map(flow_text, values)) for name, values in fields.items()
    }
    return axes([f"{name}={text}" for name, text in told.items()])


def points(found: Sequence[Axis]) -> list[tuple[Setting, ...]]:
    """All of the grid; the last field changes first."""
    return list(product(*(axis.settings for axis in found)))


def _axis(text: str) -> Axis:
    field, equals, values = text.partition("=")
    if not equals or not _FIELD.fullmatch(field):
        raise UsageError(f"--set {text}: no field and values; {_HOW}, the field as a dotted path")
    spaced = _RANGE.fullmatch(values.strip())
    listed = _spaced(text, *spaced.groups()) if spaced else _listed(values)
    if not all(listed):
        raise UsageError(f"--set {text}: a value is empty; {_HOW}")
    twice = next((value for value in listed if listed.count(value) > 1), None)
    if twice is not None:
        raise UsageError(f"--set {text}: the value {twice} stands twice")
    return Axis(field, tuple(listed))


def _spaced(text: str, low: str, high: str, count: str) -> list[str]:
    """`count` equally spaced numbers from `low` to `high`, exact."""
    if not 2 <= int(count) <= MAX_POINTS:
        raise UsageError(f"--set {text}: lo:hi:count has 2 to {MAX_POINTS} values")
    try:
        first, last = Fraction(low), Fraction(high)
    except ZeroDivisionError:
        raise UsageError(f"--set {text}: a number is divided by 0") from None
    steps = int(count) - 1
    return [_exact_text(first + (last - first) * step / steps) for step in range(steps + 1)]


def _exact_text(value: Fraction) -> str:
    """A decimal where it ends, else `"p/q"`, the constant expression."""
    rest = value.denominator
    for prime in (2, 5):
        while rest % prime == 0:
            rest //= prime
    if rest != 1:
        return f'"{value}"'
    digits = len(str(abs(value.numerator))) + len(str(value.denominator)) * 4  # 1/2^k has k digits, 2^k a third of them
    return decimal_text(value, digits)


def _listed(text: str) -> list[str]:
    """Split at the commas that stand in no bracket and no quotes."""
    values, start, open_ends, quote = [], 0, [], ""
    for place, one in enumerate(text):
        if quote:
            quote = "" if one == quote else quote
        elif one in "\"'":
            quote = one
        elif one in _PAIRS:
            open_ends.append(_PAIRS[one])
        elif open_ends and one == open_ends[-1]:
            open_ends.pop()
        elif one == "," and not open_ends:
            values.append(text[start:place].strip())
            start = place + 1
    return [*values, text[start:].strip()]
