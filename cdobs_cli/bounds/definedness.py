"""Is the typed phi defined all over the domain? Judged on the typed tree, before anything cancels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

from cdobs_cli.bounds.bounded import TRIAL, bounded, least_bound
from cdobs_cli.bounds.points import high_points
from cdobs_cli.bounds.ranges import Range, range_of
from cdobs_cli.bounds.region import Region, point_text
from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.exact.expression import Call, Expression, Power
from cdobs_cli.exact.language import LANGUAGE, Need
from cdobs_cli.exact.numbers import Exact

_SIGNS: dict[Need, str] = {"nonzero": "!= 0", "positive": "> 0", "nonnegative": ">= 0"}


@dataclass(frozen=True)
class Definedness:
    """What became of one expression: the condition that is open or fails, and a point where it fails."""

    status: Status
    condition: str | None = None
    point: Mapping[str, Fraction] | None = None


def conditions(expression: Expression) -> Iterator[tuple[Expression, Need]]:
    """What must hold for the typed expression to have a value."""
    for node in expression.walk():
        if isinstance(node, Power):
            if node.exponent.denominator > 1:
                yield node.base, "positive" if node.exponent < 0 else "nonnegative"
            elif node.exponent < 0:
                yield node.base, "nonzero"
        elif isinstance(node, Call):
            yield from LANGUAGE[node.function].conditions(*node.children)


def defined(expression: Expression, region: Region) -> Definedness:
    """Whether the expression has a value at every point of the region."""
    open_condition = None
    for g, need in dict.fromkeys(conditions(expression)):
        status, point = _holds(g, need, region)
        if status == "refuted":
            return Definedness("refuted", f"{g} {_SIGNS[need]}", point)
        if status == "undecided":
            open_condition = open_condition or f"{g} {_SIGNS[need]}"
    return Definedness("undecided", open_condition) if open_condition else Definedness("proved")


def _holds(g: Expression, need: Need, region: Region) -> tuple[Status, Mapping[str, Fraction] | None]:
    own = range_of(g, region.box)
    if own.lower > 0 or (need == "nonnegative" and own.lower >= 0) or (need == "nonzero" and own.upper < 0):
        return "proved", None
    low, low_at = _least(g, region)
    if low is None or low_at is None:
        return "undecided", None
    if need == "nonnegative":
        if low.upper < 0:
            return "refuted", low_at
        return bounded(-g, region, Exact(0), TRIAL).status, None
    if need == "positive" or low.lower > 0:
        return ("refuted", low_at) if low.upper <= 0 else _positive(g, low, region)
    if low.is_point and low.lower == 0:
        return "refuted", low_at
    high, high_at = _least(-g, region)
    if high is None or high_at is None:
        return "undecided", None
    if high.is_point and high.lower == 0:
        return "refuted", high_at
    if low.upper < 0 and high.upper < 0:
        # Both signs occur, and the region is convex: g vanishes in between.
        return "refuted", _zero_between(g, low_at, high_at)
    return _positive(-g, high, region) if low.upper < 0 else ("undecided", None)


def _positive(g: Expression, least: Range, region: Region) -> tuple[Status, None]:
    """g >= part of the least value met, hence g > 0."""
    for part in (Fraction(1, 2), Fraction(1, 100)):
        limit = -part * Fraction(least.lower)
        if limit < 0 and bounded(-g, region, Exact(limit), TRIAL).status == "proved":
            return "proved", None
    return "undecided", None


def _least(g: Expression, region: Region) -> tuple[Range | None, Mapping[str, Fraction] | None]:
    """The least value met at points of the region."""
    best, at = None, None
    for point in _with_round_ones(high_points(-g, region)):
        if region.holds(point):
            value = range_of(g, {name: Range.point(end) for name, end in point.items()})
            if value.is_finite and (best is None or value.upper < best.upper):
                best, at = value, point
    return best, at


def _with_round_ones(points: Iterable[Mapping[str, Fraction]]) -> Iterator[Mapping[str, Fraction]]:
    """Each point, and what it is to two decimals: zeros that g only touches lie there."""
    for point in points:
        yield point
        yield {name: round(at, 2) for name, at in point.items()}


def _zero_between(g: Expression, a: Mapping[str, Fraction], b: Mapping[str, Fraction]) -> Mapping[str, Fraction]:
    """A point next to a zero of g on the segment from a to b (the zero itself where bisection meets it)."""

    def along(t: Fraction) -> dict[str, Fraction]:
        return {name: a[name] + t * (b[name] - a[name]) for name in a}

    low, high = Fraction(0), Fraction(1)
    for _ in range(40):
        middle = (low + high) / 2
        value = range_of(g, {name: Range.point(end) for name, end in along(middle).items()})
        if value.is_point and value.lower == 0:
            return along(middle)
        low, high = (middle, high) if value.upper < 0 else (low, middle)
    return along(low)


def bounded_away(g: Expression, region: Region) -> tuple[Status, Fraction | None, Mapping[str, Fraction] | None]:
    """Whether |g| >= some c > 0 over the region; c, or a point next to which g is 0."""
    status, point = _holds(g, "nonzero", region)
    if status != "proved":
        return status, None, point
    for side in (g, -g):
        low = least_bound(-side, region)
        if low is not None and Fraction(low) < 0:
            return "proved", -Fraction(low), None
    # Not zero, but not seen to stay away from it: 1/g has no bound then.
    return "undecided", None, None


def defined_claim(found: tuple[Definedness, ...], region: Region, what: str = "phi") -> Claim:
    """The required premise `defined`: every component has a value all over the domain."""
    worst = next((one for s in ("refuted", "undecided") for one in found if one.status == s), Definedness("proved"))
    text = f"{what} is defined for {region.text()}"
    if worst.status == "refuted":
        text += f": {worst.condition} fails"
    elif worst.status == "undecided":
        text += f": {worst.condition} could not be decided"
    witness = Witness("point", "plant", data={"point": point_text(worst.point)}) if worst.point else None
    return Claim(
        "defined", "premise", worst.status, text, "cdobs, the typed expression", required=True, method="branch and bound",
        witness=witness,
    )  # fmt: skip
