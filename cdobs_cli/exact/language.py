"""The functions of the expression language: one record each.

A record holds what is known of a function, and every reading is made from it: what may be typed, floats one by one or
in arrays, balls, derivatives, ranges and gradients over boxes, where it is defined, what a search over it costs, how it
is printed. A function is added here and nowhere else. Nothing here loads numpy or flint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Literal

from cdobs_cli.exact.expression import (
    MINUS_ONE,
    ONE,
    ZERO,
    Constant,
    Expression,
    Number,
    Variable,
    call,
    power,
    typed_product,
)
from cdobs_cli.exact.shapes import Cornered, Kink, Monotone, Periodic, Rule
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from flint import arb

Need = Literal["nonzero", "positive", "nonnegative"]


@dataclass(frozen=True)
class Function:
    """A function of the language, or an operation that trees are built from.

    Args:
        typed: the numbers of arguments a spec may give it; `defaults` stand for those left out after the first.
        scalar: its value for floats; raises where it has none.
        array: numpy's name for it, where that is another.
        code: how compiled code writes it, where that is no call.
        c: the name that C has for it, where that is another.
        ball: its value for balls, of a monotone or cornered function for points; None where it jumps.
        partials: the partial derivatives; none for a kink, which has those of its branches.
        shape: what ranges and boxes are made from; None for arithmetic.
        values: its rational values at integers that are known.
        rational: its value for rational numbers, where that is always rational.
        needs: what must hold for it to be defined, where its shape does not say it.
        undoes: the name of g where f(g(x)) = x wherever g is defined.
        rounded: floats are correctly rounded.
        typeset: its name on a page, with a backslash where LaTeX knows it; an index follows `_`.
    """

    name: str
    typed: tuple[int, ...] = ()
    defaults: tuple[Expression, ...] = ()
    scalar: Callable[..., float] | None = None
    array: str = ""
    code: str = ""
    c: str = ""
    ball: Callable[..., arb] | None = None
    partials: tuple[Rule, ...] = ()
    shape: Monotone | Periodic | Cornered | Kink | None = None
    values: Mapping[int, int] | None = None
    rational: Callable[..., Fraction] | None = None
    needs: Callable[..., tuple[tuple[Expression, Need], ...]] | None = None
    undoes: str = ""
    rounded: bool = False
    typeset: str = ""

    @property
    def arity(self) -> int:
        """The number of its arguments."""
        return len(self.partials) or max(self.typed)

    @property
    def slots(self) -> tuple[Expression, ...]:
        """Variables that stand for its arguments."""
        return tuple(Variable(f".{k}") for k in range(self.arity))

    @property
    def jump(self) -> tuple[Number, Number] | None:
        """The constants above and below, between which it jumps."""
        if not isinstance(self.shape, Kink):
            return None
        above, below = self.shape.above(*self.slots), self.shape.below(*self.slots)
        return (above, below) if isinstance(above, Number) and isinstance(below, Number) else None

    @property
    def is_slow(self) -> bool:
        """Whether boxes take it from balls, point by point."""
        return isinstance(self.shape, Monotone | Periodic | Cornered) and not self.rounded

    def folded(self, arguments: Sequence[Fraction]) -> Fraction | None:
        """The rational value, where it is known to be one."""
        if self.rational is not None:
            return self.rational(*arguments)
        value = (self.values or {}).get(arguments[0])  # type: ignore[call-overload]
        return None if value is None else Fraction(value)

    def derivative(self, arguments: tuple[Expression, ...], slope: Callable[[Expression], Expression]) -> Expression:
        """The derivative, where `slope` gives that of an inner expression.

        A kink has below' + step(condition) (above' - below'): with one step its range is the hull of both slopes.
        """
        if isinstance(self.shape, Kink) and not self.partials:
            below = slope(self.shape.below(*arguments))
            difference = slope(self.shape.above(*arguments)) - below
            return below if difference == ZERO else below + call("step", self.shape.condition(*arguments)) * difference
        inner = [(partial, slope(argument)) for partial, argument in zip(self.partials, arguments, strict=True)]
        return sum((partial(*arguments) * rate for partial, rate in inner if rate != ZERO), ZERO)

    def conditions(self, *arguments: Expression) -> Iterator[tuple[Expression, Need]]:
        """What must hold for the function to have a value."""
        match self.shape:
            case _ if self.needs is not None:
                yield from self.needs(*arguments)
            case Cornered(inside):
                yield inside(*arguments), "positive"
            case Monotone(image, (low, high), even=False):
                (x,) = arguments
                if isinstance(low, Fraction):
                    yield x - Number(low), "positive" if isinstance(image[0], float) else "nonnegative"
                if isinstance(high, Fraction):
                    yield Number(high) - x, "positive" if isinstance(image[1], float) else "nonnegative"


def _square(x: Expression) -> Expression:
    return power(x, Fraction(2))


def _inner_over(x: Expression, low: Expression, high: Expression) -> Expression:
    """Where this is positive, sat(x, low, high) is min(x, high), else low."""
    if isinstance(low, Number) and isinstance(high, Number) and low.value <= high.value:
        return x - low
    return call("min", x, high) - low


def _least(a: arb, b: arb) -> arb:
    return a.lower().min(b.lower()).union(a.upper().min(b.upper()))


def _largest(a: arb, b: arb) -> arb:
    return a.lower().max(b.lower()).union(a.upper().max(b.upper()))


_HALF = Fraction(1, 2)
_PI, _RIGHT = Constant("pi"), Constant("pi") / Number(2)
_UNIT, _POSITIVE = (Fraction(-1), Fraction(1)), (Fraction(0), inf)

_FUNCTIONS = (
    Function("add", ball=lambda a, b: a + b, partials=(lambda a, b: ONE, lambda a, b: ONE), code="{} + {}"),
    Function("multiply", ball=lambda a, b: a * b, partials=(lambda a, b: b, lambda a, b: a), code="{} * {}"),
    Function(
        "divide", ball=lambda a, b: a / b, code="{} / {}",
        partials=(lambda a, b: ONE / b, lambda a, b: -(a / _square(b))), needs=lambda a, b: ((b, "nonzero"),),
    ),
    # Derivatives of kinks are made of these two.
    Function(
        "sign", scalar=lambda x: 1.0 if x > 0 else -1.0 if x < 0 else 0.0, partials=(lambda x: ZERO,), typeset="sgn",
        shape=Kink(lambda x: x, lambda x: ONE, lambda x: MINUS_ONE),
    ),
    Function(
        "step", code="0.5 * sign({}) + 0.5", partials=(lambda x: ZERO,), typeset="step",
        shape=Kink(lambda x: x, lambda x: ONE, lambda x: ZERO),
    ),
    Function(
        "sin", typed=(1,), scalar=math.sin, ball=lambda x: x.sin(), partials=(lambda x: call("cos", x),),
        shape=Periodic(peak=_HALF, valley=-_HALF), values={0: 0}, undoes="asin", typeset="\\sin",
    ),
    Function(
        "cos", typed=(1,), scalar=math.cos, ball=lambda x: x.cos(), partials=(lambda x: -call("sin", x),),
        shape=Periodic(peak=Fraction(0), valley=Fraction(1)), values={0: 1}, undoes="acos", typeset="\\cos",
    ),
    Function(
        "tan", typed=(1,), scalar=math.tan, ball=lambda x: x.tan(), partials=(lambda x: ONE + _square(call("tan", x)),),
        shape=Periodic(peak=_HALF, valley=_HALF, period=1, top=inf, bottom=-inf), values={0: 0}, undoes="atan",
        needs=lambda x: ((call("cos", x), "nonzero"),), typeset="\\tan",
    ),
    Function(
        "asin", typed=(1,), scalar=math.asin, ball=lambda x: x.asin(), array="arcsin", typeset="\\arcsin",
        partials=(lambda x: ONE / call("sqrt", ONE - _square(x)),),
        shape=Monotone((-_RIGHT, _RIGHT), _UNIT), values={0: 0},
    ),
    Function(
        "acos", typed=(1,), scalar=math.acos, ball=lambda x: x.acos(), array="arccos", typeset="\\arccos",
        partials=(lambda x: -(ONE / call("sqrt", ONE - _square(x))),),
        shape=Monotone((_PI, ZERO), _UNIT), values={1: 0},
    ),
    Function(
        "atan", typed=(1,), scalar=math.atan, ball=lambda x: x.atan(), array="arctan", typeset="\\arctan",
        partials=(lambda x: ONE / (ONE + _square(x)),), shape=Monotone((-_RIGHT, _RIGHT)), values={0: 0},
    ),
    # The angle of the point (x, y). Along an edge of a box that does not meet the cut it is monotone.
    Function(
        "atan2", typed=(2,), scalar=math.atan2, ball=lambda y, x: y.atan2(y, x), array="arctan2", typeset="atan2",
        partials=(lambda y, x: x / (_square(x) + _square(y)), lambda y, x: -(y / (_square(x) + _square(y)))),
        shape=Cornered(lambda y, x: call("max", x, call("abs", y)), (-_PI, _PI)),
    ),
    Function(
        "tanh", typed=(1,), scalar=math.tanh, ball=lambda x: x.tanh(), typeset="\\tanh",
        partials=(lambda x: ONE - _square(call("tanh", x)),), shape=Monotone((MINUS_ONE, ONE)), values={0: 0},
    ),
    Function(
        "sinh", typed=(1,), scalar=math.sinh, ball=lambda x: x.sinh(), typeset="\\sinh",
        partials=(lambda x: call("cosh", x),), shape=Monotone((-inf, inf)), values={0: 0},
    ),
    Function(
        "cosh", typed=(1,), scalar=math.cosh, ball=lambda x: x.cosh(), typeset="\\cosh",
        partials=(lambda x: call("sinh", x),), shape=Monotone((ONE, inf), _POSITIVE, even=True), values={0: 1},
    ),
    Function(
        "exp", typed=(1,), scalar=math.exp, ball=lambda x: x.exp(), typeset="\\exp",
        partials=(lambda x: call("exp", x),), shape=Monotone((ZERO, inf)), values={0: 1}, undoes="log",
    ),
    Function(
        "log", typed=(1,), scalar=math.log, ball=lambda x: x.log(), typeset="\\log",
        partials=(lambda x: ONE / x,), shape=Monotone((-inf, inf), _POSITIVE), values={1: 0}, undoes="exp",
    ),
    Function(
        "log10", typed=(1,), scalar=math.log10, ball=lambda x: x.log_base(10), typeset="\\log_10",
        partials=(lambda x: ONE / (call("log", Number(10)) * x),),
        shape=Monotone((-inf, inf), _POSITIVE), values={1: 0, 10: 1},
    ),
    Function(
        "sqrt", typed=(1,), scalar=math.sqrt, ball=lambda x: x.sqrt(), rounded=True,
        partials=(lambda x: ONE / (Number(2) * call("sqrt", x)),),
        shape=Monotone((ZERO, inf), _POSITIVE), values={0: 0, 1: 1},
    ),
    Function(
        "abs", typed=(1,), scalar=abs, c="fabs", ball=lambda x: x.abs_lower().union(x.abs_upper()), rational=abs,
        partials=(lambda x: call("sign", x),), shape=Kink(lambda x: x, lambda x: x, lambda x: -x),
    ),
    Function(
        "min", typed=(2,), scalar=min, ball=_least, rational=min, array="minimum", typeset="\\min",
        shape=Kink(lambda a, b: b - a, lambda a, b: a, lambda a, b: b),
    ),
    Function(
        "max", typed=(2,), scalar=max, ball=_largest, rational=max, array="maximum", typeset="\\max",
        shape=Kink(lambda a, b: a - b, lambda a, b: a, lambda a, b: b),
    ),
    Function(
        "sat", typed=(1, 3), defaults=(MINUS_ONE, ONE), code="max({1}, min({0}, {2}))", typeset="sat",
        ball=lambda x, low, high: _largest(low, _least(x, high)), rational=lambda x, low, high: max(low, min(x, high)),
        shape=Kink(_inner_over, lambda x, low, high: call("min", x, high), lambda x, low, high: low),
    ),
)  # fmt: skip

LANGUAGE: Mapping[str, Function] = {function.name: function for function in _FUNCTIONS}
# Names for what the language already has: numbers of arguments, and the expression.
MACROS: Mapping[str, tuple[int, Rule]] = {
    "ln": (1, lambda x: call("log", x)),
    "monod": (2, lambda s, k: s / (k + s)),
    "contois": (3, lambda s, x, k: s / (typed_product(k, x) + s)),
}
# Name -> numbers of arguments a spec may give it.
TYPED_FUNCTIONS: Mapping[str, tuple[int, ...]] = {
    **{name: function.typed for name, function in LANGUAGE.items() if function.typed},
    **{name: (count,) for name, (count, _) in MACROS.items()},
}


def applied(name: str, arguments: Sequence[Expression]) -> Expression:
    """What a typed call stands for."""
    if name in MACROS:
        return MACROS[name][1](*arguments)
    defaults = LANGUAGE[name].defaults if name in LANGUAGE else ()
    return call(name, *arguments, *defaults[len(arguments) - 1 :])


_JUMP = "a jump has no slope bound, write tanh(k*x) or sat(k*x)"
CHOICE = "a choice may jump, write min, max or sat: max(x - 1, 0) is x - 1 above 1, else 0"
_TABLE = "write table(x, [[x0, y0], [x1, y1], ..]), the line through the points, or a smooth fit"
# What people write that is no function here, and what to write for it.
SUBSTITUTES: Mapping[str, str] = {
    **dict.fromkeys(("sign", "sgn", "signum", "step", "heaviside"), _JUMP),
    **dict.fromkeys(("where", "piecewise", "ifelse", "floor", "ceil", "round", "mod"), CHOICE),
    **dict.fromkeys(("lookup", "lut", "interp", "interp1", "interp1d", "spline", "pwl"), _TABLE),
    **dict.fromkeys(("clip", "clamp", "saturate", "saturation"), "write sat(x, low, high)"),
    "pow": "write x**y", "power": "write x**y", "square": "write x**2", "cbrt": "write x**(1/3)",
    "hypot": "write sqrt(x**2 + y**2)", "log2": "write log(x)/log(2)", "sigmoid": "write 1/(1 + exp(-x))",
    "arctan": "write atan(x)", "arctan2": "write atan2(y, x)", "arcsin": "write asin(x)", "arccos": "write acos(x)",
    "tg": "write tan(x)", "lg": "write log10(x)", "fabs": "write abs(x)", "expm1": "write exp(x) - 1",
    "log1p": "write log(1 + x)", "radians": "write x*pi/180", "deg2rad": "write x*pi/180",
    "degrees": "write x*180/pi", "rad2deg": "write x*180/pi", "logistic": "write 1/(1 + exp(-x))",
    "softplus": "write log(1 + exp(x))", "relu": "write max(x, 0)", "haldane": "write s/(k + s + s**2/i)",
    "cot": "write 1/tan(x)", "sec": "write 1/cos(x)", "csc": "write 1/sin(x)",
}  # fmt: skip
