"""A bound over a region, reduced to bounds over pieces that a search can finish.

Kinks are cut along (`step(g)` with affine g becomes 0 or 1), periodic variables are kept to one period, and
an unbounded variable v that remains is taken as 1/t on its tails. Every piece holds its part of the region,
or more: what is proved on the pieces is proved on the region.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from math import gcd, inf, lcm

from flint import arb

from cdobs_cli.bounds.ranges import Range, range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.exact.expression import ONE, ZERO, Call, Expression, Number, Power, Variable, call, power
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.shapes import Kink, Periodic

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
    argument = next((g for g in map(_kink, function.walk()) if g is not None and _is_affine(g)), None)
    if argument is None or depth == 0:
        yield function, region
        return
    for side, cut in ((1, _cut(region, argument)), (-1, _cut(region, -argument))):
        if cut is not None:
            values = {node: _branch(node, side) for node in function.walk() if _kink(node) == argument}
            yield from _between_kinks(_replaced(function, values), cut, depth - 1)


def _shape(node: Expression) -> Kink | None:
    shape = LANGUAGE[node.function].shape if isinstance(node, Call) else None
    return shape if isinstance(shape, Kink) else None


def _kink(node: Expression) -> Expression | None:
    """The g whose sign decides which branch the node is on."""
    shape = _shape(node)
    return None if shape is None else shape.condition(*node.children)


def _branch(node: Expression, side: int) -> Expression:
    """The node where its g has the given sign."""
    shape = _shape(node)
    assert shape is not None
    return shape.above(*node.children) if side > 0 else shape.below(*node.children)


def _is_affine(g: Expression) -> bool:
    return bool(g.variables) and all(not simplify(g.derivative(name)).variables for name in g.variables)


def _replaced(expression: Expression, values: dict[Expression, Expression]) -> Expression:
    memo: dict[Expression, Expression] = {}
    for node in expression.walk():
        if node in values:
            memo[node] = values[node]
        elif isinstance(node, Power):
            memo[node] = power(memo[node.base], node.exponent)
        elif isinstance(node, Call):
            memo[node] = call(node.function, *(memo[child] for child in node.children))
        else:
            memo[node] = node
    return memo[expression]


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
    outside = _replaced(function, {node: Variable("") for node in rates})
    if not rates or name in outside.variables or 0 in rates.values():
        return None
    # The largest rational of which every rate is a multiple.
    denominator = lcm(*(rate.denominator for rate in rates.values()))
    return Fraction(gcd(*(int(rate * denominator) for rate in rates.values())), denominator)


def _tails(function: Expression, region: Region) -> list[tuple[Expression, Region]]:
    """Each unbounded variable v on [-1, 1] as it is, and as 1/t beyond."""
    names = region.unbounded
    if not names or len(names) > MAX_TAILS:
        return [(function, region)]
    parts = [(function, region)]
    for name in names:
        parts = [made for smooth, part in parts for made in _folded(smooth, part, name)]
    return parts


def _folded(function: Expression, region: Region, name: str) -> list[tuple[Expression, Region]]:
    ends = region.box[name]
    low = Fraction(ends.lower) if ends.lower != -inf else min(Fraction(-1), -1 + (Fraction(ends.upper) if ends.upper != inf else 0))
    high = Fraction(ends.upper) if ends.upper != inf else max(Fraction(1), 1 + low)
    if any(isinstance(node, Call) and node.function == "exp" for node in function.walk()):
        low, high = (low * 8 if ends.lower == -inf else low), (high * 8 if ends.upper == inf else high)
    inverted = simplify(function.substitute({name: ONE / Variable(name)}))
    outside = replace(region, relaxed=True)
    made = [(function, _freed(region, name, Range(low, high)))]
    if ends.upper == inf:
        made.append(_decaying(inverted, _freed(outside, name, Range(Fraction(0), 1 / high))))
    if ends.lower == -inf:
        made.append(_decaying(inverted, _freed(outside, name, Range(1 / low, Fraction(0)))))
    return made


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
    values: dict[Expression, Expression] = {node: Variable(name) / power(-node.children[0], Fraction(3)) for node, name in names.items()}
    return simplify(_replaced(function, values)), replace(
        region, box={**region.box, **{name: Range(Fraction(0), most) for name in names.values()}}
    )
