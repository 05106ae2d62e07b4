"""The safe expression tree: what a spec may write, in floats, in balls, and differentiated.

`parser.py` makes it from a typed text.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from decimal import Context, Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar, cast
from weakref import WeakValueDictionary

from cdobs_cli.exact.budget import WorkError, spend

if TYPE_CHECKING:
    from flint import arb


N = TypeVar("N", bound="Expression")
T = TypeVar("T")
MAX_DEPTH = 600  # what recursion over a tree can take
MAX_ROOT = 12  # exponents with larger denominators are decimals, not roots


class ExpressionError(ValueError):
    """A text outside the expression language; `offset` counts characters from its start, `hint` says what to write."""

    def __init__(self, message: str, offset: int = 0, hint: str | None = None) -> None:
        super().__init__(message)
        self.offset, self.hint = offset, hint


class Expression:
    """A node of the tree: immutable, combined by + - * / and unary minus.

    Equal trees are one object, so that comparing is free however much two of them share. `size` counts the nodes
    of the tree written out, `depth` its levels.
    """

    __slots__ = ("__weakref__", "children", "depth", "size")
    children: tuple[Expression, ...]
    size: int
    depth: int

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, name) for name in self.__slots__)

    def __neg__(self) -> Expression:
        return Number(-self.value) if isinstance(self, Number) else multiply(MINUS_ONE, self)

    def __add__(self, other: Expression) -> Expression:
        return add(self, other)

    def __sub__(self, other: Expression) -> Expression:
        return add(self, -other)

    def __mul__(self, other: Expression) -> Expression:
        return multiply(self, other)

    def __truediv__(self, other: Expression) -> Expression:
        return divide(self, other)

    def __str__(self) -> str:
        spend(self.size)
        return _text(self, 0)

    def __repr__(self) -> str:
        return f"Expression({str(self)!r})"

    def walk(self, done: Container[Expression] = ()) -> Iterator[Expression]:
        """Every distinct node, children before parents, but those that are done and what only these are made of."""
        seen: set[Expression] = set()
        stack: list[tuple[Expression, bool]] = [(self, False)]
        while stack:
            node, ready = stack.pop()
            if node in seen or node in done:
                continue
            if ready:
                seen.add(node)
                yield node
            else:
                stack.append((node, True))
                stack.extend((child, False) for child in node.children)

    @property
    def variables(self) -> frozenset[str]:
        """Names of the variables that occur."""
        return frozenset(node.name for node in self.walk() if isinstance(node, Variable))

    def read(
        self,
        leaf: Callable[[Expression], T],
        raised: Callable[[T, Fraction], T],
        functions: Mapping[str, Callable[..., T]],
        memo: dict[Expression, T] | None = None,
    ) -> T:
        """The value in some arithmetic, by its leaves, powers and functions; `memo` holds what is known already."""
        memo = {} if memo is None else memo
        for node in self.walk(memo):
            if isinstance(node, Call):
                memo[node] = functions[node.function](*[memo[child] for child in node.children])
            elif isinstance(node, Power):
                memo[node] = raised(memo[node.base], node.exponent)
            else:
                memo[node] = leaf(node)
        return memo[self]

    def ball(self, env: Mapping[str, arb], memo: dict[Expression, arb] | None = None) -> arb:
        """Enclosure of the value where every variable lies in its ball; not finite where undefined.

        `memo` may be shared between expressions evaluated at the same `env`.
        """
        from cdobs_cli.exact.functions import BALL_FUNCTIONS, exact_ball, power_ball

        def leaf(node: Expression) -> arb:
            return env[node.name] if isinstance(node, Variable) else exact_ball(node)

        return self.read(leaf, power_ball, BALL_FUNCTIONS, memo)

    def derivative(self, name: str) -> Expression:
        """The partial derivative; abs, min, max and sat give `sign` and `step`, whose balls enclose
        the Clarke gradient where they jump."""
        from cdobs_cli.exact.language import LANGUAGE

        memo: dict[Expression, Expression] = {}

        def slope(expression: Expression) -> Expression:
            for node in expression.walk(memo):
                spend(3)
                if isinstance(node, Variable):
                    memo[node] = ONE if node.name == name else ZERO
                elif isinstance(node, Power):
                    inner = memo[node.base]
                    below = power(node.base, node.exponent - 1) if inner != ZERO else ZERO
                    memo[node] = Number(node.exponent) * below * inner
                elif isinstance(node, Call):
                    memo[node] = LANGUAGE[node.function].derivative(node.children, slope)
                else:
                    memo[node] = ZERO
            return memo[expression]

        return slope(self)

    def substitute(self, env: Mapping[str, Expression]) -> Expression:
        """The expression with variables replaced; constants fold."""
        return self.replaced({Variable(name): value for name, value in env.items()})

    def replaced(self, values: Mapping[Expression, Expression]) -> Expression:
        """The expression with nodes replaced; constants fold."""
        memo = dict(values)
        for node in self.walk(values):
            spend(1)
            memo[node] = node.over(memo)
        return memo[self]

    def over(self, values: Mapping[Expression, Expression]) -> Expression:
        """The node with the values of its children, folded."""
        return self


_KNOWN: WeakValueDictionary[tuple[object, ...], Expression] = WeakValueDictionary()


def _node(kind: type[N], children: tuple[Expression, ...], *content: object) -> N:
    """The one node with these children and this content.

    Raises: WorkError: the tree is too deep to be worked with.
    """
    key = (kind, content, children)
    known = _KNOWN.get(key)
    if known is not None:
        return cast(N, known)
    node = object.__new__(kind)
    node.children = children
    node.size = 1 + sum(child.size for child in children)
    node.depth = 1 + max((child.depth for child in children), default=0)
    if node.depth > MAX_DEPTH:
        raise WorkError
    for name, value in zip(kind.__slots__, content, strict=True):
        setattr(node, name, value)
    _KNOWN[key] = node
    return node


class Number(Expression):
    """An exact rational."""

    __slots__ = ("value",)
    value: Fraction

    def __new__(cls, value: Fraction | int) -> Number:
        return _node(cls, (), Fraction(value))


class Constant(Expression):
    """`pi` or `e`."""

    __slots__ = ("name",)
    name: str

    def __new__(cls, name: str) -> Constant:
        return _node(cls, (), name)


class Variable(Expression):
    """A named variable."""

    __slots__ = ("name",)
    name: str

    def __new__(cls, name: str) -> Variable:
        return _node(cls, (), name)


class Power(Expression):
    """base ** exponent with a rational exponent."""

    __slots__ = ("base", "exponent")
    base: Expression
    exponent: Fraction

    def __new__(cls, base: Expression, exponent: Fraction) -> Power:
        return _node(cls, (base,), base, exponent)

    def over(self, values: Mapping[Expression, Expression]) -> Expression:
        return power(values[self.base], self.exponent)


class Call(Expression):
    """A function of the language, or one of add, multiply, divide, sign, step."""

    __slots__ = ("function",)
    function: str

    def __new__(cls, function: str, arguments: tuple[Expression, ...]) -> Call:
        return _node(cls, arguments, function)

    def __reduce__(self) -> tuple[Any, ...]:
        return Call, (self.function, self.children)

    def over(self, values: Mapping[Expression, Expression]) -> Expression:
        return call(self.function, *[values[child] for child in self.children])


ZERO, ONE, MINUS_ONE = Number(0), Number(1), Number(-1)


def add(a: Expression, b: Expression) -> Expression:
    """a + b, with rational constants folded."""
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value + b.value)
    if a == ZERO:
        return b
    return a if b == ZERO else Call("add", (a, b))


def multiply(a: Expression, b: Expression) -> Expression:
    """a b, with rational constants folded. (0 times an undefined value folds to 0: definedness is
    judged on the typed tree, before any folding of variables.)"""
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value * b.value)
    if ZERO in (a, b):
        return ZERO
    if a == ONE:
        return b
    return a if b == ONE else Call("multiply", (a, b))


def divide(a: Expression, b: Expression) -> Expression:
    """a / b, with rational constants folded.

    Raises:
        ExpressionError: b is the number zero.
    """
    if b == ZERO:
        raise ExpressionError("division by zero")
    if isinstance(a, Number) and isinstance(b, Number):
        return Number(a.value / b.value)
    return a if b == ONE else Call("divide", (a, b))


def power(base: Expression, exponent: Fraction) -> Expression:
    """base ** exponent, folded where it stays rational."""
    if exponent == 0:
        return ONE
    if exponent == 1:
        return base
    if isinstance(base, Number) and exponent.denominator == 1:
        if base.value == 0 and exponent < 0:
            raise ExpressionError("division by zero")
        return Number(base.value**exponent.numerator)
    return Power(base, exponent)


def call(function: str, *arguments: Expression) -> Expression:
    """A function applied, folded where its value is known to be rational."""
    if function in _ARITHMETIC:
        return _ARITHMETIC[function](*arguments)
    values = [argument.value for argument in arguments if isinstance(argument, Number)]
    if len(values) == len(arguments):
        from cdobs_cli.exact.language import LANGUAGE

        known = LANGUAGE.get(function)
        value = known.folded(values) if known is not None else None
        if value is not None:
            return Number(value)
    return Call(function, arguments)


_ARITHMETIC: dict[str, Callable[[Expression, Expression], Expression]] = {
    "add": add, "multiply": multiply, "divide": divide,
}  # fmt: skip


def negated(node: Expression) -> Expression | None:
    """x where the node is -x: a negative number, or a product with -1."""
    if isinstance(node, Number):
        return Number(-node.value) if node.value < 0 else None
    is_product = isinstance(node, Call) and node.function == "multiply"
    return node.children[1] if is_product and node.children[0] == MINUS_ONE else None


def terms(total: Expression) -> list[Expression]:
    """The terms of a sum, each with its sign."""
    found, open_nodes = [], [(total, False)]
    while open_nodes:
        node, turned = open_nodes.pop()
        if isinstance(node, Call) and node.function == "add":
            open_nodes += [(child, turned) for child in reversed(node.children)]
        elif isinstance(node, Call) and (inner := negated(node)) is not None:
            open_nodes.append((inner, not turned))
        else:
            found.append(-node if turned else node)
    return found


def typed_product(a: Expression, b: Expression) -> Expression:
    """a b, not folded where that would hide a variable: definedness is judged on the typed tree."""
    return Call("multiply", (a, b)) if ZERO in (a, b) and (a.variables or b.variables) else a * b


def plain_decimal(value: Decimal) -> str:
    """A decimal without needless zeros; exponents only where the plain form would be long."""
    if value == 0:
        return "0"
    value = value.normalize(Context(prec=max(1, len(value.as_tuple().digits))))
    exponent = value.adjusted()
    return format(value, "f") if -7 < exponent < 16 else format(value, "e").replace("e+", "e")


def fraction_text(value: Fraction) -> str:
    """The decimal when it ends within 60 significant digits, else p/q; reads back to the same number."""
    denominator, twos, fives = value.denominator, 0, 0
    while denominator % 2 == 0:
        denominator, twos = denominator // 2, twos + 1
    while denominator % 5 == 0:
        denominator, fives = denominator // 5, fives + 1
    places = max(twos, fives)
    digits = value.numerator * 10**places // value.denominator
    while digits and digits % 10 == 0:
        digits, places = digits // 10, places - 1
    if denominator != 1 or len(str(abs(digits))) > 60:
        return str(value)
    return plain_decimal(Decimal(digits).scaleb(-places, Context(prec=400)))


def exponent_text(value: Fraction) -> str:
    """A root as p/q, what is no root as a decimal."""
    return str(value) if value.denominator <= MAX_ROOT else fraction_text(value)


_INFIX = {"add": ("+", 1), "multiply": ("*", 2), "divide": ("/", 2)}


def _text(node: Expression, level: int) -> str:
    if isinstance(node, Number):
        text = fraction_text(node.value)
        return f"({text})" if (node.value < 0 or "/" in text) and level > 0 else text
    if isinstance(node, Constant | Variable):
        return node.name
    if isinstance(node, Power):
        exponent = exponent_text(node.exponent)
        exponent = f"({exponent})" if node.exponent < 0 or "/" in exponent else exponent
        text = f"{_text(node.base, 4)}**{exponent}"
        return f"({text})" if level > 3 else text
    assert isinstance(node, Call)
    if node.function not in _INFIX:
        arguments = []
        for child in node.children:  # no generator: it would take a frame of its own at each level
            arguments.append(_text(child, 0))
        return f"{node.function}({', '.join(arguments)})"
    sign, own = _INFIX[node.function]
    left, right = node.children
    if negated(node) is not None:
        text = f"-{_text(right, 3)}"
        return f"({text})" if level > 0 else text
    taken = negated(right) if node.function == "add" else None
    if taken is not None:
        text = f"{_text(left, own)} - {_text(taken, 2)}"
        return f"({text})" if level > own else text
    # a * (b / c) must keep its brackets: the printed text is read back to the same tree.
    same = {"multiply": ("multiply", "divide"), "add": ("add",), "divide": ()}[node.function]
    if isinstance(right, Call) and right.function in same:
        inner = f"({_text(right, 0)})"
    else:
        inner = _text(right, own + (node.function == "divide"))
    text = f"{_text(left, own)} {sign} {inner}"
    return f"({text})" if level > own else text
