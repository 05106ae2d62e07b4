"""Is the typed phi defined all over the domain? Judged on the typed tree, before anything cancels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction

from cdobs_cli.bounds.bounded import TRIAL, bounded, least_bound
from cdobs_cli.bounds.points import high_points, largest_met
from cdobs_cli.bounds.ranges import ZERO_POINT, Point, Range, range_of, value_at
from cdobs_cli.bounds.region import Region, point_witness
from cdobs_cli.certificate import Claim, Status
from cdobs_cli.exact.expression import Call, Expression, Power
from cdobs_cli.exact.language import LANGUAGE, Need
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.records import dataclass

_SIGNS: dict[Need, str] = {"nonzero": "!= 0", "positive": "> 0", "nonnegative": ">= 0"}


@dataclass(frozen=True)
class Definedness:
    """What became of one expression: the condition that is open or fails, and a point where it fails."""

    status: Status
    condition: str | None = None
    point: Point | None = None


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


def is_total(expression: Expression) -> bool:
    """Whether nothing in its form could be undefined."""
    return next(conditions(expression), None) is None


def _holds(g: Expression, need: Need, region: Region) -> tuple[Status, Point | None]:
    own = range_of(g, region.box)
    if own.lower > 0 or (need == "nonnegative" and own.lower >= 0) or (need == "nonzero" and own.upper < 0):
        return "proved", None
    least = _least(g, region)
    if least is None:
        return "undecided", None
    low, low_at = least
    if need == "nonnegative":
        return ("refuted", low_at) if low.upper < 0 else (bounded(-g, region, EXACT_ZERO, TRIAL).status, None)
    if need == "positive" or low.lower > 0:
        return ("refuted", low_at) if low.upper <= 0 else (_positive(g, low, region), None)
    if low == ZERO_POINT:
        return "refuted", low_at
    highest = _least(-g, region)
    if highest is None:
        return "undecided", None
    high, high_at = highest
    if high == ZERO_POINT:
        return "refuted", high_at
    if low.upper < 0 and high.upper < 0:
        # Both signs occur, and the region is convex: g vanishes in between.
        return "refuted", _zero_between(g, low_at, high_at)
    return _positive(-g, high, region) if low.upper < 0 else "undecided", None


def _positive(g: Expression, least: Range, region: Region) -> Status:
    """g >= part of the least value met, hence g > 0."""
    limits = (Exact(-part * Fraction(least.lower)) for part in (Fraction(1, 2), Fraction(1, 100)))
    held = (limit.sign() == -1 and bounded(-g, region, limit, TRIAL).status == "proved" for limit in limits)
    return "proved" if any(held) else "undecided"


def _least(g: Expression, region: Region) -> tuple[Range, Point] | None:
    """The least value met at points of the region."""
    met = largest_met(-g, region, _with_round_ones(high_points(-g, region)))
    return None if met is None else (-met[0], met[1])


def _with_round_ones(points: Iterable[Point]) -> Iterator[Point]:
    """Each point, and what it is to two decimals: zeros that g only touches lie there."""
    for point in points:
        yield point
        yield {name: round(at, 2) for name, at in point.items()}


def _zero_between(g: Expression, a: Point, b: Point) -> Point:
    """A point next to a zero of g on the segment from a to b (the zero itself where bisection meets it)."""

    def along(t: Fraction) -> dict[str, Fraction]:
        return {name: a[name] + t * (b[name] - a[name]) for name in a}

    low, high = Fraction(0), Fraction(1)
    for _ in range(40):
        middle = (low + high) / 2
        value = value_at(g, along(middle))
        if value == ZERO_POINT:
            return along(middle)
        low, high = (middle, high) if value.upper < 0 else (low, middle)
    return along(low)


def bounded_away(g: Expression, region: Region) -> tuple[Status, Fraction | None, Point | None]:
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
    left = {"proved": "", "refuted": f": {worst.condition} fails"}
    open_one = f": {worst.condition} could not be decided"
    return Claim(
        "defined", "premise", worst.status, f"{what} defined for {region.text()}{left.get(worst.status, open_one)}",
        "cdobs, the typed expression", required=True, method="branch and bound", witness=point_witness(worst.point),
    )  # fmt: skip
