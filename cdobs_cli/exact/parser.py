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
from cdobs_cli.exact.table import MAX_POINTS, USAGE, table
from cdobs_cli.records import dataclass

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
# A decimal, or a quotient of one by a whole number: most of what artefacts hold, and quick to read.
_PLAIN = re.compile(r"(-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?)(?:/([1-9]\d*))?\Z", re.ASCII)
_NUMBER = re.compile(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\Z", re.ASCII)


def nearest(name: str, allowed: Mapping[str, object] | list[str] | tuple[str, ...]) -> str:
    """`, did you mean 'x'?` or nothing."""
    import difflib

    found = difflib.get_close_matches(name, list(allowed), n=1)
    found = found or [one for one in allowed if one.lower() == name.lower()]
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
        raise _not_plain(text)
    source = text.strip()
    plain = _PLAIN.match(source)
    if plain is not None:
        return Number(_quotient(*plain.groups()))
    depth = deepest = 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        deepest = max(deepest, depth)
    if deepest > MAX_DEPTH or re.search(r"([-+~]\s*){20}|(not\s+){20}", text):
        raise ExpressionError(f"an expression is nested at most {MAX_DEPTH} deep")
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
        raise ExpressionError("not an expression", (error.offset or 1) - 1, _closer(source)) from None
    except WorkError:
        raise ExpressionError("an expression that is too large once its parameters are put in") from None
    except (RecursionError, MemoryError, ValueError, OverflowError):
        raise ExpressionError("an expression that cannot be read") from None


def _quotient(decimal: str, whole: str | None) -> Fraction:
    value = read_decimal(decimal)
    if whole is not None:
        value /= read_decimal(whole, len(decimal) + 1)
        check_size(value)
    return value


_SIGNS = {"\u00b2": "**2", "\u00b3": "**3", "\u00b7": "*", "\u00d7": "*", "\u2212": "-", "\u221a": "sqrt"}
# A factor, and another behind it without a sign between.
_LEFT_OUT = re.compile(r"((?<![\w.])(\d+\.?\d*|\.\d+)(?![eE][-+\d])\s*|[\w)]\s+|\)\s*)(?=[A-Za-z(])", re.ASCII)
LONGEST_SHOWN = 60  # characters of an expression that is shown as it should be


def _not_plain(text: str) -> ExpressionError:
    """Signs that keyboards or word processors put in, and what they stand for."""
    at = next(k for k, one in enumerate(text) if not (one.isascii() and one.isprintable()))
    sign = _SIGNS.get(text[at])
    hint = None if sign is None else f"write {sign} there"
    return ExpressionError("an expression is plain ASCII on one line", at, hint)


def _closer(source: str) -> str | None:
    """What was meant by a text that is no expression, where that is plain."""
    if source.count("(") != source.count(")"):
        few = "(" if source.count("(") < source.count(")") else ")"
        return f"a {few} is missing; in a list an expression that holds a comma stands in quotes"
    if re.search(r"\|[^|]+\|", source):
        return "an absolute value is written abs(x)"
    if (called := re.search(rf"\b({'|'.join(TYPED_FUNCTIONS)})\s+[\w(]", source, re.ASCII)) is not None:
        return f"a function is written {called.group(1)}(x)"
    if re.search(r"[<>=!]=?", source):
        return "the value alone is expected, without = and without comparisons"
    if re.search(r"\b(if|else|and|or|not|for|lambda|in|is)\b", source):
        return CHOICE
    left_out = _LEFT_OUT.search(source)
    if left_out is not None:
        product = f"{source[: left_out.end()].rstrip()}*{source[left_out.end() :]}"
        return f"a product is written with *: {product}" if len(product) <= LONGEST_SHOWN else "a product is written *"
    return None


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
        what = "only + - * / **, numbers, names and functions are allowed"
        raise ExpressionError(what, node.col_offset, _other(node, self.source))

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
        close = nearest(node.id, allowed)
        raise ExpressionError(
            f"unknown name {node.id!r}{close}; known: {', '.join(allowed)}", node.col_offset,
            self.declaration(node.id) if not close else None,
        )  # fmt: skip

    def declaration(self, name: str) -> str:
        """Where a name that is not known would be declared."""
        if name in self.functions:
            count = self.functions[name][0]
            return f"{name} is a function: write {name}({', '.join('xyz'[:count])})"
        if name.lower() in ("nan", "inf", "infinity"):
            return "a finite number is expected"
        if name == "t" and "t_k" in self.names:
            return "the time of a sample is t_k"
        if name == "t" and self.names:
            return "what depends on time is a known input: plant.inputs, and its signal in simulation.signals"
        constant = f"a constant is declared in plant.parameters: {{{name}: number}}"
        return f"{constant}, a known input in plant.inputs" if self.names else constant

    def binary(self, node: ast.BinOp, depth: int) -> Expression:
        if isinstance(node.op, ast.BitXor):
            power = self.source.replace("^", "**")
            hint = f"write {power}" if len(power) <= LONGEST_SHOWN else None
            place = self.source.index("^", node.left.end_col_offset)
            raise ExpressionError("a power is written **, not ^", place, hint)
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
        if name == "table" and "max" in self.functions:
            return self.table(node, depth)
        if name is None or name not in self.functions:
            shown = name or ast.get_source_segment(self.source, node.func) or "?"
            raise self.unknown_function(shown, node.col_offset)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise ExpressionError(f"{name} takes plain arguments", node.col_offset)
        if len(node.args) not in self.functions[name]:
            counts = " or ".join(str(count) for count in self.functions[name])
            raise ExpressionError(f"{name} takes {counts} argument(s), got {len(node.args)}", node.col_offset)
        arguments = [self.read(argument, depth + 1) for argument in node.args]
        return applied(name, arguments)

    def table(self, node: ast.Call, depth: int) -> Expression:
        """`table(x, [[x0, y0], [x1, y1], ..])`, points of rational numbers."""
        pairs = node.args[1].elts if len(node.args) == 2 and isinstance(node.args[1], ast.List) else None
        if pairs is None or node.keywords or not all(isinstance(one, ast.List) and len(one.elts) == 2 for one in pairs):
            raise ExpressionError("a table is read at x between points", node.col_offset, USAGE)
        if len(pairs) > MAX_POINTS:
            raise ExpressionError(f"a table has at most {MAX_POINTS} points", node.col_offset)
        points = [[self.read(end, depth + 1) for end in one.elts] for one in pairs if isinstance(one, ast.List)]
        numbers = [(x.value, y.value) for x, y in points if isinstance(x, Number) and isinstance(y, Number)]
        if len(numbers) < len(points):
            raise ExpressionError("the points of a table are rational numbers", node.col_offset, USAGE)
        try:
            return table(self.read(node.args[0], depth + 1), numbers)
        except ExpressionError as error:
            raise ExpressionError(str(error), error.offset or node.col_offset, error.hint) from None

    def unknown_function(self, shown: str, place: int) -> ExpressionError:
        """With what to write for it; `np.sin` is sin."""
        short = shown.rpartition(".")[2].lower()
        if shown[0].isdigit():
            return ExpressionError("a product is written with *", place, f"write {shown}*(..)")
        if short in SUBSTITUTES:
            return ExpressionError(f"unknown function {shown!r}: {SUBSTITUTES[short]}", place)
        if short in self.functions and short != shown:
            return ExpressionError(f"unknown function {shown!r}: write {short}", place)
        known = f"{nearest(shown, self.functions)}; known: {', '.join(self.functions)}"
        hint = f"a product is written {shown}*(..)" if shown in {*self.names, *self.known, *CONSTANTS} else None
        return ExpressionError(f"unknown function {shown!r}{known}", place, hint)


def _other(node: ast.expr, source: str) -> str | None:
    """What to write for a Python expression that is none of ours."""
    if isinstance(node, ast.Tuple) and re.fullmatch(r"[-+]?\d+,\s?\d+", source):
        return f"a decimal point is written '.': {re.sub(r', ?', '.', source)}"
    if isinstance(node, ast.Subscript):
        return "an entry of a vector is called by its name, such as x1"
    return None


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
