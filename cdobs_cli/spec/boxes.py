"""Intervals, boxes and lengths: the checks that several blocks share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, ClassVar

from pydantic import Field

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.fields import ExactNumber, Through, Vector, wrong
from cdobs_cli.plant import Box, Interval
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.reader import flow

MAX_STATES = 32


def ordered(lower: Exact, upper: Exact) -> bool:
    """Whether lower <= upper is certain."""
    return lower.is_at_most(upper)


_ENDS = {frozenset(ends): ends for ends in (("lower", "upper"), ("min", "max"), ("low", "high"), ("lo", "hi"))}


def _two(value: Any) -> Any:
    if isinstance(value, dict) and len(value) == 2 and (ends := _ENDS.get(frozenset(map(str, value)))) is not None:
        raise wrong("two ends are expected: [lower, upper]", f"write {flow([value[end] for end in ends])}")
    if isinstance(value, int | str | dict) or (isinstance(value, list | tuple) and len(value) != 2):
        raise wrong("two ends are expected: [lower, upper]")
    return [value.lower, value.upper] if isinstance(value, Interval) else value


def _interval(ends: tuple[Exact | None, Exact | None]) -> Interval:
    if ends[0] is not None and ends[1] is not None and not ordered(ends[0], ends[1]):
        raise wrong("the lower end is above the upper end")
    return Interval(*ends)


IntervalField = Annotated[Interval, Through(tuple[ExactNumber | None, ExactNumber | None], _interval, _two)]


class BoxBlock(Block):
    """lower <= . <= upper, componentwise."""

    required: ClassVar[tuple[str, ...]] = ("lower", "upper")
    lower: Vector | None = Field(default=None, description="The lower ends, a number each.")
    upper: Vector | None = Field(default=None, description="The upper ends, a number each.")

    def box(self) -> Box:
        """Once `box_problems` found nothing."""
        assert self.lower is not None and self.upper is not None
        return Box(self.lower, self.upper)


def box_problems(block: BoxBlock, at: tuple[str | int, ...], length: int | None, of: str) -> Iterator[Problem]:
    """Both ends there, of the right length, in order."""
    for name in ("lower", "upper"):
        ends: tuple[Exact, ...] | None = getattr(block, name)
        if ends is None:
            yield Problem((*at, name), "is required")
        elif length is not None and len(ends) != length:
            yield Problem(
                (*at, name), f"one number for each {of} is expected", f"{len(ends)} numbers", f"{length} numbers"
            )
    if block.lower is not None and block.upper is not None:
        for i, (lower, upper) in enumerate(zip(block.lower, block.upper, strict=False)):
            if not ordered(lower, upper):
                yield Problem((*at, "lower", i), "the lower end is above the upper end", str(lower), f"at most {upper}")


def shape_problem(
    at: tuple[str | int, ...], got: tuple[int, int], want: tuple[int, int], why: str
) -> Iterator[Problem]:
    """A matrix of another shape."""
    if got != want:
        yield Problem(
            at, "a matrix of another shape is expected", f"{got[0]} x {got[1]}", f"{want[0]} x {want[1]}, {why}"
        )


def length_problem(at: tuple[str | int, ...], typed: Sequence[Any] | None, n: int, why: str) -> Iterator[Problem]:
    """A list of another length."""
    if typed is not None and len(typed) != n:
        yield Problem(at, f"{why} is expected", f"{len(typed)} entries", f"{n} entries")
