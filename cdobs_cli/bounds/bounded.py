"""f <= c over a region, whatever its shape; and the least c for which that is proved."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from math import ceil, inf, isfinite, log10
from typing import TYPE_CHECKING

from cdobs_cli.bounds.points import high_points, largest_met
from cdobs_cli.bounds.ranges import Point, Range, known_range, value_at
from cdobs_cli.bounds.region import Content, Region
from cdobs_cli.exact.budget import forgotten
from cdobs_cli.exact.expression import Call, Expression, Power
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.numbers import Exact, fraction_text, upper_text

if TYPE_CHECKING:
    from cdobs_cli.bounds.supremum import Bounded

# Work of one search: nodes of the expression times boxes.
FULL = 6_000_000
TRIAL = 400_000
# No bound beyond this is of use.
LARGEST = Fraction(10) ** 100
_SHORT = 8


def bounded(function: Expression, region: Region, limit: Exact, work: int) -> Bounded:
    """Decide function <= limit over the region; the pieces share the work."""
    return _bounded(function, region.content, limit, work)


# What is found by one stage is asked again by the next, over the same region.
@lru_cache(256)
def _bounded(function: Expression, content: Content, limit: Exact, work: int) -> Bounded:
    from cdobs_cli.bounds import supremum
    from cdobs_cli.bounds.reduction import pieces

    region = Region.of_content(content)
    parts = list(pieces(function, region))
    judged = []
    for piece in parts:
        n, size = len(piece.region.names), sum(map(_size, piece.forms))
        cost = size * (1 + n) + 4 * len(piece.region.where) * n * (n + 2)
        judged.append(
            supremum.supremum(piece.forms, piece.region, limit, max(4 * supremum.ROUND, work // (cost * len(parts))))
        )
        if judged[-1].point is not None:
            return judged[-1]
    left = [one for one in judged if one.status != "proved"]
    box = next((one.box for one in left if one.box), None)
    value = max((one.value for one in judged), default=-inf)
    return supremum.Bounded("undecided" if left else "proved", value, None, box)


forgotten(_bounded.cache_clear)


def _size(expression: Expression) -> int:
    """Nodes, those weighted that are taken from balls, point by point."""
    nodes = list(expression.walk())
    slow = sum(1 for node in nodes if isinstance(node, Call) and LANGUAGE[node.function].is_slow)
    slow += sum(1 for node in nodes if isinstance(node, Power) and node.exponent.denominator > 2)
    return len(nodes) + 10 * slow


def least_bound(function: Expression, region: Region, tolerance: float = 0.002, work: int = FULL) -> str | None:
    """A short decimal c, close to the supremum, for which function <= c is proved; None where there is none.

    Tried in turn: the end of the function's own range and the largest value met at a point, where these are
    short decimals (suprema that are attained come out exactly); then that value and a part `tolerance` of the
    width. Where the work does not suffice for that, the bound that was reached.
    """
    own = known_range(function, region.box)
    best, lowest = (_highest(side, region.content) for side in (function, -function))
    if best is None or abs(met := Fraction(best[0].lower)) > LARGEST:
        return None
    width = 0.0 if lowest is None else float(met + min(Fraction(lowest[0].lower), LARGEST))
    close = Fraction(max(width, 1e-9 * abs(float(met)))) / 1000
    if isinstance(own.upper, Fraction) and _is_short(own.upper) and own.upper - met <= close:
        return fraction_text(own.upper)
    room = max(tolerance * width, 1e-9 * abs(float(met)), 1e-12)
    if best[0].is_point and _is_short(met):
        found = bounded(function, region, Exact(met), min(TRIAL, work))
        if found.status == "proved":
            return fraction_text(met)
        if found.value <= float(met) + room:
            return _above(Fraction(found.value), room)
    if region.unbounded and bounded(function, region, Exact(_above(2 * abs(met), 1)), TRIAL).value == inf:
        return None
    for _ in range(12):
        limit = _above(met + Fraction(room) / 2, room)
        found = bounded(function, region, Exact(limit), work)
        if found.status == "proved":
            return limit
        if found.point is None:
            return _above(Fraction(found.value), room) if isfinite(found.value) else None
        higher = value_at(function, found.point).lower
        if isinstance(higher, Fraction):
            met = max(met, higher)
    return None


@lru_cache(256)  # |f| is bounded from either side
def _highest(function: Expression, content: Content) -> tuple[Range, Point] | None:
    """The largest value met."""
    region = Region.of_content(content)
    return largest_met(function, region, high_points(function, region))


forgotten(_highest.cache_clear)


def _is_short(value: Fraction) -> bool:
    text = fraction_text(value)
    return "/" not in text and len(text) <= _SHORT


def _above(value: Fraction, room: float) -> str:
    """The value rounded up to as few digits as a tenth of the room allows."""
    size = abs(float(value))
    digits = 3 if size <= room else max(3, min(17, 2 + ceil(log10(size / room))))
    return upper_text(fraction_ball(value), digits)
