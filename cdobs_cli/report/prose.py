"""Names and signs inside sentences and labels, set like those of the formulas: `omega_m <= rho^2` is ω_m ≤ ρ²."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape

from cdobs_cli.report.equations import GREEK, Digits, Formula, Operator, Row, Script, latex, mathml, name_formula

_GREEK = "|".join(sorted(GREEK, key=len, reverse=True))
_INDEX = r"(?:_?\d+|(?:_[A-Za-z0-9]+)+)"
_POWER = r"\^(?:\((?P<powers>-?\w+)\)|(?P<power>-?\w+))"
# A Greek letter, or a letter with an index or a power; what stands in backticks, a path or a dotted id stays.
_TOKEN = re.compile(
    r"`[^`]*`|(?:\bd |∂)(?P<above>[A-Za-z]\w*|φ\d+) ?/ ?(?:d |∂)(?P<below>[A-Za-z]\w*)"
    rf"|(?<![\w.`\'/\\^-])(?:(?P<name>(?:{_GREEK}){_INDEX}?|[A-Za-z]{_INDEX})(?:{_POWER})?"
    rf"|(?P<letter>[A-Za-z]){_POWER.replace('powers', 'raised').replace('power>', 'lifted>')})(?![\w^]|\.\w)"
)
_DERIVATIVE = re.compile(r"\bd ([A-Za-z]\w*) / d ([A-Za-z]\w*)")
_NAME = re.compile(rf"(?<![A-Za-z])(?:{_GREEK})(?![A-Za-z])")
_SIGNS = {"<=": "≤", ">=": "≥", "->": "→", " * ": " · "}
_SIGN = re.compile(r"`[^`]*`|<=|>=|->| \* |\*\*[23](?![\d.])")


def html(text: str) -> str:
    """The text for a page: its names as formulas, what stands in backticks as code."""
    told = "".join(
        escape(_signs(piece)) if isinstance(piece, str) else f"<math>{mathml(piece)}</math>" for piece in _pieces(text)
    )
    return re.sub("`([^`<]+)`", r"<code>\1</code>", told)


def plain(text: str) -> str:
    """The text with Greek letters and signs as characters; indices stay as they are typed."""

    def greek(match: re.Match[str]) -> str:
        return match[0] if match[0].startswith("`") else _NAME.sub(lambda name: GREEK[name[0]], match[0])

    return _signs(_TOKEN.sub(greek, _DERIVATIVE.sub(r"∂\1/∂\2", text)))


def mathtext(label: str) -> str:
    """A label of a figure: its names between dollars; what has dollars already, and a unit at the end, stay."""
    head, bracket, unit = label.rpartition(" (")
    if not (bracket and unit.endswith(")")):
        head, bracket, unit = label, "", ""
    told = []
    for index, part in enumerate(head.split("$")):
        pieces = [part] if index % 2 else _pieces(part)
        told.append("".join(one if isinstance(one, str) else f"${latex(one)}$" for one in pieces))
    return f"{'$'.join(told)}{bracket}{unit}"


def _pieces(text: str) -> Iterator[str | Formula]:
    """The text in order, with a formula in the place of each name."""
    end = 0
    for match in _TOKEN.finditer(text):
        if match["above"] is not None:
            yield text[end : match.start()]
            above, below = (Row((Operator("∂"), name_formula(match[one]))) for one in ("above", "below"))
            yield Row((*above.parts, Operator("/"), *below.parts))
            end = match.end()
            continue
        name = match["name"] or match["letter"]
        if name is None:
            continue
        yield text[end : match.start()]
        power = next((match[one] for one in ("power", "powers", "lifted", "raised") if match[one]), None)
        yield _raised(name_formula(name), power)
        end = match.end()
    yield text[end:]


def _raised(base: Formula, power: str | None) -> Formula:
    if power is None:
        return base
    above = Digits(power)
    if isinstance(base, Script) and base.above is None:
        return Script(base.base, base.below, above)
    return Script(base, None, above)


def _signs(text: str) -> str:
    """Signs as characters; what stands in backticks stays."""
    return _SIGN.sub(lambda match: _SIGNS.get(match[0]) or _square(match[0]), text)


def _square(text: str) -> str:
    return text if text.startswith("`") else "²" if text.endswith("2") else "³"
