"""A bound over a region, reduced to bounds over pieces that a search can finish.

Kinks are cut along (`step(g)` with affine g becomes 0 or 1), periodic variables are kept to one period, and
an unbounded variable v that remains is taken as 1/t on its tails. Every piece holds its part of the region,
or more: what is proved on the pieces is proved on the region.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from math import gcd, inf, lcm

from flint import arb

from cdobs_cli.bounds.ranges import Range, range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.exact.expression import ONE, ZERO, Call, Expression, Number, Variable, power
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.shapes import Kink, Periodic
from cdobs_cli.records import dataclass

MAX_KINKS = 5
MAX_TAILS = 3


@dataclass(frozen=True)
class Piece:
    """A function over a region, in one or more equivalent forms."""

    forms: tuple[Expression, ...]
    region: Region


def pieces(function: Expression, region: Region) -> Iterator[Piece]:
    """The pieces of `function` over `region`."""
    for smooth, part in _between_kinks(function, region):
        short = simplify(smooth)
        for tail, held in _tails(short, _one_period(short, part)):
            forms = (smooth, short) if tail is short and short != smooth else (tail,)
            yield Piece(forms, held)


def _between_kinks(function: Expression, region: Region, depth: int = MAX_KINKS) -> Iterator[tuple[Expression, Region]]:
    """Parts on which no affine g changes sign inside sign, step, abs, min or max."""
    shapes = ((node, _kink(node)) for node in function.walk())
    kinks = {node: (kink, kink.condition(*node.children)) for node, kink in shapes if kink is not None}
    g = next((g for _, g in kinks.values() if _is_affine(g)), None)
    if g is None or depth == 0:
        yield function, region
        return
    for side, cut in ((1, _cut(region, g)), (-1, _cut(region, -g))):
        if cut is not None:
            chosen = {node: kink.above if side > 0 else kink.below for node, (kink, own) in kinks.items() if own == g}
            branches = {node: branch(*node.children) for node, branch in chosen.items()}
            yield from _between_kinks(function.replaced(branches), cut, depth - 1)


def _kink(node: Expression) -> Kink | None:
    shape = LANGUAGE[node.function].shape if isinstance(node, Call) else None
    return shape if isinstance(shape, Kink) else None


def _is_affine(g: Expression) -> bool:
    return bool(g.variables) and all(not simplify(g.derivative(name)).variables for name in g.variables)


def _cut(region: Region, g: Expression) -> Region | None:
    """The part of the region where g >= 0; None where that is seen to be empty."""
    names = sorted(g.variables)
    if len(names) > 1:
        return replace(region, where=(*region.where, g))
    (name,) = names
    slope, offset = simplify(g.derivative(name)), simplify(g.substitute({name: ZERO}))
    if not isinstance(slope, Number) or not isinstance(offset, Number) or slope.value == 0:
        return replace(region, where=(*region.where, g))
    root, ends = -offset.value / slope.value, region.box[name]
    cut = Range(max(ends.lower, root), ends.upper) if slope.value > 0 else Range(ends.lower, min(ends.upper, root))
    if cut.lower > cut.upper or (cut.is_point and not ends.is_point):
        return None
    return replace(region, box={**region.box, name: cut})


def _one_period(function: Expression, region: Region) -> Region:
    """The region with each periodic unbounded variable kept to one period, 2 pi / a."""
    for name in region.unbounded:
        if name not in function.variables:
            region = _freed(region, name, Range.point(0))
            continue
        rate = _rate(function, name)
        if rate is not None:
            period = Range.of_ball(2 * arb.pi() / fraction_ball(rate)).upper
            region = _freed(region, name, Range(Fraction(0), period))
    return region


def _freed(region: Region, name: str, ends: Range) -> Region:
    """The region with another range for one variable, and without the limits that tie it to others."""
    kept = tuple(w for w in region.where if name not in w.variables)
    relaxed = region.relaxed or len(kept) < len(region.where) or name in region.ends
    return replace(region, box={**region.box, name: ends}, where=kept, relaxed=relaxed)


def _rate(function: Expression, name: str) -> Fraction | None:
    """a > 0 such that the function has the period 2 pi / a in `name`; None where none is seen."""
    rates: dict[Expression, Fraction] = {}
    for node in function.walk():
        if isinstance(node, Call) and isinstance(LANGUAGE[node.function].shape, Periodic) and name in node.variables:
            rate = simplify(node.children[0].derivative(name))
            if isinstance(rate, Number):
                rates[node] = abs(rate.value)
    outside = function.replaced({node: Variable("") for node in rates})
    if not rates or name in outside.variables or 0 in rates.values():
        return None
    # The largest rational of which every rate is a multiple.
    denominator = lcm(*(rate.denominator for rate in rates.values()))
    return Fraction(gcd(*(int(rate * denominator) for rate in rates.values())), denominator)


def _tails(function: Expression, region: Region) -> list[tuple[Expression, Region]]:
    """Each unbounded variable v on [-1, 1] as it is, and as 1/t beyond."""
    parts = [(function, region)]
    for name in region.unbounded if len(region.unbounded) <= MAX_TAILS else ():
        parts = [made for smooth, part in parts for made in _folded(smooth, part, name)]
    return parts


def _folded(function: Expression, region: Region, name: str) -> Iterator[tuple[Expression, Region]]:
    ends = region.box[name]
    # Where an exponential is about its tails begin further out.
    far = 8 if any(isinstance(node, Call) and node.function == "exp" for node in function.walk()) else 1
    low = min(Fraction(-1), -1 + (Fraction(ends.upper) if ends.upper != inf else 0))
    low = low if ends.lower == -inf else Fraction(ends.lower)
    high = max(Fraction(1), 1 + low) if ends.upper == inf else Fraction(ends.upper)
    low, high = (far * low if ends.lower == -inf else low), (far * high if ends.upper == inf else high)
    inverted = simplify(function.substitute({name: ONE / Variable(name)}))
    outside = replace(region, relaxed=True)
    yield function, _freed(region, name, Range(low, high))
    if ends.upper == inf:
        yield _decaying(inverted, _freed(outside, name, Range(Fraction(0), 1 / high)))
    if ends.lower == -inf:
        yield _decaying(inverted, _freed(outside, name, Range(1 / low, Fraction(0))))


def _decaying(function: Expression, region: Region) -> tuple[Expression, Region]:
    """exp(h) with h < 0 written as theta / (-h)^3, theta in [0, (3/e)^3]: a decay that cancels poles.

    theta = (-h)^3 exp(h) is largest at h = -3.
    """
    decays = [
        node for node in function.walk()
        if isinstance(node, Call) and node.function == "exp" and range_of(node.children[0], region.box).upper < 0
    ]  # fmt: skip
    if not decays:
        return function, region
    most = Range.of_ball((3 / arb.const_e()) ** 3).upper
    names = {node: f"exp.{k}" for k, node in enumerate(decays)}
    box = region.box | {name: Range(Fraction(0), most) for name in names.values()}
    values: dict[Expression, Expression] = {}
    values |= {node: Variable(name) / power(-node.children[0], Fraction(3)) for node, name in names.items()}
    return simplify(function.replaced(values)), replace(region, box=box)
