"""Bounds of slopes as they are typed: c, [lower, upper], auto."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, PlainValidator, Tag, ValidationInfo, WithJsonSchema

from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.fields import NAME, context, read_exact, rows_of, sized, wrong
from cdobs_cli.plant import Slopes
from cdobs_cli.spec.boxes import MAX_STATES, ordered


def _slope(value: Any, info: ValidationInfo) -> tuple[Exact, Exact] | None:
    """c as (-c, c), [lower, upper], None for auto."""
    parameters = context(info, "parameters")
    if value == "auto":
        return None
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise wrong("a slope is a number, [lower, upper] or auto")
        lower, upper = (read_exact(end, parameters) for end in value)
        if not ordered(lower, upper):
            raise wrong("the lower end is above the upper end")
        return lower, upper
    c = read_exact(value, parameters)
    if c.sign() not in (0, 1):
        raise wrong("a bound of an absolute value is not negative; write [lower, upper] for a range")
    return -c, c


_PAIR = {"type": "array", "items": {"type": ["number", "string"]}, "minItems": 2, "maxItems": 2}
_SLOPE_SCHEMA = {
    "anyOf": [{"type": "number"}, {"type": "string"}, _PAIR],
    "description": "c bounds |d phi_i / d x_j|; or [lower, upper]; or auto.",
}
SlopeEntry = Annotated[Any, PlainValidator(_slope), WithJsonSchema(_SLOPE_SCHEMA)]
SlopeRow = Annotated[tuple[SlopeEntry, ...], sized(1, MAX_STATES)]
SlopeTable = Annotated[tuple[SlopeRow, ...], sized(1, MAX_STATES), BeforeValidator(rows_of)]
SlopesField = Annotated[
    Annotated[Literal["auto"], Tag("one word")] | Annotated[SlopeTable, Tag("slope table")],
    Discriminator(lambda value: "one word" if isinstance(value, str) and NAME.fullmatch(value) else "slope table"),
]


def slopes(field: Any, n: int) -> Slopes:
    """The claimed bounds; `auto` entries are 0 until they are found."""
    table = [[None] * n for _ in range(n)] if field == "auto" else field
    ends = [[(EXACT_ZERO, EXACT_ZERO) if entry is None else entry for entry in row] for row in table]
    return Slopes(
        ExactMatrix([[lower for lower, _ in row] for row in ends]),
        ExactMatrix([[upper for _, upper in row] for row in ends]),
        frozenset((i, j) for i, row in enumerate(table) for j, entry in enumerate(row) if entry is None),
    )
