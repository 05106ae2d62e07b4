"""The block `expect`: what should come out, and whether it did. Decimal strings are compared exactly."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, PlainValidator, ValidationInfo, WithJsonSchema

from cdobs_cli.errors import Problem
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import nearest
from cdobs_cli.fields import ExactNumber, NonNegativeNumber, bounded, read_exact, wrong
from cdobs_cli.records import dataclass
from cdobs_cli.spec.block import Block, Text
from cdobs_cli.spec.reader import DecimalText

Relation = Literal["at_least", "at_most", "equals"]
RELATIONS: tuple[Relation, ...] = ("at_least", "at_most", "equals")
# What a quantity may start with: the parts of check.json, or another artefact.
ROOTS = ("verdict", "claims", "bounds", "check", "design", "simulation")


def _equal(value: Any, info: ValidationInfo) -> Exact | str | bool:
    """A number where the value is one, a status or other word otherwise."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and not isinstance(value, DecimalText):
        try:
            exact = Exact(value)
            bounded(exact.expression)
        except ExpressionError:
            if len(value) > 200:
                raise wrong("a word of at most 200 characters is expected") from None
            return value
        return exact
    return read_exact(value)


_EQUAL_SCHEMA = {"anyOf": [{"type": "number"}, {"type": "string"}, {"type": "boolean"}]}
Equal = Annotated[Any, PlainValidator(_equal), WithJsonSchema(_EQUAL_SCHEMA)]


class ExpectBlock(Block):
    """One expectation: a quantity, one relation, where the number comes from."""

    required: ClassVar[tuple[str, ...]] = ("quantity",)
    quantity: Annotated[Text, Field(min_length=1, max_length=200)] | None = Field(
        default=None,
        description="A dotted path into check.json, such as bounds.period_max.proved or claims.convergence.status; "
        "with design. or simulation. in front into these.",
    )
    at_least: ExactNumber | None = Field(default=None, description="The quantity is not below this.")
    at_most: ExactNumber | None = Field(default=None, description="The quantity is not above this.")
    equals: Equal | None = Field(default=None, description="The quantity is this: a number, a word, true or false.")
    tolerance: NonNegativeNumber | None = Field(
        default=None, description="With equals and a number: how far it may be off."
    )
    source: Annotated[Text, Field(max_length=400)] | None = Field(
        default=None, description="Where the number comes from; printed with the entry."
    )


@dataclass(frozen=True)
class Expectation:
    """quantity (relation) value: a dotted path into check.json (or `design.`, `simulation.`). `field` is where
    it stands in the spec."""

    quantity: str
    relation: Relation
    value: Exact | str | bool
    tolerance: Exact | None = None
    source: str | None = None
    field: tuple[str | int, ...] = ("expect",)

    @property
    def artefact(self) -> Literal["design", "check", "simulation"]:
        """The artefact that the quantity is looked up in."""
        root = _root(self.quantity)
        return "design" if root == "design" else "simulation" if root == "simulation" else "check"

    def __str__(self) -> str:
        value = ("true" if self.value else "false") if isinstance(self.value, bool) else str(self.value)
        tolerance = "" if self.tolerance is None else f" (tolerance {self.tolerance})"
        return f"{self.quantity} {self.relation.replace('_', ' ')} {value}{tolerance}"


@dataclass(frozen=True)
class Outcome:
    """Whether an expectation holds, and what was found (None: nothing)."""

    expectation: Expectation
    holds: bool
    found: str | None

    @property
    def told(self) -> str:
        """What was found, in words."""
        source = f" ({self.expectation.source})" if self.expectation.source else ""
        return f"it is {'missing or null' if self.found is None else self.found}{source}"

    @property
    def text(self) -> str:
        """One sentence for people."""
        return f"{self.expectation}: {'holds' if self.holds else 'fails'}, {self.told}"


def _root(quantity: str) -> str:
    return re.split(r"[.\[]", quantity, maxsplit=1)[0]


def expect_problems(block: ExpectBlock, wrong_fields: set[str], at: tuple[str | int, ...]) -> Iterator[Problem]:
    """One relation each, and a quantity that can exist."""
    given = [name for name in RELATIONS if getattr(block, name) is not None or name in wrong_fields]
    if len(given) != 1:
        yield Problem(at, "one relation is expected", ", ".join(given) or "none", "at_least, at_most or equals")
    if block.tolerance is not None and (given != ["equals"] or not isinstance(block.equals, Exact | None)):
        yield Problem((*at, "tolerance"), "goes with equals and a number")
    if block.quantity is not None:
        root = _root(block.quantity)
        if root not in ROOTS:
            allowed = f"a path that starts with {', '.join(ROOTS)}"
            hint = nearest(root, ROOTS)[2:] or None
            yield Problem((*at, "quantity"), "no such quantity", f'"{block.quantity[:60]}"', allowed, hint)


def expectation(block: ExpectBlock, at: tuple[str | int, ...]) -> Expectation:
    """The noun of a block without problems."""
    relation = next(name for name in RELATIONS if getattr(block, name) is not None)
    assert block.quantity is not None
    quantity = block.quantity.removeprefix("check.")
    return Expectation(quantity, relation, getattr(block, relation), block.tolerance, block.source, at)


def evaluate(expectation: Expectation, document: Mapping[str, Any]) -> Outcome:
    """Whether the expectation holds of the artefacts.

    Args:
        document: {"design": .., "check": .., "simulation": ..}, each the artefact or None. A quantity without
            one of these words in front is looked up in `check`.
    """
    value = resolve(expectation.quantity, document)
    if value is None or isinstance(value, dict | list):
        return Outcome(expectation, False, None if value is None else "not a single value")
    found = ("true" if value else "false") if isinstance(value, bool) else str(value)
    return Outcome(expectation, _holds(expectation, value), found)


def _holds(expectation: Expectation, value: Any) -> bool:
    wanted = expectation.value
    if isinstance(wanted, bool) or isinstance(value, bool):
        return value is wanted
    number = _number(value)
    if isinstance(wanted, str) or number is None:
        return expectation.relation == "equals" and str(value) == str(wanted)
    if isinstance(number, float):
        # inf and -inf; nan never gets here.
        return (expectation.relation == "at_least") == (number > 0) and expectation.relation != "equals"
    tolerance = expectation.tolerance or Exact(0)  # goes with equals alone
    enough = (Exact(number) - wanted + tolerance).sign() in (0, 1)
    little = (wanted - Exact(number) + tolerance).sign() in (0, 1)
    return (enough or expectation.relation == "at_most") and (little or expectation.relation == "at_least")


def _number(value: Any) -> Fraction | float | None:
    """The exact value of a JSON number (as it is printed), a decimal or p/q string; inf; None for others."""
    text = str(value).strip()
    if re.fullmatch(r"[-+]?\d+/\d+", text):
        try:
            return Fraction(text)
        except ZeroDivisionError:
            return None
    try:
        decimal = Decimal(text)
    except InvalidOperation:
        return None
    if decimal.is_nan():
        return None
    if decimal.is_infinite():
        return math.inf if decimal > 0 else -math.inf
    return Fraction(decimal) if abs(decimal.adjusted()) < 5000 else None


def resolve(quantity: str, document: Mapping[str, Any]) -> Any:
    """What stands at a dotted path, None where there is nothing. Keys and claim ids may hold dots
    themselves: the longest that fits is tried first."""
    path = re.sub(r"\[(\d+)\]", r".\1", quantity)
    root, _, rest = path.partition(".")
    if root in ("check", "design", "simulation"):
        return _look(document.get(root), rest)
    return _look(document.get("check"), path)


def _look(value: Any, path: str) -> Any:
    if not path:
        return value
    entries: dict[str, Any]
    if isinstance(value, Mapping):
        entries = dict(value)
    elif isinstance(value, list):
        entries = {str(i): entry for i, entry in enumerate(value)}
        entries |= {str(entry["id"]): entry for entry in value if isinstance(entry, Mapping) and "id" in entry}
    else:
        return None
    for key in sorted(entries, key=len, reverse=True):
        if path == key:
            return entries[key]
        if path.startswith(f"{key}.") and (found := _look(entries[key], path[len(key) + 1 :])) is not None:
            return found
    return None
