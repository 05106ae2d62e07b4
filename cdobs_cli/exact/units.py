"""Numbers typed with a unit or a decimal comma: what they are without. The spec takes plain numbers alone."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from fractions import Fraction

from cdobs_cli.exact.numbers import decimal_text

DIGITS = 12  # of a number that is shown instead
_TYPED = re.compile(
    r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*(?![eE][-+]?\d)([A-Za-z%µμ°Ω][A-Za-z%µμ°Ω/^*0-9-]{0,15})\Z"
)
_HEXADECIMAL = re.compile(r"[xX][0-9a-fA-F]+\Z")
_COMMA = re.compile(r"[-+]?\d{1,20},\d{1,20}\Z")


def _words(**values: tuple[str, Fraction]) -> Mapping[str, Fraction]:
    return {word: value for listed, value in values.values() for word in listed.split()}


SECONDS: Mapping[str, Fraction] = _words(
    ns=("ns nsec", Fraction(1, 10**9)), us=("us usec µs μs microseconds", Fraction(1, 10**6)),
    ms=("ms msec millisecond milliseconds", Fraction(1, 1000)), s=("s sec secs second seconds", Fraction(1)),
    min=("min mins minute minutes", Fraction(60)), h=("h hr hrs hour hours", Fraction(3600)),
    d=("d day days", Fraction(86400)),
)  # fmt: skip
HERTZ: Mapping[str, Fraction] = _words(
    mHz=("mHz", Fraction(1, 1000)), Hz=("Hz hz HZ", Fraction(1)), kHz=("kHz khz KHz", Fraction(1000)),
    MHz=("MHz", Fraction(10**6)),
)  # fmt: skip


def plain_number(text: str, time_unit: str, names: Container[str]) -> str | None:
    """What to write for a number with a unit, or with a decimal comma; None of anything else.

    time_unit: the label of the unit that times are in. names: that are no units.
    """
    text = text.strip()
    if _COMMA.match(text):
        return f"a decimal point is written '.': {text.replace(',', '.')}"
    if (typed := _TYPED.match(text)) is None:
        return None
    number, unit = typed.groups()
    if unit in names or _HEXADECIMAL.match(unit):
        return None
    if unit in SECONDS or unit in HERTZ:
        return _time(text, number, unit, time_unit)
    if unit == "%":
        return f"write {decimal_text(Fraction(number) / 100, DIGITS)}"
    if unit in ("deg", "degree", "degrees", "°"):
        return f'write "{number}*pi/180", in radians'
    return f"write {number}, in the units that the plant is typed in"


def period_of(text: str, time_unit: str) -> Fraction | None:
    """The time of `10 ms`, or of one period at `100 Hz`, in the unit of time; None of anything else."""
    typed = _TYPED.match(text.strip())
    if typed is None or time_unit not in SECONDS:
        return None
    number, unit = Fraction(typed.group(1)), typed.group(2)
    if unit in SECONDS:
        return number * SECONDS[unit] / SECONDS[time_unit]
    return 1 / (number * HERTZ[unit]) / SECONDS[time_unit] if unit in HERTZ and number else None


def _time(text: str, number: str, unit: str, time_unit: str) -> str:
    told = period_of(text, time_unit)
    if told is None:
        return f"write a number, in {time_unit}"
    if unit in HERTZ:
        return f"{number} {unit} is a period of {decimal_text(told, DIGITS)}, in {time_unit}"
    return f"write {decimal_text(told, DIGITS)}: times are in {time_unit}, the time_unit of the plant"
