"""The values that cards and spec blocks take from YAML, as pydantic fields: exact numbers, matrices, expressions.

    gain: Rows | None = None          period: PositiveNumber          c: Annotated[Expression, formula("states")]

A number is an int, a decimal or a constant expression in quotes; it becomes an `Exact`, never a float.
Validation takes a context (a dict) with `parameters` (name -> closed Expression), `states` and `inputs`
(names): parameters may stand in every number and formula. Nothing here loads numpy, nor flint while every
constant is rational.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BeforeValidator,
    GetCoreSchemaHandler,
    PlainSerializer,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
)
from pydantic_core import PydanticCustomError, core_schema

from cdobs_cli.exact.expression import Call, Expression, ExpressionError, Number, Power, Variable
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import CONSTANTS, TYPED_FUNCTIONS, parse
from cdobs_cli.exact.units import plain_number

MAX_ROWS = 256
LONGEST_SHOWN = 60  # characters of entries that are shown in the shape they should have
MAX_TREE = 20_000
MAX_TREE_DEPTH = 400
LARGEST = Fraction(10) ** 100
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def wrong(what: str, hint: str | None = None) -> PydanticCustomError:
    """The error of a value that has the right type and the wrong content; hint: what to write."""
    told = {"what": what} if hint is None else {"what": what, "hint": hint}
    return PydanticCustomError("value", "{what}", told)


def bounded(expression: Expression) -> Expression:
    """The expression, unless it is too large, or a constant in it is undefined or beyond 1e-100..1e100.

    Raises:
        ExpressionError: with what is wrong.
    """
    size: dict[Expression, tuple[int, int]] = {}
    for node in expression.walk():
        inner = [size[child] for child in node.children]
        size[node] = (1 + sum(count for count, _ in inner), 1 + max((depth for _, depth in inner), default=0))
        if size[node][0] > MAX_TREE or size[node][1] > MAX_TREE_DEPTH:
            raise ExpressionError("an expression that is too large once its parameters are put in")
    closed: dict[Expression, bool] = {}
    for node in expression.walk():
        # Random draws of a noise are no functions of the language: they have no one value.
        constant = not isinstance(node, Variable) and (not isinstance(node, Call) or node.function in LANGUAGE)
        closed[node] = constant and all(closed[child] for child in node.children)
        if isinstance(node, Number):
            _check_magnitude(node.value)
    outermost = {child for node in closed if not closed[node] for child in node.children if closed[child]}
    for node in outermost | ({expression} if closed[expression] else set()):
        if isinstance(node, Call | Power):
            ball = node.ball({})
            if not ball.is_finite():
                raise ExpressionError(f"{node} has no finite value")
            if float(abs(ball).lower()) > 1e100:
                raise ExpressionError("a number beyond 1e100")
    return expression


def _check_magnitude(value: Fraction) -> None:
    if abs(value) > LARGEST:
        raise ExpressionError("a number beyond 1e100")
    if value and abs(value) * LARGEST < 1:
        raise ExpressionError("a number below 1e-100 that is not zero")


def context(info: ValidationInfo, key: str) -> Any:
    """What the validation was given under a key; None where nothing was."""
    return (info.context or {}).get(key)


def read_expression(
    text: str,
    names: Iterable[str],
    known: Mapping[str, Expression],
    functions: Mapping[str, tuple[int, ...]] = TYPED_FUNCTIONS,
) -> Expression:
    """Parse and bound an expression; its mistakes become field errors.

    Raises:
        PydanticCustomError: with what is wrong.
    """
    try:
        return bounded(parse(text, frozenset(names), known, functions))
    except ExpressionError as error:
        place = f" (at character {error.offset + 1})" if error.offset else ""
        raise wrong(f"{error}{place}", error.hint) from None


def read_exact(value: Any, parameters: Mapping[str, Expression] | None = None, time_unit: str = "s") -> Exact:
    """An exact number from what a YAML reader or a caller gives; a float stands for its shortest decimal.

    time_unit: what a number with a unit of time is shown in, where it is refused.

    Raises:
        PydanticCustomError: not a finite number or constant expression.
    """
    if isinstance(value, Exact):
        return value
    if isinstance(value, float) and math.isfinite(value):
        value = repr(value)
    if isinstance(value, bool) or not isinstance(value, int | str | Fraction | Expression):
        raise wrong("a number is expected")
    if isinstance(value, str):
        if (plain := plain_number(value, time_unit, {*CONSTANTS, *(parameters or ())})) is not None:
            raise wrong("a number without a unit is expected", plain)
        return Exact(read_expression(value, (), parameters or {}))
    try:
        return Exact(bounded(value if isinstance(value, Expression) else Number(value)))
    except ExpressionError as error:
        raise wrong(str(error)) from None


def _read_number(value: Any, info: ValidationInfo) -> Exact:
    return read_exact(value, context(info, "parameters"), context(info, "time_unit") or "s")


def _signed(what: str, *signs: int) -> AfterValidator:
    def check(value: Exact) -> Exact:
        if value.sign() not in signs:
            raise wrong(f"{what} is expected")
        return value

    return AfterValidator(check)


_NUMBER_WORDS = 'A number, or a constant expression in quotes: "sqrt(2)", "1/8".'
_NUMBER_SCHEMA = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}], "description": _NUMBER_WORDS})
ExactNumber = Annotated[Exact, PlainValidator(_read_number), PlainSerializer(str), _NUMBER_SCHEMA]
"""A real number, exact: a decimal, an integer, or a constant expression as text."""
PositiveNumber = Annotated[ExactNumber, _signed("a positive number", 1)]
NonNegativeNumber = Annotated[ExactNumber, _signed("a number that is not negative", 0, 1)]


def sized(smallest: int, largest: int) -> BeforeValidator:
    """A list of so many entries; told once, whatever its entries are."""

    def check(value: Any) -> Any:
        if isinstance(value, list | tuple) and not smallest <= len(value) <= largest:
            raise wrong(f"a list of {smallest} to {largest} entries is expected, this one has {len(value)}")
        return value

    return BeforeValidator(check)


Vector = Annotated[tuple[ExactNumber, ...], sized(1, MAX_ROWS)]


class Through:
    """A field read as one shape and turned into another type."""

    def __init__(self, shape: Any, make: Callable[[Any], Any], back: Callable[[Any], Any]) -> None:
        self.shape, self.make, self.back = shape, make, back

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        inner = core_schema.no_info_before_validator_function(self.back, handler.generate_schema(self.shape))
        return core_schema.no_info_after_validator_function(self.make, inner)


def _matrix(rows: tuple[tuple[Exact, ...], ...]) -> ExactMatrix:
    if len({len(row) for row in rows}) != 1:
        raise wrong(f"rows of one length are expected, these have {', '.join(str(len(row)) for row in rows)}")
    return ExactMatrix(rows)


def _rows(value: Any) -> Any:
    return value.rows if isinstance(value, ExactMatrix) else value


def rows_of(value: Any, info: ValidationInfo) -> Any:
    """A number, or a list of numbers, in place of a matrix is refused, and shown as one."""
    if isinstance(value, bool) or not isinstance(value, int | str | list) or value == []:
        return value
    listed = value if isinstance(value, list) else [value]
    if any(isinstance(one, list | tuple | dict | Exact) for one in listed):
        return value
    name, told = info.field_name or "", as_rows(info.field_name or "", listed)
    raise wrong("a matrix is expected: a list of rows, each a list", f"write {name}: {told}" if name and told else None)


def as_rows(name: str, listed: list[Any]) -> str | None:
    """Numbers as one row, or as the column or the diagonal that a matrix of this name is; None of many."""
    entries = ["0" if one is None else str(one) for one in listed]
    if sum(map(len, entries)) > LONGEST_SHOWN:
        return None
    if name in ("covariance", "intensity"):
        rows = [["0"] * k + [one] + ["0"] * (len(entries) - k - 1) for k, one in enumerate(entries)]
    else:
        rows = [[one] for one in entries] if name in ("K", "L", "B") else [entries]
    return f"[{', '.join('[' + ', '.join(row) + ']' for row in rows)}]"


_Table = Annotated[tuple[Vector, ...], sized(1, MAX_ROWS)]
Rows = Annotated[
    ExactMatrix, Through(_Table, _matrix, _rows), PlainSerializer(ExactMatrix.texts), BeforeValidator(rows_of)
]
"""A matrix of exact numbers: a list of rows of one length."""


def formula(*names: str, functions: Mapping[str, tuple[int, ...]] = TYPED_FUNCTIONS) -> Any:
    """Annotation of an Expression field: `Annotated[Expression, formula("states", "inputs")]`.

    Args:
        names: variables that may occur; `states`, `inputs` and `coordinates` (the states that A and phi are in)
            stand for the plant's, from the context.
        functions: the functions that may be called, with their numbers of arguments.
    """

    def read(value: Any, info: ValidationInfo) -> Expression:
        if isinstance(value, Expression):
            return value
        if isinstance(value, bool) or not isinstance(value, int | str):
            raise wrong("an expression is expected")
        text = str(value)
        allowed: set[str] = set()
        for name in names:
            if name not in ("states", "inputs", "coordinates"):
                allowed.add(name)
            elif (listed := context(info, name)) is not None:
                allowed.update(listed)
            else:
                # Made in code, outside a spec: any name is taken.
                allowed.update(set(NAME.findall(text)) - {*functions, *CONSTANTS})
        known = {name: value for name, value in (context(info, "parameters") or {}).items() if name not in allowed}
        try:
            return read_expression(text, allowed, known, functions)
        except PydanticCustomError as error:
            raise _with_states(error, allowed, info) from None

    return _Formula(read)


def _with_states(error: PydanticCustomError, allowed: set[str], info: ValidationInfo) -> PydanticCustomError:
    """Of a state in other coordinates than those of the expression: what the states are called there."""
    told = (error.context or {}).get("what", "")
    named = {key: set(context(info, key) or ()) for key in ("states", "coordinates")}
    others = set().union(*named.values()) - allowed
    here = next((names for names in named.values() if names and names <= allowed), None)
    if here is None or not any(told.startswith(f"unknown name {name!r}") for name in others):
        return error
    return wrong(told, f"in this expression the states are {', '.join(sorted(here))}")


class _Formula:
    def __init__(self, read: Callable[[Any, ValidationInfo], Expression]) -> None:
        self.read = read

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return {"anyOf": [{"type": "string"}, {"type": "number"}], "description": "An expression."}


ExpressionInDelta = Annotated[Expression, formula("delta"), PlainSerializer(str)]
