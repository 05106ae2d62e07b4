"""Values and gradients over many boxes at once, in floats rounded outwards.

An interval is a pair of arrays (lower, upper), one entry a box. Sums, products and quotients are float
operations moved one step outwards where they may have been rounded; an elementary function is taken from
its ball, point by point. Nothing is ever nan: what may be undefined is the whole line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from fractions import Fraction
from functools import reduce
from itertools import product
from math import inf, isinf, nextafter, pi

import numpy as np
from flint import arb
from numpy.typing import NDArray

from cdobs_cli.arrays import Array
from cdobs_cli.exact.budget import spend
from cdobs_cli.exact.expression import Call, Expression, Number, Power, Variable, negated
from cdobs_cli.exact.functions import exact_ball, fraction_ball, point_ball, power_ball
from cdobs_cli.exact.language import LANGUAGE, Function
from cdobs_cli.exact.precision import precision
from cdobs_cli.exact.shapes import Cornered, Kink, Monotone, Periodic
from cdobs_cli.records import dataclass

Ends = tuple[Array, Array]
_BITS = 80
_LINE = (-inf, inf)


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


def multiply(a: Ends, b: Ends) -> Ends:
    """a b; 0 times anything is the exact 0."""
    spend(20 + len(a[0]) // 8)
    parts = [x * y for x in a for y in b]
    low, high = _least(parts), _largest(parts)
    if np.isnan(low).any():  # 0 times inf
        parts = [np.where(np.isnan(part), 0.0, part) for part in parts]
        low, high = _least(parts), _largest(parts)
    lower, upper = _down(low), _up(high)
    if not (low.all() and high.all()):
        zero = (low == 0) | (high == 0)
        # A zero stays exact where every zero product has a zero factor, and is not an underflow.
        exact = np.ones(np.count_nonzero(zero), dtype=bool)
        for part, (x, y) in zip(parts, ((x, y) for x in a for y in b), strict=True):
            exact &= (part[zero] != 0) | (x[zero] == 0) | (y[zero] == 0)
        lower[zero] = np.where(exact & (low[zero] == 0), 0.0, lower[zero])
        upper[zero] = np.where(exact & (high[zero] == 0), 0.0, upper[zero])
    return lower, upper


def _least(parts: Sequence[Array]) -> Array:
    """Of four arrays; not a number where one is not."""
    return np.minimum(np.minimum(parts[0], parts[1]), np.minimum(parts[2], parts[3]))


def _largest(parts: Sequence[Array]) -> Array:
    return np.maximum(np.maximum(parts[0], parts[1]), np.maximum(parts[2], parts[3]))


def inverse(a: Ends) -> Ends:
    """1 / a; the whole line where a holds 0 inside."""
    low, high = a
    one_low, one_high = _down(1 / high), _up(1 / low)
    positive, negative = (low >= 0) & (high > 0), (high <= 0) & (low < 0)
    away = positive & (low > 0) | negative & (high < 0)
    lower = np.where(away | positive, one_low, -inf)
    upper = np.where(away | negative, one_high, inf)
    return np.where(np.isinf(high) & positive, 0.0, lower), np.where(np.isinf(low) & negative, 0.0, upper)


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
        sizes = [_nonnegative_power(absolute((end, end)), exponent) for end in power]
        low, high = (np.where(power[k] >= 0, sizes[k][k], -sizes[k][1 - k]) for k in (0, 1))
        return low, high
    return _nonnegative_power(absolute(power), exponent)


def _nonnegative_power(a: Ends, exponent: int) -> Ends:
    if exponent == 1:
        return a
    half = _nonnegative_power(a, exponent // 2)
    square = _nonnegative_product(half, half)
    return _nonnegative_product(a, square) if exponent % 2 else square


def _nonnegative_product(a: Ends, b: Ends) -> Ends:
    zeros = [(x == 0) | (y == 0) for x, y in zip(a, b, strict=True)]
    low, high = (np.where(zero, 0.0, x * y) for zero, x, y in zip(zeros, a, b, strict=True))
    return np.maximum(_down(low), 0.0), np.where(zeros[1], 0.0, _up(high))


def outside(value: arb) -> tuple[float, float]:
    """The nearest floats outside a number; the whole line where it is not finite."""
    if not value.is_finite():
        return -inf, inf
    low, high = float(value.lower()), float(value.upper())
    return (low, high) if value.is_exact() and arb(low) == value else (nextafter(low, -inf), nextafter(high, inf))


def _each(function: Callable[..., arb], *columns: Array) -> Ends:
    """Outward floats of a function at each point."""
    with precision(_BITS):
        points = zip(*(column.tolist() for column in columns), strict=True)
        ends = [outside(function(*map(arb, point))) for point in points]
    low, high = np.array(ends).reshape(-1, 2).T
    return low, high


def _points(function: Callable[[arb], arb], x: Array, limits: Sequence[tuple[float, float]] = (_LINE, _LINE)) -> Ends:
    """The same where points come twice or lie at -inf and inf, where `limits` hold the values."""
    distinct, back = np.unique(x, return_inverse=True)
    with precision(_BITS):
        ends = np.array([limits[at > 0] if isinf(at) else outside(function(arb(at))) for at in distinct.tolist()])
    ends = ends.reshape(-1, 2)
    return ends[back, 0], ends[back, 1]


def _nearest(function: Callable[[Array], Array]) -> Callable[[Array], Ends]:
    """Outward floats of a function that floats round correctly: one step holds the true value, and 0 is 0."""

    def at(x: Array) -> Ends:
        value = function(x)
        return np.where(value == 0, 0.0, _down(value)), np.where(value == 0, 0.0, _up(value))

    return at


def _monotone(function: Function, shape: Monotone) -> Callable[[Ends], Ends]:
    ball = point_ball(function)
    limits = [(value, value) if isinstance(value, float) else outside(value.ball({})) for value in shape.image]
    rises = limits[0] < limits[1]
    (floor, _), (_, ceiling) = limits if rises else limits[::-1]
    start, stop = (float(end) for end in shape.domain)
    at = _nearest(getattr(np, function.name)) if function.rounded else lambda x: _points(ball, x, limits)

    def ends(x: Ends) -> Ends:
        x = absolute(x) if shape.even else x
        inside = (x[0] >= start) & (x[1] <= stop)
        low, high = at(x[0] if rises else x[1])[0], at(x[1] if rises else x[0])[1]
        return np.where(inside, np.maximum(low, floor), -inf), np.where(inside, np.minimum(high, ceiling), inf)

    return ends


def _holds_turn(x: Ends, offset: Fraction, period: int) -> NDArray[np.bool_]:
    """Whether (offset + k period) pi may lie in the interval: yes in doubt."""
    slack = 1e-9 * (1 + np.maximum(np.abs(x[0]), np.abs(x[1])))
    shift, turn = float(offset) * pi, period * pi
    return np.floor((x[1] + slack - shift) / turn) >= np.ceil((x[0] - slack - shift) / turn)


def _periodic(function: Function, shape: Periodic) -> Callable[[Ends], Ends]:
    ball, bottom, top = point_ball(function), float(shape.bottom), float(shape.top)

    def ends(x: Ends) -> Ends:
        far = ~((np.abs(x[0]) < 1e6) & (np.abs(x[1]) < 1e6))
        first, second = (_points(ball, np.where(far, 0.0, end)) for end in x)
        low = np.where(far | _holds_turn(x, shape.valley, shape.period), bottom, np.minimum(first[0], second[0]))
        high = np.where(far | _holds_turn(x, shape.peak, shape.period), top, np.maximum(first[1], second[1]))
        return np.maximum(low, bottom), np.minimum(high, top)

    return ends


def root(x: Ends, exponent: Fraction) -> Ends:
    """a ** exponent for a root, exponent > 0; the whole line where a < 0."""
    if exponent.denominator == 2:
        return whole(_VALUES["sqrt"](x), exponent.numerator)
    at = [_points(lambda a: power_ball(a, exponent), end, (_LINE, (inf, inf))) for end in x]
    inside = x[0] >= 0
    return np.where(inside, np.maximum(at[0][0], 0.0), -inf), np.where(inside, at[1][1], inf)


def rational_power(x: Ends, exponent: Fraction) -> Ends:
    """a ** (p/q)."""
    if exponent.denominator == 1:
        return whole(x, exponent.numerator)
    return root(x, exponent) if exponent > 0 else inverse(root(x, -exponent))


def _cornered(function: Function, shape: Cornered) -> Callable[..., Ends]:
    ball, slots, inside = point_ball(function), function.slots, shape.inside(*function.slots)
    limits = outside(shape.image[0].ball({}))[0], outside(shape.image[1].ball({}))[1]

    def ends(*arguments: Ends) -> Ends:
        defined = _through(inside, {slot: Jet(x) for slot, x in zip(slots, arguments, strict=True)}).value[0] > 0
        far = ~np.all(np.isfinite(np.stack([end for x in arguments for end in x])), axis=0)
        near = [tuple(np.where(defined & ~far, end, 1.0) for end in x) for x in arguments]
        low, high = reduce(hull, (_each(ball, *corner) for corner in product(*near)))
        low, high = np.where(far, limits[0], low), np.where(far, limits[1], high)
        return np.where(defined, low, -inf), np.where(defined, high, inf)

    return ends


def _chosen(condition: Ends, above: Ends, below: Ends) -> Ends:
    """Above or below, by the side on which the box is almost everywhere (see ranges.py); their hull where it is on
    both."""
    kink = (condition[0] == 0) & (condition[1] == 0)
    over, under = (condition[0] >= 0) & ~kink, (condition[1] <= 0) & ~kink
    both = hull(above, below)
    low, high = (np.where(over, above[k], np.where(under, below[k], both[k])) for k in (0, 1))
    return low, high


def minimum(a: Ends, b: Ends) -> Ends:
    return np.minimum(a[0], b[0]), np.minimum(a[1], b[1])


def maximum(a: Ends, b: Ends) -> Ends:
    return np.maximum(a[0], b[0]), np.maximum(a[1], b[1])


def full(ends: tuple[float, float], count: int) -> Ends:
    """The same interval everywhere."""
    return np.full(count, ends[0]), np.full(count, ends[1])


@dataclass(slots=True)
class Jet:
    """Value and gradient over each box: gradients only of the variables that occur."""

    value: Ends
    gradient: dict[int, Ends] = field(default_factory=dict)


def _summed(gradients: Iterable[Mapping[int, Ends]]) -> dict[int, Ends]:
    total: dict[int, Ends] = {}
    for gradient in gradients:
        for index, part in gradient.items():
            total[index] = add(total[index], part) if index in total else part
    return total


def _chain(parts: Iterable[tuple[Ends, Jet]]) -> dict[int, Ends]:
    """sum_k slope_k gradient_k."""
    return _summed({index: multiply(slope, part) for index, part in jet.gradient.items()} for slope, jet in parts)


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
                else:
                    memo[node] = _jet(node, memo, count)
                for child in node.children:
                    if self.last_use[child] == k and child is not self.nodes[-1]:
                        memo.pop(child, None)
        return memo[self.nodes[-1]]


def _jet(node: Expression, memo: Mapping[Expression, Jet], count: int) -> Jet:
    """A node from its children."""
    if isinstance(node, Power):
        return _power_jet(memo[node.base], node.exponent)
    if isinstance(node, Call):
        if (inner := negated(node)) is not None:
            x = memo[inner]
            return Jet(negate(x.value), {index: negate(part) for index, part in x.gradient.items()})
        return _RULES[node.function](*(memo[child] for child in node.children))
    return Jet(full(outside(exact_ball(node)), count))


def _through(expression: Expression, memo: dict[Expression, Jet]) -> Jet:
    """An expression of parts that are known."""
    count = len(next(iter(memo.values())).value[0])
    for node in expression.walk(memo):
        memo[node] = _jet(node, memo, count)
    return memo[expression]


def _power_jet(x: Jet, exponent: Fraction) -> Jet:
    value = rational_power(x.value, exponent)
    if not x.gradient:
        return Jet(value)
    factor = full(outside(fraction_ball(exponent)), len(value[0]))
    below = rational_power(x.value, exponent - 1) if exponent != 1 else None
    return Jet(value, _chain([(factor if below is None else multiply(factor, below), x)]))


def _add(a: Jet, b: Jet) -> Jet:
    return Jet(add(a.value, b.value), _summed([a.gradient, b.gradient]))


def _multiply(a: Jet, b: Jet) -> Jet:
    return Jet(multiply(a.value, b.value), _chain([(b.value, a), (a.value, b)]))


def _divide(a: Jet, b: Jet) -> Jet:
    one_over = inverse(b.value)
    value = multiply(a.value, one_over)
    slope = negate(multiply(a.value, whole(one_over, 2)))
    return Jet(value, _chain([(one_over, a), (slope, b)]))


def _smooth(function: Function) -> Callable[..., Jet]:
    """The chain rule, with the partial derivatives as expressions of the arguments and of the value."""
    slots, own = function.slots, Call(function.name, function.slots)
    partials = [partial(*slots) for partial in function.partials]

    def rule(*jets: Jet) -> Jet:
        value = _VALUES[function.name](*(jet.value for jet in jets))
        known = {own: Jet(value)} | {slot: Jet(jet.value) for slot, jet in zip(slots, jets, strict=True)}
        pairs = [(partial, jet) for partial, jet in zip(partials, jets, strict=True) if jet.gradient]
        return Jet(value, _chain([(_slope(_through(partial, known).value, value), jet) for partial, jet in pairs]))

    def _slope(slope: Ends, value: Ends) -> Ends:
        if not isinstance(function.shape, Cornered):
            return slope
        # Where the box meets a cut, no slope bounds what the value does.
        return np.where(np.isinf(value[0]), -inf, slope[0]), np.where(np.isinf(value[1]), inf, slope[1])

    return rule


def _jump(above: Number, below: Number) -> Callable[[Jet], Jet]:
    """No bound of the gradient exists across a jump, whatever the argument's own gradient is."""

    def rule(x: Jet) -> Jet:
        high, low = (np.full_like(x.value[0], float(side.value)) for side in (above, below))
        value = _chosen(x.value, (high, high), (low, low))
        flat = value[0] == value[1]
        slope = (np.where(flat, 0.0, -inf), np.where(flat, 0.0, inf))
        return Jet(value, dict.fromkeys(x.gradient, slope))

    return rule


def _kink(function: Function, shape: Kink) -> Callable[..., Jet]:
    """The gradient of the branch."""
    slots = function.slots
    condition, *branches = shape.condition(*slots), shape.above(*slots), shape.below(*slots)

    def rule(*jets: Jet) -> Jet:
        value = _VALUES[function.name](*(jet.value for jet in jets))
        if not any(jet.gradient for jet in jets):
            return Jet(value)
        known = dict(zip(slots, jets, strict=True))
        side = _through(condition, known).value
        above, below = (_through(branch, known).gradient for branch in branches)
        zero = (np.zeros_like(side[0]),) * 2
        return Jet(value, {i: _chosen(side, above.get(i, zero), below.get(i, zero)) for i in {*above, *below}})

    return rule


# What has no shape, and kinks, of which a shape gives only the gradient.
_VALUES: dict[str, Callable[..., Ends]] = {
    "abs": absolute, "min": minimum, "max": maximum, "sat": lambda x, low, high: maximum(low, minimum(x, high)),
}  # fmt: skip
_RULES: dict[str, Callable[..., Jet]] = {"add": _add, "multiply": _multiply, "divide": _divide}


def _made(function: Function) -> Callable[..., Jet]:
    match function.shape:
        case Monotone() as shape:
            _VALUES[function.name] = _monotone(function, shape)
        case Periodic() as shape:
            _VALUES[function.name] = _periodic(function, shape)
        case Cornered() as shape:
            _VALUES[function.name] = _cornered(function, shape)
        case Kink() if function.jump is not None:
            return _jump(*function.jump)
        case Kink() as shape if not function.partials:
            return _kink(function, shape)
    return _smooth(function)


_RULES |= {name: _made(function) for name, function in LANGUAGE.items() if function.shape is not None}
