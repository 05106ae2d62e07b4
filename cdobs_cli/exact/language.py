"""The functions of the expression language: one record each.

A record holds what is known of a function, and every reading is made from it: what may be typed, floats one by one or
in arrays, balls, derivatives, ranges and gradients over boxes, where it is defined, what a search over it costs, how it
is printed. A function is added here and nowhere else. Nothing here loads numpy or flint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Literal

from cdobs_cli.exact.expression import MINUS_ONE, ONE, ZERO, Call, Constant, Expression, Number, Variable, call, power, typed_product

if TYPE_CHECKING:
    from flint import arb

Rule = Callable[..., Expression]
Need = Literal["nonzero", "positive", "nonnegative"]
End = Fraction | float  # a float only where it is inf or -inf


@dataclass(frozen=True)
class Monotone:
    """Strictly monotone and continuous from an interval onto another, undefined outside.

    Args:
        image: the values, or limits, at the two ends of the domain; a finite end with an infinite value does not
            belong to the domain.
        even: a function of |x|, monotone for x >= 0.
    """

    image: tuple[Expression | float, Expression | float]
    domain: tuple[End, End] = (-inf, inf)
    even: bool = False


@dataclass(frozen=True)
class Periodic:
    """Monotone between turning points: `top` at (peak + k period) pi, `bottom` at (valley + k period) pi.

    Where these are infinite the points are poles.
    """

    peak: Fraction
    valley: Fraction
    period: int = 2
    top: End = Fraction(1)
    bottom: End = Fraction(-1)


@dataclass(frozen=True)
class Cornered:
    """Extreme at the corners of every box on which `inside` > 0; undefined elsewhere. All its values lie in `image`."""

    inside: Rule
    image: tuple[Expression, Expression]


@dataclass(frozen=True)
class Kink:
    """`above` where `condition` >= 0, `below` where it is <= 0; two constants: it jumps."""

    condition: Rule
    above: Rule
    below: Rule


@dataclass(frozen=True)
class Function:
    """A function of the language, or an operation that trees are built from.

    Args:
        scalar: its value for floats; raises where it has none.
        ball: its value for balls, of a monotone or cornered function only for points; None where it jumps.
        partials: the partial derivatives; none for a kink, which has those of its branches.
        typed: the numbers of arguments a spec may give it; `defaults` are taken for those left out at the end.
        values: where a rational number gives one.
        rational: its value for rational numbers, where that is always one.
        needs: what must hold for it to be defined, where its shape does not say it.
        undoes: the name of g where f(g(x)) = x wherever g is defined.
        rounded: floats are correctly rounded.
        array: numpy's name, where it is another; `code`: how compiled code writes it, where that is no call.
        typeset: its name on a page, with a backslash where LaTeX knows it; an index follows `_`.
    """

    name: str
    scalar: Callable[..., float] | None
    ball: Callable[..., arb] | None
    partials: tuple[Rule, ...] = ()
    shape: Monotone | Periodic | Cornered | Kink | None = None
    typed: tuple[int, ...] = (1,)
    defaults: tuple[Expression, ...] = ()
    values: Mapping[int, int] | None = None
    rational: Callable[..., Fraction] | None = None
    needs: Callable[..., tuple[tuple[Expression, Need], ...]] | None = None
    undoes: str = ""
    rounded: bool = False
    array: str = ""
    code: str = ""
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

    def completed(self, arguments: Sequence[Expression]) -> tuple[Expression, ...]:
        """The typed arguments, and the defaults of those left out."""
        return (*arguments, *self.defaults)[: self.arity]

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
        total: Expression = ZERO
        for partial, argument in zip(self.partials, arguments, strict=True):
            inner = slope(argument)
            if inner != ZERO:
                total = total + partial(*arguments) * inner
        return total

    def conditions(self, *arguments: Expression) -> Iterator[tuple[Expression, Need]]:
        """What must hold for the function to have a value."""
        match self.shape:
            case _ if self.needs is not None:
                yield from self.needs(*arguments)
            case Cornered(inside):
                yield inside(*arguments), "positive"
            case Monotone(image, (low, high), even=False):
                need: tuple[Need, ...] = tuple("positive" if isinstance(value, float) else "nonnegative" for value in image)
                if isinstance(low, Fraction):
                    yield arguments[0] - Number(low), need[0]
                if isinstance(high, Fraction):
                    yield Number(high) - arguments[0], need[1]


@dataclass(frozen=True)
class Macro:
    """A name for an expression that the language already has."""

    typed: tuple[int, ...]
    expand: Rule


def _square(x: Expression) -> Expression:
    return power(x, Fraction(2))


def _radius(y: Expression, x: Expression) -> Expression:
    return _square(x) + _square(y)


def _over_limit(x: Expression, low: Expression, high: Expression) -> Expression:
    """Whether max(low, min(x, high)) is the inner one: with low <= high where x >= low."""
    if isinstance(low, Number) and isinstance(high, Number) and low.value <= high.value:
        return x - low
    return call("min", x, high) - low


def _hull(low: arb, high: arb) -> arb:
    return low.union(high)


_ORIGIN, _HALF = Fraction(0), Fraction(1, 2)
_TWO, _TEN, _PI = Number(2), Number(10), Constant("pi")
_RIGHT = _PI / _TWO  # a right angle
_ZERO_AT_ZERO = {0: 0}

_FUNCTIONS = (
    Function("add", None, lambda a, b: a + b, (lambda a, b: ONE, lambda a, b: ONE), typed=(), code="{} + {}"),
    Function("multiply", None, lambda a, b: a * b, (lambda a, b: b, lambda a, b: a), typed=(), code="{} * {}"),
    Function(
        "divide", None, lambda a, b: a / b, (lambda a, b: ONE / b, lambda a, b: -(a / _square(b))),
        typed=(), needs=lambda a, b: ((b, "nonzero"),), code="{} / {}",
    ),
    # Derivatives of kinks are made of the next two.
    Function(
        "sign", lambda x: 1.0 if x > 0 else -1.0 if x < 0 else 0.0, None, (lambda x: ZERO,), Kink(lambda x: x, lambda x: ONE, lambda x: MINUS_ONE),
        typed=(), typeset="sgn",
    ),
    Function(
        "step", None, None, (lambda x: ZERO,), Kink(lambda x: x, lambda x: ONE, lambda x: ZERO),
        typed=(), code="0.5 * sign({}) + 0.5", typeset="step",
    ),
    Function(
        "sin", math.sin, lambda x: x.sin(), (lambda x: call("cos", x),), Periodic(_HALF, -_HALF),
        values=_ZERO_AT_ZERO, undoes="asin", typeset="\\sin",
    ),
    Function(
        "cos", math.cos, lambda x: x.cos(), (lambda x: -call("sin", x),), Periodic(_ORIGIN, Fraction(1)),
        values={0: 1}, undoes="acos", typeset="\\cos",
    ),
    Function(
        "tan", math.tan, lambda x: x.tan(), (lambda x: ONE + _square(call("tan", x)),), Periodic(_HALF, _HALF, 1, inf, -inf),
        values=_ZERO_AT_ZERO, needs=lambda x: ((call("cos", x), "nonzero"),), undoes="atan", typeset="\\tan",
    ),
    Function(
        "asin", math.asin, lambda x: x.asin(), (lambda x: ONE / call("sqrt", ONE - _square(x)),),
        Monotone((-_RIGHT, _RIGHT), (Fraction(-1), Fraction(1))), values=_ZERO_AT_ZERO, array="arcsin", typeset="\\arcsin",
    ),
    Function(
        "acos", math.acos, lambda x: x.acos(), (lambda x: -(ONE / call("sqrt", ONE - _square(x))),),
        Monotone((_PI, ZERO), (Fraction(-1), Fraction(1))), values={1: 0}, array="arccos", typeset="\\arccos",
    ),
    Function(
        "atan", math.atan, lambda x: x.atan(), (lambda x: ONE / (ONE + _square(x)),), Monotone((-_RIGHT, _RIGHT)),
        values=_ZERO_AT_ZERO, array="arctan", typeset="\\arctan",
    ),
    # The angle of (x, y), away from the cut x <= 0, y = 0. On an edge of a box it is monotone, so corners are extreme.
    Function(
        "atan2", math.atan2, lambda y, x: y.atan2(y, x), (lambda y, x: x / _radius(y, x), lambda y, x: -(y / _radius(y, x))),
        Cornered(lambda y, x: call("max", x, call("abs", y)), (-_PI, _PI)), typed=(2,), array="arctan2", typeset="atan2",
    ),
    Function(
        "tanh", math.tanh, lambda x: x.tanh(), (lambda x: ONE - _square(call("tanh", x)),), Monotone((MINUS_ONE, ONE)),
        values=_ZERO_AT_ZERO, typeset="\\tanh",
    ),
    Function(
        "sinh", math.sinh, lambda x: x.sinh(), (lambda x: call("cosh", x),), Monotone((-inf, inf)),
        values=_ZERO_AT_ZERO, typeset="\\sinh",
    ),
    Function(
        "cosh", math.cosh, lambda x: x.cosh(), (lambda x: call("sinh", x),), Monotone((ONE, inf), (_ORIGIN, inf), even=True),
        values={0: 1}, typeset="\\cosh",
    ),
    Function(
        "exp", math.exp, lambda x: x.exp(), (lambda x: call("exp", x),), Monotone((ZERO, inf)),
        values={0: 1}, undoes="log", typeset="\\exp",
    ),
    Function(
        "log", math.log, lambda x: x.log(), (lambda x: ONE / x,), Monotone((-inf, inf), (_ORIGIN, inf)),
        values={1: 0}, undoes="exp", typeset="\\log",
    ),
    Function(
        "log10", math.log10, lambda x: x.log_base(10), (lambda x: ONE / (call("log", _TEN) * x),), Monotone((-inf, inf), (_ORIGIN, inf)),
        values={1: 0, 10: 1}, typeset="\\log_10",
    ),
    Function(
        "sqrt", math.sqrt, lambda x: x.sqrt(), (lambda x: ONE / (_TWO * call("sqrt", x)),), Monotone((ZERO, inf), (_ORIGIN, inf)),
        values={0: 0, 1: 1}, rounded=True,
    ),
    Function(
        "abs", abs, lambda x: _hull(x.abs_lower(), x.abs_upper()), (lambda x: call("sign", x),), Kink(lambda x: x, lambda x: x, lambda x: -x),
        rational=abs,
    ),
    Function(
        "min", min, lambda a, b: _hull(a.lower().min(b.lower()), a.upper().min(b.upper())),
        shape=Kink(lambda a, b: b - a, lambda a, b: a, lambda a, b: b), typed=(2,), rational=min, array="minimum", typeset="\\min",
    ),
    Function(
        "max", max, lambda a, b: _hull(a.lower().max(b.lower()), a.upper().max(b.upper())),
        shape=Kink(lambda a, b: a - b, lambda a, b: a, lambda a, b: b), typed=(2,), rational=max, array="maximum", typeset="\\max",
    ),
    Function(
        "sat", None, lambda x, low, high: _hull(low.lower().max(x.lower().min(high.lower())), low.upper().max(x.upper().min(high.upper()))),
        shape=Kink(_over_limit, lambda x, low, high: call("min", x, high), lambda x, low, high: low),
        typed=(1, 3), defaults=(MINUS_ONE, ONE), rational=lambda x, low, high: max(low, min(x, high)), code="max({1}, min({0}, {2}))",
        typeset="sat",
    ),
)  # fmt: skip

LANGUAGE: Mapping[str, Function] = {function.name: function for function in _FUNCTIONS}
MACROS: Mapping[str, Macro] = {
    "ln": Macro((1,), lambda x: call("log", x)),
    "monod": Macro((2,), lambda s, k: s / (k + s)),
    "contois": Macro((3,), lambda s, x, k: s / (typed_product(k, x) + s)),
}
# Name -> numbers of arguments a spec may give it.
TYPED_FUNCTIONS: Mapping[str, tuple[int, ...]] = {name: one.typed for name, one in {**LANGUAGE, **MACROS}.items() if one.typed}


def applied(name: str, arguments: Sequence[Expression]) -> Expression:
    """What a typed call stands for."""
    if name in MACROS:
        return MACROS[name].expand(*arguments)
    return call(name, *(LANGUAGE[name].completed(arguments) if name in LANGUAGE else arguments))


_JUMP = "a jump has no slope bound, write tanh(k*x) or sat(k*x)"
CHOICE = "a choice may jump, write min, max or sat"
_TABLE = "write a polynomial, or a sum of max, min and sat pieces"
# What people write that is no function here, and what to write for it.
SUBSTITUTES: Mapping[str, str] = {
    **dict.fromkeys(("sign", "sgn", "signum", "step", "heaviside"), _JUMP),
    **dict.fromkeys(("where", "piecewise", "ifelse", "floor", "ceil", "round", "mod"), CHOICE),
    **dict.fromkeys(("table", "lookup", "interp", "interp1", "interp1d", "spline", "pwl"), _TABLE),
    **dict.fromkeys(("clip", "clamp", "saturate", "saturation"), "write sat(x, low, high)"),
    "pow": "write x**y", "power": "write x**y", "square": "write x**2", "cbrt": "write x**(1/3)",
    "hypot": "write sqrt(x**2 + y**2)", "log2": "write log(x)/log(2)", "sigmoid": "write 1/(1 + exp(-x))",
    "cot": "write 1/tan(x)", "sec": "write 1/cos(x)", "csc": "write 1/sin(x)",
}  # fmt: skip
