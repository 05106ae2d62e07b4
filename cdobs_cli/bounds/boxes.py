"""Values and gradients over many boxes at once, in floats rounded outwards.

An interval is a pair of arrays (lower, upper), one entry a box. Sums, products and quotients are float
operations moved one step outwards where they may have been rounded; an elementary function is taken from
its ball, point by point. Nothing is ever nan: what may be undefined is the whole line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import inf, pi

import numpy as np
from flint import arb
from numpy.typing import NDArray

from cdobs_cli.exact.budget import spend
from cdobs_cli.exact.expression import Call, Expression, Number, Power, Variable
from cdobs_cli.exact.functions import exact_ball, fraction_ball
from cdobs_cli.exact.precision import precision

Array = NDArray[np.float64]
Ends = tuple[Array, Array]
_BITS = 80


def _down(x: Array) -> Array:
    return np.nextafter(x, -inf)


def _up(x: Array) -> Array:
    return np.nextafter(x, inf)


def _sum(a: Array, b: Array, away: Callable[[Array], Array], undefined: float) -> Array:
    total = a + b
    part = total - a
    error = (a - (total - part)) + (b - part)
    total = np.where(error == 0, total, away(total))
    return np.where(np.isnan(total), undefined, total)


def add(a: Ends, b: Ends) -> Ends:
    """a + b, exact where no float was rounded."""
    return _sum(a[0], b[0], _down, -inf), _sum(a[1], b[1], _up, inf)


def negate(a: Ends) -> Ends:
    """-a."""
    return -a[1], -a[0]


def _product(a: Array, b: Array) -> Array:
    value = a * b
    return np.where((a == 0) | (b == 0), 0.0, value)


def multiply(a: Ends, b: Ends) -> Ends:
    """a b; 0 times anything is the exact 0."""
    spend(20 + len(a[0]) // 8)
    parts = [x * y for x in a for y in b]
    for part in parts:
        part[np.isnan(part)] = 0.0  # 0 times inf
    low = np.minimum(np.minimum(parts[0], parts[1]), np.minimum(parts[2], parts[3]))
    high = np.maximum(np.maximum(parts[0], parts[1]), np.maximum(parts[2], parts[3]))
    lower, upper = _down(low), _up(high)
    rows = np.flatnonzero((low == 0) | (high == 0))
    if len(rows):
        # A zero stays exact where every zero product has a zero factor, and is not an underflow.
        exact = np.ones(len(rows), dtype=bool)
        for part, (x, y) in zip(parts, ((x, y) for x in a for y in b), strict=True):
            exact &= (part[rows] != 0) | (x[rows] == 0) | (y[rows] == 0)
        lower[rows] = np.where(exact & (low[rows] == 0), 0.0, lower[rows])
        upper[rows] = np.where(exact & (high[rows] == 0), 0.0, upper[rows])
    return lower, upper


def inverse(a: Ends) -> Ends:
    """1 / a; the whole line where a holds 0 inside."""
    low, high = a
    one_low, one_high = _down(1 / high), _up(1 / low)
    positive, negative = (low >= 0) & (high > 0), (high <= 0) & (low < 0)
    lower = np.where(positive & (low > 0) | negative & (high < 0), one_low, np.where(positive, one_low, -inf))
    upper = np.where(positive & (low > 0) | negative & (high < 0), one_high, np.where(negative, one_high, inf))
    lower = np.where(np.isinf(high) & positive, 0.0, lower)
    upper = np.where(np.isinf(low) & negative, 0.0, upper)
    return lower, upper


def hull(a: Ends, b: Ends) -> Ends:
    """The interval that holds both."""
    return np.minimum(a[0], b[0]), np.maximum(a[1], b[1])


def absolute(a: Ends) -> Ends:
    """|a|."""
    low, high = a
    small = np.maximum(np.maximum(low, -high), 0.0)
    return small, np.maximum(high, -low)


def whole(power: Ends, exponent: int) -> Ends:
    """a ** exponent for an integer exponent."""
    if exponent < 0:
        return inverse(whole(power, -exponent))
    if exponent % 2 == 1:
        low, high = power
        magnitude = _nonnegative_power(absolute((low, low)), exponent), _nonnegative_power(absolute((high, high)), exponent)
        return (
            np.where(low >= 0, magnitude[0][0], -magnitude[0][1]),
            np.where(high >= 0, magnitude[1][1], -magnitude[1][0]),
        )
    return _nonnegative_power(absolute(power), exponent)


def _nonnegative_power(a: Ends, exponent: int) -> Ends:
    result: Ends | None = None
    square = a
    while exponent:
        if exponent & 1:
            result = square if result is None else _nonnegative_product(result, square)
        exponent >>= 1
        if exponent:
            square = _nonnegative_product(square, square)
    assert result is not None
    return result


def _nonnegative_product(a: Ends, b: Ends) -> Ends:
    low, high = _product(a[0], b[0]), _product(a[1], b[1])
    zero = (a[1] == 0) | (b[1] == 0)
    return np.maximum(_down(low), 0.0), np.where(zero, 0.0, _up(high))


def _points(function: Callable[[arb], arb], x: Array, at_minus: float, at_plus: float) -> Ends:
    """Outward floats of a function at each point, with its limits at infinity."""
    distinct, back = np.unique(x, return_inverse=True)
    lower, upper = np.empty(len(distinct)), np.empty(len(distinct))
    with precision(_BITS):
        for k, value in enumerate(distinct):
            if np.isinf(value):
                lower[k] = upper[k] = at_plus if value > 0 else at_minus
                continue
            ball = function(arb(float(value)))
            if not ball.is_finite():
                lower[k], upper[k] = -inf, inf
            elif ball.is_exact() and float(ball) in (-1.0, 0.0, 1.0):
                lower[k] = upper[k] = float(ball)
            else:
                lower[k], upper[k] = np.nextafter(float(ball.lower()), -inf), np.nextafter(float(ball.upper()), inf)
    return lower[back.reshape(x.shape)], upper[back.reshape(x.shape)]


def _increasing(
    function: Callable[[arb], arb], at_minus: float, at_plus: float, floor: float = -inf, ceiling: float = inf
) -> Callable[[Ends], Ends]:
    def ends(x: Ends) -> Ends:
        low = _points(function, x[0], at_minus, at_plus)[0]
        high = _points(function, x[1], at_minus, at_plus)[1]
        return np.clip(low, floor, ceiling), np.clip(high, floor, ceiling)

    return ends


def _holds_turn(x: Ends, offset: float) -> NDArray[np.bool_]:
    """Whether offset + 2 pi k may lie in the interval: yes in doubt."""
    slack = 1e-9 * (1 + np.maximum(np.abs(x[0]), np.abs(x[1])))
    return np.floor((x[1] + slack - offset) / (2 * pi)) >= np.ceil((x[0] - slack - offset) / (2 * pi))


def _wave(function: Callable[[arb], arb], peak: float, valley: float) -> Callable[[Ends], Ends]:
    def ends(x: Ends) -> Ends:
        far = ~((np.abs(x[0]) < 1e6) & (np.abs(x[1]) < 1e6))
        near = (np.where(far, 0.0, x[0]), np.where(far, 0.0, x[1]))
        first, second = _points(function, near[0], 0.0, 0.0), _points(function, near[1], 0.0, 0.0)
        low = np.where(far | _holds_turn(near, valley), -1.0, np.minimum(first[0], second[0]))
        high = np.where(far | _holds_turn(near, peak), 1.0, np.maximum(first[1], second[1]))
        return np.maximum(low, -1.0), np.minimum(high, 1.0)

    return ends


sin = _wave(lambda x: x.sin(), pi / 2, -pi / 2)
cos = _wave(lambda x: x.cos(), 0.0, pi)
tanh = _increasing(lambda x: x.tanh(), -1.0, 1.0, -1.0, 1.0)
exp = _increasing(lambda x: x.exp(), 0.0, inf, 0.0)
sinh = _increasing(lambda x: x.sinh(), -inf, inf)
_cosh_of_size = _increasing(lambda x: x.cosh(), inf, inf, 1.0)
_tan_piece = _increasing(lambda x: x.tan(), -inf, inf)


def cosh(x: Ends) -> Ends:
    return _cosh_of_size(absolute(x))


def tan(x: Ends) -> Ends:
    pole = ~((np.abs(x[0]) < 1e6) & (np.abs(x[1]) < 1e6)) | _holds_turn(x, pi / 2) | _holds_turn(x, -pi / 2)
    low, high = _tan_piece((np.where(pole, 0.0, x[0]), np.where(pole, 0.0, x[1])))
    return np.where(pole, -inf, low), np.where(pole, inf, high)


def log(x: Ends) -> Ends:
    inside = x[0] >= 0
    low = _points(lambda v: v.log() if v > 0 else arb.nan(), np.where(inside, x[0], 0.0), -inf, inf)[0]
    high = _points(lambda v: v.log() if v > 0 else arb.nan(), np.where(inside, x[1], 0.0), -inf, inf)[1]
    return low, np.where(inside, high, inf)


def root(x: Ends, degree: int) -> Ends:
    """The degree-th root where a >= 0."""
    inside = x[0] >= 0
    if degree == 2:
        # IEEE square roots are correctly rounded: one step outwards holds the true one.
        low, high = np.sqrt(np.where(inside, x[0], 0.0)), np.sqrt(np.where(inside, x[1], 0.0))
        low, high = np.where(low == 0, 0.0, _down(low)), np.where(high == 0, 0.0, _up(high))
        return np.where(inside, low, -inf), np.where(inside, high, inf)
    function = _increasing(lambda v: v.root(degree) if v > 0 else arb(0), 0.0, inf, 0.0)
    low, high = function((np.where(inside, x[0], 0.0), np.where(inside, x[1], 0.0)))
    return np.where(inside, low, -inf), np.where(inside, high, inf)


def rational_power(x: Ends, exponent: Fraction) -> Ends:
    """a ** (p/q)."""
    if exponent.denominator == 1:
        return whole(x, exponent.numerator)
    return whole(root(x, exponent.denominator), exponent.numerator)


def _jump(low_value: float) -> Callable[[Ends], Ends]:
    """`sign` or `step`: the value almost everywhere on the box, see bounds/ranges.py."""

    def ends(x: Ends) -> Ends:
        kink = (x[0] == 0) & (x[1] == 0)
        lower = np.where((x[0] >= 0) & ~kink, 1.0, low_value)
        upper = np.where((x[1] <= 0) & ~kink, low_value, 1.0)
        return lower, upper

    return ends


sign, step = _jump(-1.0), _jump(0.0)


def minimum(a: Ends, b: Ends) -> Ends:
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def maximum(a: Ends, b: Ends) -> Ends:
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def constant(value: arb, count: int) -> Ends:
    """A number as the nearest floats outside."""
    if not value.is_finite():
        return np.full(count, -inf), np.full(count, inf)
    low, high = float(value.lower()), float(value.upper())
    if not (value.is_exact() and arb(low) == value):
        low, high = float(np.nextafter(low, -inf)), float(np.nextafter(high, inf))
    return np.full(count, low), np.full(count, high)


@dataclass(slots=True)
class Jet:
    """Value and gradient over each box: gradients only of the variables that occur."""

    value: Ends
    gradient: dict[int, Ends] = field(default_factory=dict)


def _chain(parts: Sequence[tuple[Ends, Jet]]) -> dict[int, Ends]:
    """sum_k slope_k gradient_k."""
    total: dict[int, Ends] = {}
    for slope, jet in parts:
        for index, gradient in jet.gradient.items():
            term = multiply(slope, gradient)
            total[index] = add(total[index], term) if index in total else term
    return total


class Evaluator:
    """An expression compiled for values and gradients over arrays of boxes.

    Args:
        names: the variables, in the order of the boxes' columns.
    """

    def __init__(self, expression: Expression, names: Sequence[str]) -> None:
        self.nodes = list(expression.walk())
        self.names = {name: index for index, name in enumerate(names)}
        self.last_use = {child: k for k, node in enumerate(self.nodes) for child in node.children}

    def value(self, low: Array, high: Array) -> Ends:
        """Ends of the values over boxes [low, high], shape (N, variables) each."""
        return self._run(low, high, slopes=False).value

    def jet(self, low: Array, high: Array) -> Jet:
        """Values and gradients over the boxes."""
        return self._run(low, high, slopes=True)

    def _run(self, low: Array, high: Array, *, slopes: bool) -> Jet:
        memo: dict[Expression, Jet] = {}
        count = len(low)
        spend(len(self.nodes) * (15 + count // 16) * (2 if slopes else 1))
        with np.errstate(all="ignore"):
            for k, node in enumerate(self.nodes):
                if isinstance(node, Variable):
                    index = self.names[node.name]
                    one = np.ones(count)
                    memo[node] = Jet((low[:, index], high[:, index]), {index: (one, one)} if slopes else {})
                elif isinstance(node, Power):
                    memo[node] = _power_jet(memo[node.base], node.exponent)
                elif isinstance(node, Call):
                    memo[node] = _RULES[node.function](*(memo[child] for child in node.children))
                else:
                    ball = fraction_ball(node.value) if isinstance(node, Number) else exact_ball(node)
                    memo[node] = Jet(constant(ball, count))
                for child in node.children:
                    if self.last_use[child] == k and child is not self.nodes[-1]:
                        memo.pop(child, None)
        return memo[self.nodes[-1]]


def _power_jet(x: Jet, exponent: Fraction) -> Jet:
    value = rational_power(x.value, exponent)
    if not x.gradient:
        return Jet(value)
    factor = constant(fraction_ball(exponent), len(value[0]))
    below = rational_power(x.value, exponent - 1) if exponent != 1 else None
    return Jet(value, _chain([(factor if below is None else multiply(factor, below), x)]))


def _smooth(function: Callable[[Ends], Ends], slope: Callable[[Ends, Ends], Ends]) -> Callable[[Jet], Jet]:
    """A function of one variable with its derivative as slope(x, f(x))."""

    def rule(x: Jet) -> Jet:
        value = function(x.value)
        return Jet(value, _chain([(slope(x.value, value), x)]) if x.gradient else {})

    return rule


def _ones(x: Ends) -> Ends:
    one = np.ones_like(x[0])
    return one, one


def _add_rule(a: Jet, b: Jet) -> Jet:
    gradient = dict(a.gradient)
    for index, part in b.gradient.items():
        gradient[index] = add(gradient[index], part) if index in gradient else part
    return Jet(add(a.value, b.value), gradient)


def _multiply_rule(a: Jet, b: Jet) -> Jet:
    return Jet(multiply(a.value, b.value), _chain([(b.value, a), (a.value, b)]))


def _divide_rule(a: Jet, b: Jet) -> Jet:
    one_over = inverse(b.value)
    value = multiply(a.value, one_over)
    return Jet(value, _chain([(one_over, a), (negate(multiply(a.value, whole(one_over, 2))), b)]))


def _jump_rule(function: Callable[[Ends], Ends]) -> Callable[[Jet], Jet]:
    def rule(x: Jet) -> Jet:
        value = function(x.value)
        flat = value[0] == value[1]
        slope = (np.where(flat, 0.0, -inf), np.where(flat, 0.0, inf))
        # No bound of the gradient exists across the jump, whatever the argument's own gradient is.
        return Jet(value, dict.fromkeys(x.gradient, slope))

    return rule


def _branch_rule(smaller: bool) -> Callable[[Jet, Jet], Jet]:
    def rule(a: Jet, b: Jet) -> Jet:
        first, second = (a, b) if smaller else (b, a)
        only_a, only_b = first.value[1] < second.value[0], second.value[1] < first.value[0]
        zero = np.zeros_like(a.value[0])
        gradient = {}
        for index in {*a.gradient, *b.gradient}:
            ga, gb = a.gradient.get(index, (zero, zero)), b.gradient.get(index, (zero, zero))
            both = hull(ga, gb)
            gradient[index] = (
                np.where(only_a, ga[0], np.where(only_b, gb[0], both[0])),
                np.where(only_a, ga[1], np.where(only_b, gb[1], both[1])),
            )
        return Jet(minimum(a.value, b.value) if smaller else maximum(a.value, b.value), gradient)

    return rule


_minimum_rule, _maximum_rule = _branch_rule(True), _branch_rule(False)
_RULES: Mapping[str, Callable[..., Jet]] = {
    "add": _add_rule,
    "multiply": _multiply_rule,
    "divide": _divide_rule,
    "sin": _smooth(sin, lambda x, _: cos(x)),
    "cos": _smooth(cos, lambda x, _: negate(sin(x))),
    "tan": _smooth(tan, lambda _, v: add(_ones(v), whole(v, 2))),
    "tanh": _smooth(tanh, lambda _, v: add(_ones(v), negate(whole(v, 2)))),
    "sinh": _smooth(sinh, lambda x, _: cosh(x)),
    "cosh": _smooth(cosh, lambda x, _: sinh(x)),
    "exp": _smooth(exp, lambda _, v: v),
    "log": _smooth(log, lambda x, _: inverse(x)),
    "sqrt": _smooth(lambda x: root(x, 2), lambda _, v: multiply((np.full_like(v[0], 0.5),) * 2, inverse(v))),
    "abs": _smooth(absolute, lambda x, _: sign(x)),
    "min": _minimum_rule,
    "max": _maximum_rule,
    "sat": lambda x, low, high: _maximum_rule(low, _minimum_rule(x, high)),
    "monod": lambda s, k: _divide_rule(s, _add_rule(k, s)),
    "contois": lambda s, x, k: _divide_rule(s, _add_rule(_multiply_rule(k, x), s)),
    "sign": _jump_rule(sign),
    "step": _jump_rule(step),
}
