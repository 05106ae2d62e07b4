"""f <= c over a region, whatever its shape; and the least c for which that is proved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, inf, isfinite, log10
from typing import Literal

from flint import arb

from cdobs_cli.certify.points import high_points, point_balls
from cdobs_cli.certify.reduction import pieces
from cdobs_cli.certify.region import Region
from cdobs_cli.certify.supremum import supremum
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, arb_fraction, fraction_text, upper_text
from cdobs_cli.exact.ranges import Range, range_of

# Work of one search: nodes of the expression times boxes.
FULL = 6_000_000
TRIAL = 400_000
_SHORT = 8
TOLERANCES = (0.002, 0.008, 0.05, 0.5)


@dataclass(frozen=True)
class Bounded:
    """f <= value was proved (inf: nothing). `point` is a point where f seems to exceed c; `box` what is left."""

    status: Literal["proved", "undecided"]
    value: float
    point: Mapping[str, Fraction] | None = None
    box: Mapping[str, tuple[float, float]] | None = None


def bounded(function: Expression, region: Region, limit: Exact, work: int) -> Bounded:
    """Decide function <= limit over the region."""
    value, status = -inf, True
    point, box = None, None
    for piece in pieces(function, region):
        size = sum(sum(1 for _ in form.walk()) for form in piece.forms)
        if all(range_of(form, piece.region.box).upper == -inf for form in piece.forms):
            continue
        found = supremum(piece.forms, piece.region, limit, max(64, work // (size * (1 + len(region.names)))))
        value = max(value, found.bound)
        if found.status != "proved":
            status = False
            point = point or found.point
            box = box or found.box
            if found.status == "exceeded":
                return Bounded("undecided", inf, found.point)
    return Bounded("proved" if status else "undecided", value, point, box)


def least_bound(function: Expression, region: Region, tolerances: tuple[float, ...] = TOLERANCES, work: int = FULL) -> str | None:
    """A short decimal c, close to the supremum, for which function <= c is proved; None where there is none.

    Tried in turn: the end of the function's own range and the largest value met at a point, where these are
    short decimals (suprema that are attained come out exactly); then that value and a small part of the width,
    one of `tolerances` after the other.
    """
    own = range_of(function, region.box)
    met, attained = _largest(function, region)
    if met is None:
        return None
    lowest, _ = _largest(-function, region)
    width = float(met + lowest) if lowest is not None else 0.0
    if isinstance(own.upper, Fraction) and _is_short(own.upper) and own.upper - met <= Fraction(max(width, 1e-9 * abs(float(met)))) / 1000:
        return fraction_text(own.upper)
    if attained and _is_short(met):
        found = bounded(function, region, Exact(met), min(TRIAL, work) // 8)
        if found.status == "proved":
            return fraction_text(met)
        room = max(tolerances[0] * width, 1e-12)
        if found.value <= float(met) + room:
            return _above(Fraction(found.value), room)
    if region.unbounded and bounded(function, region, Exact(_above(2 * abs(met), 1)), TRIAL).value == inf:
        return None
    for tolerance in tolerances:
        room = max(tolerance * width, 1e-9 * abs(float(met)), 1e-12)
        for _ in range(3):
            limit = _above(met + Fraction(room) / 2, room)
            found = bounded(function, region, Exact(limit), work)
            if found.status == "proved":
                return limit
            if found.point is None:
                break
            met = max(met, _value(function, found.point) or met)
        if isfinite(found.value) and found.value <= float(met) + 10 * room:
            return _above(Fraction(found.value), room)
    return upper_text(arb(found.value), 6) if isfinite(found.value) else None


def _is_short(value: Fraction) -> bool:
    text = fraction_text(value)
    return "/" not in text and len(text) <= _SHORT


def _above(value: Fraction, room: float) -> str:
    """The value rounded up to as few digits as a tenth of the room allows."""
    size = abs(float(value))
    digits = 3 if size <= room else max(3, min(17, 2 + ceil(log10(size / room))))
    return upper_text(fraction_ball(value), digits)


def _value(function: Expression, point: Mapping[str, Fraction]) -> Fraction | None:
    ball = function.ball(point_balls(point))
    return arb_fraction(ball.lower()) if ball.is_finite() else None


def _largest(function: Expression, region: Region) -> tuple[Fraction | None, bool]:
    """The largest value met at points of the region, and whether it is the exact value there."""
    best: Fraction | None = None
    exact = False
    for point in high_points(function, region):
        if not region.holds(point):
            continue
        value = range_of(function, {name: Range.point(at) for name, at in point.items()})
        if isinstance(value.lower, Fraction) and (best is None or value.lower > best):
            best, exact = value.lower, value.is_point
    return best, exact
