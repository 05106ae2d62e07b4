"""The domain on which slopes are claimed: a box, and affine inequalities."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Annotated, Any

from pydantic import ConfigDict, Field, PlainValidator, ValidationInfo, WithJsonSchema

from cdobs_cli.exact.expression import Call as CallNode
from cdobs_cli.exact.expression import Constant, Expression, Number, Power, Variable
from cdobs_cli.fields import read_expression, sized, wrong
from cdobs_cli.plant import Domain
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.boxes import IntervalField

MAX_INEQUALITIES = 64


def _inequalities(value: Any, info: ValidationInfo) -> tuple[Expression, ...]:
    """`a <= b <= c` as the expressions b - a, c - b, each affine in the states and >= 0."""
    context = info.context or {}
    if not isinstance(value, str):
        raise wrong('an inequality in quotes is expected, e.g. "x2 <= x1"')
    parts = re.split(r"(<=|>=)", value)
    signs = set(parts[1::2])
    if len(parts) < 3 or len(signs) != 1 or re.search(r"[<>=]", "".join(parts[0::2])):
        raise wrong("an inequality of two or more sides is expected, all joined by <= or all by >=")
    parameters, states = context.get("parameters") or {}, context.get("states")
    names = re.findall(r"[A-Za-z_]\w*", value, re.ASCII) if states is None else states
    sides = [read_expression(part, names, parameters) for part in parts[0::2]]
    if "<=" in signs:
        sides.reverse()
    for side in sides:
        if degree(side) > 1:
            raise wrong("a side that is not affine in the states (slopes need a convex domain)")
    return tuple(left - right for left, right in pairwise(sides))


def degree(expression: Expression) -> float:
    """0 constant, 1 affine, inf anything else, as it is written (x*x - x*x is not affine)."""
    degrees: dict[Expression, float] = {}
    for node in expression.walk():
        inner = [degrees[child] for child in node.children]
        if isinstance(node, Number | Constant):
            result = 0.0
        elif isinstance(node, Variable):
            result = 1.0
        elif isinstance(node, CallNode) and node.function == "add":
            result = max(inner)
        elif isinstance(node, CallNode) and node.function == "multiply":
            result = sum(inner)
        elif isinstance(node, CallNode) and node.function == "divide":
            result = inner[0] + (inner[1] and float("inf"))
        elif isinstance(node, Power) and node.exponent == 1:
            result = inner[0]
        else:
            result = max(inner) and float("inf")
        degrees[node] = result if result <= 1 else float("inf")
    return degrees[expression]


Inequality = Annotated[Any, PlainValidator(_inequalities), WithJsonSchema({"type": "string"})]


class DomainBlock(Block):
    """state: [lower, upper], null for an open end; `where`: affine inequalities."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, defer_build=True)
    __pydantic_extra__: dict[str, IntervalField]
    where: Annotated[tuple[Inequality, ...], sized(0, MAX_INEQUALITIES)] = Field(
        default=(), description='Affine inequalities between states beside the box, such as "x2 <= x1".'
    )

    def domain(self) -> Domain:
        return Domain(dict(self.__pydantic_extra__ or {}), tuple(part for parts in self.where for part in parts))
