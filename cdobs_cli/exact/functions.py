"""Balls of numbers, of powers, and of every function of the language."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import reduce
from itertools import product
from math import inf

from flint import arb, fmpq

import cdobs_cli.exact.precision  # noqa: F401 - sets the working precision
from cdobs_cli.exact.expression import Constant, Expression, Number
from cdobs_cli.exact.language import LANGUAGE, Function
from cdobs_cli.exact.shapes import Cornered, Monotone, Periodic

Ball = Callable[..., arb]
_EXACT_ROOTS = 64  # larger ones are taken through the logarithm


def fraction_ball(value: Fraction) -> arb:
    """The tightest ball round a rational at the working precision."""
    return arb(fmpq(value.numerator, value.denominator))


def exact_ball(node: Expression) -> arb:
    """The ball of a number or a constant."""
    if isinstance(node, Number):
        return fraction_ball(node.value)
    assert isinstance(node, Constant)
    return arb.pi() if node.name == "pi" else arb.const_e()


def hull(low: arb, high: arb) -> arb:
    """The ball that holds [low, high]."""
    return low.union(high)


def power_ball(base: arb, exponent: Fraction) -> arb:
    """base ** exponent; with a root only for base >= 0, and base > 0 where exponent < 0."""
    if exponent < 0:
        return 1 / power_ball(base, -exponent)
    if exponent.denominator > 1:
        return _between(lambda x: _root_power(x, exponent), base, base.lower(), base.upper())
    count = exponent.numerator
    if count % 2 == 0:
        return hull(base.abs_lower() ** count, base.abs_upper() ** count)
    return hull(base.lower() ** count, base.upper() ** count)


def _root_power(base: arb, exponent: Fraction) -> arb:
    """At a point."""
    if not base > 0:
        return arb(0) if base.is_zero() else arb.nan()
    if exponent.denominator <= _EXACT_ROOTS:
        return base.root(exponent.denominator) ** exponent.numerator
    return (base.log() * fraction_ball(exponent)).exp()


def _between(function: Ball, x: arb, low: arb, high: arb) -> arb:
    """Enclosure by the ends: far tighter than the midpoint rule on wide balls, and not finite outside the domain."""
    if x.is_nan():
        return x
    return function(x) if x.is_exact() else hull(function(low), function(high))


def _monotone(function: Ball, shape: Monotone) -> Ball:
    if shape.even:
        return lambda x: _between(function, x, x.abs_lower(), x.abs_upper())
    return lambda x: _between(function, x, x.lower(), x.upper())


def _periodic(function: Ball, shape: Periodic) -> Ball:
    if shape.top == inf:
        return function
    image = hull(arb(float(shape.bottom)), arb(float(shape.top)))

    def ball(x: arb) -> arb:
        value = function(x)
        if x.is_nan() or image.contains(value):
            return value
        return value.intersection(image) if value.is_finite() else image

    return ball


def _cornered(function: Function, shape: Cornered) -> Ball:
    names, at_corner = [str(slot) for slot in function.slots], point_ball(function)
    inside = shape.inside(*function.slots)

    def ball(*arguments: arb) -> arb:
        if not inside.ball(dict(zip(names, arguments, strict=True))) > 0:
            return arb.nan()
        corners = product(*((x.lower(), x.upper()) for x in arguments))
        return reduce(hull, (at_corner(*corner) for corner in corners))

    return ball


def point_ball(function: Function) -> Ball:
    """Its value at points."""
    assert function.ball is not None
    return function.ball


def _jump(above: Number, below: Number) -> Ball:
    """At the jump both sides and what lies between, which holds the Clarke gradient."""
    high, low = exact_ball(above), exact_ball(below)
    return lambda x: high if x > 0 else low if x < 0 else hull(low, high)


def _ball(function: Function) -> Ball:
    match function.shape:
        case Monotone() as shape:
            return _monotone(point_ball(function), shape)
        case Periodic() as shape:
            return _periodic(point_ball(function), shape)
        case Cornered() as shape:
            return _cornered(function, shape)
    jump = function.jump
    return point_ball(function) if jump is None else _jump(*jump)


BALL_FUNCTIONS: dict[str, Ball] = {name: _ball(function) for name, function in LANGUAGE.items()}
