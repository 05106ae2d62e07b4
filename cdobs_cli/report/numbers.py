"""Numbers for people: the only place where they are shortened.

Bounds are shortened on the safe side: a proved end is never made better by rounding, a refuted end never worse.
"""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal, InvalidOperation

from cdobs_cli.certificate import Bound
from cdobs_cli.exact.numbers import plain_decimal
from cdobs_cli.labels import Labels
from cdobs_cli.run import Departure

NOTHING = "–"


def number_text(value: float | int | str | None, digits: int = 5) -> str:
    """A number to so many significant digits, rounded to nearest; text stays text."""
    if value is None:
        return NOTHING
    if isinstance(value, str):
        return value
    if isinstance(value, bool | int):
        return str(value)
    if math.isnan(value):
        return "not a number"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return _plain(Context(prec=digits, rounding=ROUND_HALF_EVEN).create_decimal(Decimal(float(value))))


def end_text(text: str | None, digits: int, *, up: bool) -> str:
    """A decimal string shortened in the stated direction; `inf` as ∞, what is no number as it is."""
    if text is None:
        return NOTHING
    value = _decimal(text)
    if value is None:
        return text
    if value.is_infinite():
        return "∞" if value > 0 else "−∞"
    return _plain(Context(prec=digits, rounding=ROUND_CEILING if up else ROUND_FLOOR).plus(value))


def margin_text(text: str | None) -> str:
    """A claim's margin, rounded down."""
    return end_text(text, 4, up=False)


def ends_text(bound: Bound) -> tuple[str, str]:
    """Both ends of a bracket, each to its safe side, shortened to two digits beyond those that they share."""
    proved, refuted = float_or_none(bound.proved), float_or_none(bound.refuted)
    digits = 6
    if proved is not None and refuted is not None and math.isfinite(proved) and math.isfinite(refuted):
        gap = abs(proved - refuted) / max(abs(proved), abs(refuted), 1e-300)
        digits = 20 if gap == 0 else max(6, min(20, math.ceil(-math.log10(gap)) + 2))
    less = bound.better == "less"
    return end_text(bound.proved, digits, up=less), end_text(bound.refuted, digits, up=not less)


def bracket_text(bound: Bound) -> str:
    """`[1.713, 1.7131] s`: proved and refuted end."""
    proved, refuted = ends_text(bound)
    return f"[{proved}, {refuted}]{unit_text(bound)}"


def bracket_words(bound: Bound) -> str:
    """`proved up to 1.713 s, fails from 1.7131 s on`; of what is better smaller `proved at most .., reaches ..`."""
    (proved, refuted), unit = ends_text(bound), unit_text(bound)
    less = bound.better == "less"
    told = []
    if bound.proved is not None:
        whole = proved == "∞" and not less
        told.append("proved, however large" if whole else f"proved {'at most' if less else 'up to'} {proved}{unit}")
    if bound.refuted is not None and refuted != "∞":
        told.append(f"reaches {refuted}{unit}" if less else f"fails from {refuted}{unit} on")
    return ", ".join(told) or NOTHING


def unit_text(bound: Bound) -> str:
    """The unit with a space before it, nothing where there is none."""
    return f" {bound.unit}" if bound.unit and bound.unit != "1" else ""


def about_text(bound: Bound) -> str:
    """What a bound is about, in words."""
    words = {"class": "all plants with these slopes", "plant": "the plant as typed"}
    return words.get(bound.about or "", bound.about or NOTHING)


def departure_sentence(departure: Departure, labels: Labels) -> str:
    """`theta leaves the domain at t = 0.31 s: 0.512, allowed -0.5 to 0.5; at most 1.2 beyond it`."""
    time, value, beyond = (number_text(one, 6) for one in (departure.time, departure.value, departure.beyond))
    unit = labels.states.get(departure.what.removeprefix("the estimate of "), "")
    where = f"{value}, allowed {departure.allowed}; at most {beyond} beyond it{unit and f' ({unit})'}"
    return f"{departure.what} leaves the domain at t = {time} {labels.time}: {where}"


def implicit_sentence(implicit: int, runs: int) -> str:
    """`2 of 10 runs are stiff and were integrated with an implicit method (Radau)`."""
    which = "the run is" if runs == 1 else f"{implicit} of {runs} runs {'is' if implicit == 1 else 'are'}"
    were = "was" if implicit == 1 else "were"
    return f"{which} stiff and {were} integrated with an implicit method (Radau)"


def float_or_none(text: str | None) -> float | None:
    """The number of a decimal string (inf allowed); None for what is no number."""
    value = _decimal(text)
    return None if value is None else float(value)


def _decimal(text: str | None) -> Decimal | None:
    try:
        value = None if text is None else Decimal(text)
    except InvalidOperation:
        return None
    return None if value is None or value.is_nan() else value


def _plain(value: Decimal) -> str:
    if value != 0 and not -5 < value.adjusted() < 7:
        return f"{value.normalize():e}".replace("e+", "e").replace("E+", "e").replace("E", "e")
    return plain_decimal(value)
