"""The values that cards take from YAML, as pydantic fields: exact numbers, matrices, expressions.

A number is typed as an int, a decimal or a constant expression in quotes; it becomes an `Exact`, never a
float. Errors name the entry they are about.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, WithJsonSchema

from cdobs_cli.exact.expression import Expression, ExpressionError, parse
from cdobs_cli.exact.numbers import Exact, ExactMatrix

MAX_ROWS = 64


def read_exact(value: Any) -> Exact:
    """An exact number from what a YAML reader or a caller gives.

    Raises:
        ValueError: not a finite number or constant expression.
    """
    if isinstance(value, Exact):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float | str | Fraction | Decimal | Expression):
        raise ValueError(f"a number is expected, got {value!r}")
    if isinstance(value, float | Decimal):
        if not math.isfinite(value):
            raise ValueError(f"a finite number is expected, got {value!r}")
        value = Fraction(repr(value)) if isinstance(value, float) else Fraction(value)
    try:
        exact = Exact(value)
        finite = exact.rational is not None or bool(exact.ball().is_finite())
    except (ExpressionError, ZeroDivisionError) as error:
        raise ValueError(f"{error}, got {value!r}") from None
    if not finite:
        raise ValueError(f"a finite number is expected, got {value!r}")
    return exact


def _read_matrix(value: Any) -> Any:
    return value.rows if isinstance(value, ExactMatrix) else value


def _make_matrix(rows: tuple[tuple[Exact, ...], ...]) -> ExactMatrix:
    # Lengths are judged here, once the entries are known to be good: an error is then reported once.
    if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
        raise ValueError(f"a matrix has rows of one length, got rows of {', '.join(str(len(row)) for row in rows) or 'nothing'}")
    return ExactMatrix(rows)


def _expression_reader(names: frozenset[str]) -> Callable[[Any], Expression]:
    def read(value: Any) -> Expression:
        if isinstance(value, Expression):
            if not value.variables <= names:
                raise ValueError(f"an expression in {', '.join(sorted(names))} is expected, got {value}")
            return value
        if not isinstance(value, str):
            return read_exact(value).expression
        try:
            return parse(value, names)
        except ExpressionError as error:
            raise ValueError(f"{error}, got {value!r}") from None

    return read


_NUMBER_SCHEMA = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]})

if TYPE_CHECKING:
    ExactNumber = Exact
    Rows = ExactMatrix
    ExpressionInDelta = Expression
else:
    ExactNumber = Annotated[Any, BeforeValidator(read_exact), PlainSerializer(str), _NUMBER_SCHEMA]
    Rows = Annotated[
        tuple[Annotated[tuple[ExactNumber, ...], Field(max_length=MAX_ROWS)], ...],
        Field(max_length=MAX_ROWS),
        BeforeValidator(_read_matrix),
        AfterValidator(_make_matrix),
        PlainSerializer(lambda matrix: matrix.texts()),
    ]
    ExpressionInDelta = Annotated[Any, BeforeValidator(_expression_reader(frozenset({"delta"}))), PlainSerializer(str), _NUMBER_SCHEMA]

__all__ = ["MAX_ROWS", "ExactNumber", "ExpressionInDelta", "Rows", "read_exact"]
