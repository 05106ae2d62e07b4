"""What each function of the language is: its ball, and its partial derivatives."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from flint import arb, fmpq

import cdobs_cli.exact.precision  # noqa: F401 - sets the working precision
from cdobs_cli.exact.expression import MINUS_ONE, ONE, ZERO, Call, Constant, Expression, Number, call, power


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


def _power(base: arb, exponent: Fraction) -> arb:
    if exponent.denominator == 1:
        count = exponent.numerator
        if count < 0:
            return 1 / _power(base, -exponent)
        if count % 2 == 0:
            return hull(base.abs_lower() ** count, base.abs_upper() ** count)
        return hull(base.lower() ** count, base.upper() ** count)
    # x**(p/q) is taken for x >= 0, and for x > 0 where p < 0.
    if base.is_exact() and base.is_zero() and exponent > 0:
        return arb(0)
    if base.upper() < 0:
        return arb.nan()
    if exponent < 0:
        return 1 / _power(base, -exponent)
    root = base.lower()
    if root < 0:
        return arb.nan()
    degree = exponent.denominator
    low, high = root.root(degree) if root > 0 else arb(0), base.upper().root(degree)
    return hull(low**exponent.numerator, high**exponent.numerator)


def _monotone(function: Callable[[arb], arb]) -> Callable[[arb], arb]:
    """Enclosure of an increasing function by its ends: far tighter than the midpoint rule on wide balls."""

    def ball(x: arb) -> arb:
        return function(x) if x.is_exact() else hull(function(x.lower()), function(x.upper()))

    return ball


def _clip_unit(function: Callable[[arb], arb]) -> Callable[[arb], arb]:
    unit = hull(arb(-1), arb(1))

    def ball(x: arb) -> arb:
        value = function(x)
        if value.is_finite() and value.abs_upper() <= 1:
            return value
        return value.intersection(unit) if value.is_finite() else unit

    return ball


def _sign(x: arb) -> arb:
    if x > 0:
        return arb(1)
    return arb(-1) if x < 0 else hull(arb(-1), arb(1))


def _step(x: arb) -> arb:
    if x > 0:
        return arb(1)
    return arb(0) if x < 0 else hull(arb(0), arb(1))


def _absolute(x: arb) -> arb:
    return hull(x.abs_lower(), x.abs_upper())


def _minimum(a: arb, b: arb) -> arb:
    return hull(a.lower().min(b.lower()), a.upper().min(b.upper()))


def _maximum(a: arb, b: arb) -> arb:
    return hull(a.lower().max(b.lower()), a.upper().max(b.upper()))


def _cosh(x: arb) -> arb:
    return hull(x.abs_lower().cosh(), x.abs_upper().cosh())


BALL_FUNCTIONS: dict[str, Callable[..., arb]] = {
    "add": lambda a, b: a + b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "power": _power,
    "sin": _clip_unit(lambda x: x.sin()),
    "cos": _clip_unit(lambda x: x.cos()),
    "tan": lambda x: x.tan(),
    "tanh": _monotone(lambda x: x.tanh()),
    "sinh": _monotone(lambda x: x.sinh()),
    "cosh": _cosh,
    "exp": _monotone(lambda x: x.exp()),
    "log": lambda x: _monotone(lambda v: v.log())(x) if x > 0 else arb.nan(),
    "sqrt": lambda x: _power(x, Fraction(1, 2)),
    "abs": _absolute,
    "min": _minimum,
    "max": _maximum,
    "sat": lambda x, low, high: _maximum(low, _minimum(x, high)),
    "monod": lambda s, k: s / (k + s),
    "contois": lambda s, x, k: s / (k * x + s),
    "sign": _sign,
    "step": _step,
}

Rule = Callable[..., Expression]
_TWO = Number(2)


def _square(x: Expression) -> Expression:
    return power(x, Fraction(2))


DERIVATIVES: dict[str, tuple[Rule, ...]] = {
    "add": (lambda a, b: ONE, lambda a, b: ONE),
    "multiply": (lambda a, b: b, lambda a, b: a),
    "divide": (lambda a, b: ONE / b, lambda a, b: -(a / _square(b))),
    "sin": (lambda x: call("cos", x),),
    "cos": (lambda x: -call("sin", x),),
    "tan": (lambda x: ONE + _square(call("tan", x)),),
    "tanh": (lambda x: ONE - _square(call("tanh", x)),),
    "sinh": (lambda x: call("cosh", x),),
    "cosh": (lambda x: call("sinh", x),),
    "exp": (lambda x: call("exp", x),),
    "log": (lambda x: ONE / x,),
    "sqrt": (lambda x: ONE / (_TWO * call("sqrt", x)),),
    "abs": (lambda x: Call("sign", (x,)),),
    "monod": (lambda s, k: k / _square(k + s), lambda s, k: -(s / _square(k + s))),
    "contois": (
        lambda s, x, k: k * x / _square(k * x + s),
        lambda s, x, k: -(k * s / _square(k * x + s)),
        lambda s, x, k: -(x * s / _square(k * x + s)),
    ),
    "sign": (lambda x: ZERO,),
    "step": (lambda x: ZERO,),
}


def branch_derivative(function: str, arguments: tuple[Expression, ...], slopes: tuple[Expression, ...]) -> Expression:
    """The derivative of min, max or sat: slope_b + step(..) (slope_a - slope_b).

    Written with one step, so that its range at the kink is the hull of the two slopes.
    """

    def chosen(condition: Expression, a: Expression, b: Expression) -> Expression:
        difference = a - b
        return b if difference == ZERO else b + Call("step", (condition,)) * difference

    if function == "sat":
        x, low, high = arguments
        inner = chosen(high - x, slopes[0], slopes[2])
        # With constant limits the outer condition is x >= low.
        condition = x - low if slopes[1] == slopes[2] == ZERO else call("min", x, high) - low
        return chosen(condition, inner, slopes[1])
    a, b = arguments
    return chosen(b - a if function == "min" else a - b, slopes[0], slopes[1])


__all__ = ["BALL_FUNCTIONS", "DERIVATIVES", "MINUS_ONE", "branch_derivative", "exact_ball", "fraction_ball", "hull"]
