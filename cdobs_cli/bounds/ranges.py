"""Ranges of an expression over a box whose ends are exact: rationals, or infinite.

Sums, products, quotients and integer powers of rationals are exact; a transcendental end is the dyadic
outside of its ball. So a supremum that belongs to the functions (cos <= 1, 0 <= 1 - tanh^2 <= 1) comes out
as the very number, and `1 - 0.3 cos(x) <= 1.3` is decided where floats or balls would touch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import reduce
from itertools import product
from math import ceil, floor, inf

from flint import arb

from cdobs_cli.exact.expression import Expression, Number, Variable
from cdobs_cli.exact.functions import exact_ball, fraction_ball, point_ball, power_ball
from cdobs_cli.exact.language import LANGUAGE, Function
from cdobs_cli.exact.numbers import clipped
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.shapes import Cornered, End, Monotone, Periodic
from cdobs_cli.records import dataclass

Point = Mapping[str, Fraction]
_MAX_BITS = 1200
_KEPT_BITS = 400


@dataclass(frozen=True, slots=True)
class Range:
    """[lower, upper]; the whole line also stands for a value that may be undefined."""

    lower: End
    upper: End

    @staticmethod
    def point(value: Fraction | int) -> Range:
        return Range(Fraction(value), Fraction(value))

    @staticmethod
    def of_ball(ball: arb) -> Range:
        """The dyadic ends of a ball, or the whole line."""
        if not ball.is_finite():
            return LINE
        low, high = clipped(ball.lower(), up=False), clipped(ball.upper(), up=True)
        return Range(-inf if low is None else low, inf if high is None else high)

    @property
    def is_point(self) -> bool:
        return self.lower == self.upper

    @property
    def is_finite(self) -> bool:
        return -inf < self.lower and self.upper < inf

    def __contains__(self, value: Fraction | int) -> bool:
        return self.lower <= value <= self.upper

    def __neg__(self) -> Range:
        return Range(-self.upper, -self.lower)

    def hull(self, other: Range) -> Range:
        return Range(min(self.lower, other.lower), max(self.upper, other.upper))


LINE, ZERO_POINT = Range(-inf, inf), Range.point(0)


def _short(value: Range) -> Range:
    """Ends cut to a bounded length, outwards."""

    def cut(end: End, up: bool) -> End:
        if not isinstance(end, Fraction) or end.numerator.bit_length() + end.denominator.bit_length() < _MAX_BITS:
            return end
        unit = Fraction(2) ** (_KEPT_BITS - end.numerator.bit_length() + end.denominator.bit_length())
        return Fraction(ceil(end * unit) if up else floor(end * unit)) / unit

    return Range(cut(value.lower, False), cut(value.upper, True))


def _times(a: End, b: End) -> End:
    if a == 0 or b == 0:
        return Fraction(0)
    if isinstance(a, Fraction) and isinstance(b, Fraction):
        return a * b
    return inf if (a > 0) == (b > 0) else -inf


def _add(a: Range, b: Range) -> Range:
    def plus(x: End, y: End) -> End:
        if isinstance(x, Fraction) and isinstance(y, Fraction):
            return x + y
        return x if isinstance(x, float) else y

    return Range(plus(a.lower, b.lower), plus(a.upper, b.upper))


def _multiply(a: Range, b: Range) -> Range:
    ends = [_times(x, y) for x in (a.lower, a.upper) for y in (b.lower, b.upper)]
    return Range(min(ends), max(ends))


def _inverse(a: Range) -> Range:
    def one_over(end: End) -> End:
        return Fraction(0) if isinstance(end, float) else 1 / end

    if a.lower > 0 or a.upper < 0:
        return Range(one_over(a.upper), one_over(a.lower))
    if a.lower == 0 and a.upper > 0:
        return Range(one_over(a.upper), inf)
    if a.upper == 0 and a.lower < 0:
        return Range(-inf, one_over(a.lower))
    return LINE


def _clip(value: Range, limits: Range) -> Range:
    return Range(max(value.lower, limits.lower), min(value.upper, limits.upper))


def _at(function: Function, end: Fraction) -> Range:
    """Its value at a rational point; the whole line where it has none."""
    known = function.folded((end,))
    return Range.of_ball(point_ball(function)(fraction_ball(end))) if known is None else Range.point(known)


def _limit(value: Expression | float) -> Range:
    return Range(value, value) if isinstance(value, float) else Range.of_ball(value.ball({}))


def _monotone(function: Function, shape: Monotone) -> Callable[[Range], Range]:
    limits = [_limit(value) for value in shape.image]
    image = limits[0].hull(limits[1])
    rises = limits[0].lower < limits[1].lower

    def value(end: End) -> Range:
        return limits[end > 0] if isinstance(end, float) else _at(function, end)

    def ends(x: Range) -> Range:
        x = _absolute(x) if shape.even else x
        if x.lower < shape.domain[0] or x.upper > shape.domain[1]:
            return LINE
        first, last = value(x.lower), value(x.upper)
        return _clip(Range(first.lower, last.upper) if rises else Range(last.lower, first.upper), image)

    return ends


def _periodic(function: Function, shape: Periodic) -> Callable[[Range], Range]:
    image = Range(shape.bottom, shape.top)

    def ends(x: Range) -> Range:
        if not x.is_finite or Fraction(x.upper) - Fraction(x.lower) >= Fraction(22, 7) * shape.period:
            return image
        value = _clip(_at(function, Fraction(x.lower)).hull(_at(function, Fraction(x.upper))), image)
        lower = shape.bottom if _may_hold(x, shape.valley, shape.period) else value.lower
        upper = shape.top if _may_hold(x, shape.peak, shape.period) else value.upper
        return Range(lower, upper)

    return ends


def _may_hold(x: Range, offset: Fraction, period: int) -> bool:
    """Whether (offset + k period) pi may lie in x for some integer k."""
    ends = (fraction_ball(Fraction(end)) / arb.pi() for end in (x.lower, x.upper))
    first, last = ((end - fraction_ball(offset)) / period for end in ends)
    return not first.lower().ceil().upper() > last.upper().floor().lower()


def _cornered(function: Function, shape: Cornered) -> Callable[..., Range]:
    inside = shape.inside(*function.slots)
    names = [str(slot) for slot in function.slots]
    image = _limit(shape.image[0]).hull(_limit(shape.image[1]))

    def ends(*arguments: Range) -> Range:
        if not range_of(inside, dict(zip(names, arguments, strict=True))).lower > 0:
            return LINE
        if not all(x.is_finite for x in arguments):
            return image
        corners = product(*((fraction_ball(Fraction(end)) for end in (x.lower, x.upper)) for x in arguments))
        return reduce(Range.hull, (Range.of_ball(point_ball(function)(*corner)) for corner in corners))

    return ends


def _root(x: Range, exponent: Fraction) -> Range:
    """x ** exponent > 0, where x >= 0."""
    if x.lower < 0:
        return LINE

    def value(end: End) -> Range:
        if end in (0, 1, inf):
            return Range(end, end)
        return Range.of_ball(power_ball(fraction_ball(Fraction(end)), exponent))

    return Range(value(x.lower).lower, value(x.upper).upper)


def _power(x: Range, exponent: Fraction) -> Range:
    if exponent < 0:
        return _inverse(_power(x, -exponent))
    if exponent.denominator > 1:
        return _root(x, exponent)
    count = exponent.numerator

    def raised(end: End) -> End:
        if isinstance(end, Fraction):
            return end**count
        return inf if end > 0 or count % 2 == 0 else -inf

    low, high = raised(x.lower), raised(x.upper)
    if count % 2 == 1:
        return Range(low, high)
    return Range(Fraction(0), max(low, high)) if 0 in x else Range(min(low, high), max(low, high))


def _absolute(x: Range) -> Range:
    high = max(x.upper, -x.lower)
    return Range(Fraction(0) if 0 in x else max(x.lower, -x.upper), high)


# Where a Lipschitz g is 0 its gradient is 0 almost everywhere, and `sign(g)`, `step(g)` only ever multiply
# derivatives of g: on a box where g >= 0 they count as 1 even where g touches 0. Bounds that hold almost
# everywhere bound the Clarke gradient and every secant.
def _jump(above: Number, below: Number) -> Callable[[Range], Range]:
    high, low = Range.point(above.value), Range.point(below.value)

    def ends(x: Range) -> Range:
        if x.is_point and x.lower == 0:
            return low.hull(high)
        return high if x.lower >= 0 else low if x.upper <= 0 else low.hull(high)

    return ends


def _each(choice: Callable[[End, End], End]) -> Callable[[Range, Range], Range]:
    return lambda a, b: Range(choice(a.lower, b.lower), choice(a.upper, b.upper))


_minimum, _maximum = _each(min), _each(max)


# What has no shape, and kinks, of which a shape gives only the gradient.
_RULES: dict[str, Callable[..., Range]] = {
    "add": _add,
    "multiply": _multiply,
    "divide": lambda a, b: _multiply(a, _inverse(b)),
    "abs": _absolute,
    "min": _minimum,
    "max": _maximum,
    "sat": lambda x, low, high: _maximum(low, _minimum(x, high)),
}


def _rule(function: Function) -> Callable[..., Range]:
    match function.shape:
        case Monotone() as shape:
            return _monotone(function, shape)
        case Periodic() as shape:
            return _periodic(function, shape)
        case Cornered() as shape:
            return _cornered(function, shape)
    return _RULES[function.name] if function.jump is None else _jump(*function.jump)


def _shortened(function: Function) -> Callable[..., Range]:
    rule = _rule(function)
    return lambda *arguments: _short(rule(*arguments))


RANGE_FUNCTIONS: dict[str, Callable[..., Range]] = {name: _shortened(one) for name, one in LANGUAGE.items()}


def range_of(expression: Expression, box: Mapping[str, Range]) -> Range:
    """An enclosure of the values of `expression` where each variable lies in its range."""

    def leaf(node: Expression) -> Range:
        if isinstance(node, Variable):
            return box[node.name]
        return Range.point(node.value) if isinstance(node, Number) else Range.of_ball(exact_ball(node))

    return expression.read(leaf, lambda base, exponent: _short(_power(base, exponent)), RANGE_FUNCTIONS)


def value_at(expression: Expression, point: Point) -> Range:
    """An enclosure of the value at a rational point, exact where that is rational by the rules above."""
    return range_of(expression, {name: Range.point(at) for name, at in point.items()})


def known_range(expression: Expression, box: Mapping[str, Range]) -> Range:
    """The ends proved by the expression as it is, or by its canonical form."""
    own, short = range_of(expression, box), range_of(simplify(expression), box)
    return Range(max(own.lower, short.lower), min(own.upper, short.upper))
