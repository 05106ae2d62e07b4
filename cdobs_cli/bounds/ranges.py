"""Ranges of an expression over a box whose ends are exact: rationals, or infinite.

Sums, products, quotients and integer powers of rationals are exact; a transcendental end is the dyadic
outside of its ball. So a supremum that belongs to the functions (cos <= 1, 0 <= 1 - tanh^2 <= 1) comes out
as the very number, and `1 - 0.3 cos(x) <= 1.3` is decided where floats or balls would touch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf

from flint import arb

from cdobs_cli.exact.expression import Call, Expression, Number, Power, Variable
from cdobs_cli.exact.functions import exact_ball, fraction_ball
from cdobs_cli.exact.numbers import clipped

End = Fraction | float  # a float only where it is inf or -inf
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


LINE = Range(-inf, inf)
_UNIT = Range(Fraction(-1), Fraction(1))
_STEP = Range(Fraction(0), Fraction(1))


def _short(value: Range) -> Range:
    """Ends cut to a bounded length, outwards."""

    def cut(end: End, up: bool) -> End:
        if not isinstance(end, Fraction) or end.numerator.bit_length() + end.denominator.bit_length() < _MAX_BITS:
            return end
        shift = _KEPT_BITS - end.numerator.bit_length() + end.denominator.bit_length()
        scaled = end * Fraction(2) ** shift
        return (
            Fraction(-((-scaled.numerator) // scaled.denominator) if up else scaled.numerator // scaled.denominator) / Fraction(2) ** shift
        )

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


def _ends(function: Callable[[arb], arb], low: End, high: End, x: Range, exact: Mapping[Fraction, Fraction]) -> Range:
    """Range of an increasing function; `low` and `high` are its limits at -inf and inf."""

    def value(end: End) -> Range:
        if isinstance(end, float):
            limit = low if end < 0 else high
            return Range(limit, limit)
        if end in exact:
            return Range.point(exact[end])
        return Range.of_ball(function(fraction_ball(end)))

    return Range(value(x.lower).lower, value(x.upper).upper)


def _clip(value: Range, limits: Range) -> Range:
    return Range(max(value.lower, limits.lower), min(value.upper, limits.upper))


def _root(x: Range, degree: int) -> Range:
    if x.lower < 0:
        return LINE
    return _clip(
        _ends(lambda v: v.root(degree), 0.0, inf, x, {Fraction(0): Fraction(0), Fraction(1): Fraction(1)}), Range(Fraction(0), inf)
    )


def _power(x: Range, exponent: Fraction) -> Range:
    if exponent < 0:
        return _inverse(_power(x, -exponent))
    if exponent.denominator > 1:
        return _power(_root(x, exponent.denominator), Fraction(exponent.numerator))
    count = exponent.numerator

    def raised(end: End) -> End:
        if isinstance(end, Fraction):
            return end**count
        return inf if end > 0 or count % 2 == 0 else -inf

    low, high = raised(x.lower), raised(x.upper)
    if count % 2 == 1:
        return Range(low, high)
    return Range(Fraction(0), max(low, high)) if 0 in x else Range(min(low, high), max(low, high))


def _may_hold_multiple(x: Range, offset: arb) -> bool:
    """Whether offset + 2 pi k may lie in x for some integer k."""
    turn = 2 * arb.pi()
    first = ((fraction_ball(Fraction(x.lower)) - offset) / turn).lower().ceil()
    last = ((fraction_ball(Fraction(x.upper)) - offset) / turn).upper().floor()
    return not first.upper() > last.lower()


def _cos(x: Range) -> Range:
    if not x.is_finite or Fraction(x.upper) - Fraction(x.lower) >= 7:
        return _UNIT
    ends = [Range.point(1) if end == 0 else Range.of_ball(fraction_ball(Fraction(end)).cos()) for end in (x.lower, x.upper)]
    value = _clip(ends[0].hull(ends[1]), _UNIT)
    lower = Fraction(-1) if _may_hold_multiple(x, arb.pi()) else value.lower
    upper = Fraction(1) if _may_hold_multiple(x, arb(0)) else value.upper
    return Range(lower, upper)


def _sin(x: Range) -> Range:
    if not x.is_finite or Fraction(x.upper) - Fraction(x.lower) >= 7:
        return _UNIT
    ends = [Range.point(0) if end == 0 else Range.of_ball(fraction_ball(Fraction(end)).sin()) for end in (x.lower, x.upper)]
    value = _clip(ends[0].hull(ends[1]), _UNIT)
    lower = Fraction(-1) if _may_hold_multiple(x, -arb.pi() / 2) else value.lower
    upper = Fraction(1) if _may_hold_multiple(x, arb.pi() / 2) else value.upper
    return Range(lower, upper)


def _tan(x: Range) -> Range:
    cosine = _cos(x)
    if not x.is_finite or 0 in cosine or Fraction(x.upper) - Fraction(x.lower) >= 3:
        return LINE
    return _ends(lambda v: v.tan(), -inf, inf, x, {Fraction(0): Fraction(0)})


def _cosh(x: Range) -> Range:
    size = _absolute(x)
    return _clip(_ends(lambda v: v.cosh(), Fraction(1), inf, size, {Fraction(0): Fraction(1)}), Range(Fraction(1), inf))


def _log(x: Range) -> Range:
    if x.lower < 0:
        return LINE
    if x.lower == 0:
        return Range(-inf, inf if x.upper in (0, inf) else _log(Range(x.upper, x.upper)).upper)
    return _ends(lambda v: v.log(), -inf, inf, x, {Fraction(1): Fraction(0)})


def _absolute(x: Range) -> Range:
    high = max(x.upper, -x.lower)
    return Range(Fraction(0) if 0 in x else max(x.lower, -x.upper), high)


# Where a Lipschitz g is 0 its gradient is 0 almost everywhere, and `sign(g)`, `step(g)` only ever multiply
# derivatives of g: on a box where g >= 0 they count as 1 even where g touches 0. Bounds that hold almost
# everywhere bound the Clarke gradient and every secant.
def _sign(x: Range) -> Range:
    if x.is_point and x.lower == 0:
        return _UNIT
    return Range.point(1) if x.lower >= 0 else Range.point(-1) if x.upper <= 0 else _UNIT


def _step(x: Range) -> Range:
    if x.is_point and x.lower == 0:
        return _STEP
    return Range.point(1) if x.lower >= 0 else Range.point(0) if x.upper <= 0 else _STEP


def _minimum(a: Range, b: Range) -> Range:
    return Range(min(a.lower, b.lower), min(a.upper, b.upper))


def _maximum(a: Range, b: Range) -> Range:
    return Range(max(a.lower, b.lower), max(a.upper, b.upper))


_ZERO_AT_ZERO = {Fraction(0): Fraction(0)}
RANGE_FUNCTIONS: dict[str, Callable[..., Range]] = {
    "add": _add,
    "multiply": _multiply,
    "divide": lambda a, b: _multiply(a, _inverse(b)),
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "tanh": lambda x: _clip(_ends(lambda v: v.tanh(), Fraction(-1), Fraction(1), x, _ZERO_AT_ZERO), _UNIT),
    "sinh": lambda x: _ends(lambda v: v.sinh(), -inf, inf, x, _ZERO_AT_ZERO),
    "cosh": _cosh,
    "exp": lambda x: _clip(_ends(lambda v: v.exp(), Fraction(0), inf, x, {Fraction(0): Fraction(1)}), Range(Fraction(0), inf)),
    "log": _log,
    "sqrt": lambda x: _root(x, 2),
    "abs": _absolute,
    "min": _minimum,
    "max": _maximum,
    "sat": lambda x, low, high: _maximum(low, _minimum(x, high)),
    "monod": lambda s, k: _multiply(s, _inverse(_add(k, s))),
    "contois": lambda s, x, k: _multiply(s, _inverse(_add(_multiply(k, x), s))),
    "sign": _sign,
    "step": _step,
}


def range_of(expression: Expression, box: Mapping[str, Range]) -> Range:
    """An enclosure of the values of `expression` where each variable lies in its range."""
    memo: dict[Expression, Range] = {}
    for node in expression.walk():
        if isinstance(node, Variable):
            memo[node] = box[node.name]
        elif isinstance(node, Number):
            memo[node] = Range.point(node.value)
        elif isinstance(node, Power):
            memo[node] = _short(_power(memo[node.base], node.exponent))
        elif isinstance(node, Call):
            memo[node] = _short(RANGE_FUNCTIONS[node.function](*(memo[child] for child in node.children)))
        else:
            memo[node] = Range.of_ball(exact_ball(node))
    return memo[expression]
