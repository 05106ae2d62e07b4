"""A typed text read into the expression tree, and everything else refused.

The text is read with Python's `ast` and rebuilt, node by node, from a whitelist; nothing of it is ever
evaluated as Python. Decimals become exact rationals.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction

from cdobs_cli.exact.budget import WorkError
from cdobs_cli.exact.expression import (
    Constant,
    Expression,
    ExpressionError,
    Number,
    Power,
    Variable,
    power,
    typed_product,
)
from cdobs_cli.exact.language import CHOICE, SUBSTITUTES, applied
from cdobs_cli.exact.language import TYPED_FUNCTIONS as TYPED_FUNCTIONS

MAX_LENGTH = 2000
MAX_DEPTH = 100
MAX_DIGITS = 1000
MAX_EXPONENT = 64
MAX_DECIMAL_EXPONENT = 400
CONSTANTS = ("pi", "e")
MAX_DENOMINATOR = 10**6
_OPERATIONS: Mapping[type[ast.operator], Callable[[Expression, Expression], Expression]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: typed_product, ast.Div: operator.truediv,
}  # fmt: skip
_NUMBER = re.compile(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\Z", re.ASCII)


def nearest(name: str, allowed: Mapping[str, object] | list[str] | tuple[str, ...]) -> str:
    """`, did you mean 'x'?` or nothing."""
    import difflib

    found = difflib.get_close_matches(name, list(allowed), n=1)
    return f", did you mean {found[0]!r}?" if found else ""


def parse(
    text: str,
    names: frozenset[str] = frozenset(),
    known: Mapping[str, Expression] | None = None,
    functions: Mapping[str, tuple[int, ...]] = TYPED_FUNCTIONS,
) -> Expression:
    """Read a typed expression.

    Args:
        text: ASCII, at most 2000 characters.
        names: the variables that may occur.
        known: names that stand for closed expressions (parameters).
        functions: the functions that may be called, with their numbers of arguments.
    Raises:
        ExpressionError: with what is wrong and where in the text.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"an expression has at most {MAX_LENGTH} characters, this one {len(text)}")
    if not text.isascii() or not text.isprintable():
        raise ExpressionError("an expression is plain ASCII on one line")
    depth = deepest = 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        deepest = max(deepest, depth)
    if deepest > MAX_DEPTH or re.search(r"([-+~]\s*){20}|(not\s+){20}", text):
        raise ExpressionError(f"an expression is nested at most {MAX_DEPTH} deep")
    source = text.strip()
    if not source:
        raise ExpressionError("an expression is expected, the text is empty")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `1e` makes Python warn before it refuses
            tree = ast.parse(source, mode="eval").body
        return _Reader(source, names, known or {}, functions).read(tree, 0)
    except ExpressionError:
        raise
    except SyntaxError as error:
        raise ExpressionError("not an expression", (error.offset or 1) - 1) from None
    except WorkError:
        raise ExpressionError("an expression that is too large once its parameters are put in") from None
    except (RecursionError, MemoryError, ValueError, OverflowError):
        raise ExpressionError("an expression that cannot be read") from None


@dataclass(frozen=True)
class _Reader:
    source: str
    names: frozenset[str]
    known: Mapping[str, Expression]
    functions: Mapping[str, tuple[int, ...]]

    def read(self, node: ast.expr, depth: int) -> Expression:
        if depth > MAX_DEPTH * 3:
            raise ExpressionError("an expression is nested too deep", node.col_offset)
        if isinstance(node, ast.Constant):
            return Number(self.number(node))
        if isinstance(node, ast.Name):
            return self.name(node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            operand = self.read(node.operand, depth + 1)
            return -operand if isinstance(node.op, ast.USub) else operand
        if isinstance(node, ast.BinOp):
            return self.binary(node, depth)
        if isinstance(node, ast.Call):
            return self.call(node, depth)
        if isinstance(node, ast.IfExp | ast.Compare | ast.BoolOp):
            raise ExpressionError(CHOICE, node.col_offset)
        raise ExpressionError("only + - * / **, numbers, names and functions are allowed", node.col_offset)

    def number(self, node: ast.Constant) -> Fraction:
        text = ast.get_source_segment(self.source, node) or ""
        if isinstance(node.value, bool) or not isinstance(node.value, int | float) or not _NUMBER.match(text):
            raise ExpressionError(f"{text!r} is not a decimal number", node.col_offset)
        return read_decimal(text, node.col_offset)

    def name(self, node: ast.Name) -> Expression:
        if node.id in self.known:
            return self.known[node.id]
        if node.id in self.names:
            return Variable(node.id)
        if node.id in CONSTANTS:
            return Constant(node.id)
        allowed = sorted({*self.names, *self.known, *CONSTANTS})
        hint = f"{nearest(node.id, allowed)}; known: {', '.join(allowed)}"
        raise ExpressionError(f"unknown name {node.id!r}{hint}", node.col_offset)

    def binary(self, node: ast.BinOp, depth: int) -> Expression:
        if isinstance(node.op, ast.BitXor):
            raise ExpressionError("a power is written **, not ^", self.source.index("^", node.left.end_col_offset))
        left = self.read(node.left, depth + 1)
        right = self.read(node.right, depth + 1)
        if isinstance(node.op, ast.Pow):
            result = self.power(left, right, node)
        elif type(node.op) in _OPERATIONS:
            result = _OPERATIONS[type(node.op)](left, right)
        else:
            raise ExpressionError("only + - * / ** are allowed between values", node.col_offset)
        if isinstance(result, Number):
            check_size(result.value, node.col_offset)
        return result

    def power(self, base: Expression, exponent: Expression, node: ast.BinOp) -> Expression:
        if not isinstance(exponent, Number):
            raise ExpressionError("an exponent is a rational number, e.g. x**2 or x**(1/2)", node.right.col_offset)
        if abs(exponent.value) > MAX_EXPONENT or exponent.value.denominator > MAX_DENOMINATOR:
            what = f"an exponent p/q is at most {MAX_EXPONENT} in size, with q at most {MAX_DENOMINATOR}"
            raise ExpressionError(what, node.right.col_offset)
        if base.variables:
            return Power(base, exponent.value)
        return power(base, exponent.value)

    def call(self, node: ast.Call, depth: int) -> Expression:
        name = node.func.id if isinstance(node.func, ast.Name) else None
        if name is None or name not in self.functions:
            shown = name or ast.get_source_segment(self.source, node.func) or "?"
            known = f"{nearest(shown, self.functions)}; known: {', '.join(self.functions)}"
            hint = f": {SUBSTITUTES[shown]}" if shown in SUBSTITUTES else known
            raise ExpressionError(f"unknown function {shown!r}{hint}", node.col_offset)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise ExpressionError(f"{name} takes plain arguments", node.col_offset)
        if len(node.args) not in self.functions[name]:
            counts = " or ".join(str(count) for count in self.functions[name])
            raise ExpressionError(f"{name} takes {counts} argument(s), got {len(node.args)}", node.col_offset)
        arguments = [self.read(argument, depth + 1) for argument in node.args]
        return applied(name, arguments)


def read_decimal(text: str, offset: int = 0) -> Fraction:
    """The exact value of a decimal text like `-1.5e-3`.

    Raises:
        ExpressionError: more than 1000 digits, or an exponent beyond 400.
    """
    mantissa, _, exponent = text.lower().partition("e")
    if sum(character.isdigit() for character in mantissa) > MAX_DIGITS:
        raise ExpressionError(f"a number has at most {MAX_DIGITS} digits", offset)
    if exponent and (len(exponent) > 5 or abs(int(exponent)) > MAX_DECIMAL_EXPONENT):
        raise ExpressionError(f"a decimal exponent is at most {MAX_DECIMAL_EXPONENT}", offset)
    return Fraction(text)


def check_size(value: Fraction, offset: int = 0) -> None:
    """Refuse rationals that grew beyond use (`9**9**9` never gets this far)."""
    if max(value.numerator.bit_length(), value.denominator.bit_length()) > 3000:
        raise ExpressionError("a constant that is too large", offset)
