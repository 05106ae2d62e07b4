"""The key `delay` of a measurement or a sensor, and `delays`, what the observer does with what arrives late."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import PlainValidator, ValidationInfo, WithJsonSchema

from cdobs_cli.delays import Delay
from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.fields import context, read_exact, wrong
from cdobs_cli.spec.reader import FieldPath

Ends = tuple[Exact, Exact]
Use = Literal["recompute", "innovation"]
_SHAPE = "a delay is a number, or the least and the largest: [lo, hi]"


def _ends(value: Any, info: ValidationInfo) -> Ends:
    if isinstance(value, list | tuple) and len(value) != 2:
        raise wrong(_SHAPE)
    if isinstance(value, dict):
        raise wrong(_SHAPE, "write delay: [0, 0.05]")
    parameters, unit = context(info, "parameters"), context(info, "time_unit") or "s"
    ends = value if isinstance(value, list | tuple) else (value, value)
    low, high = (read_exact(one, parameters, unit) for one in ends)
    if low.sign() not in (0, 1) or high.sign() not in (0, 1):
        raise wrong("a delay that is not negative is expected", "what is known ahead of its time is a sample too")
    if (high - low).sign() not in (0, 1):
        raise wrong("the least delay is above the largest", f"write [{high}, {low}]")
    return low, high


_NUMBER = {"anyOf": [{"type": "number"}, {"type": "string"}]}
DelayField = Annotated[
    Ends,
    PlainValidator(_ends),
    WithJsonSchema({"anyOf": [*_NUMBER["anyOf"], {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}]}),
]
DELAY_WORDS = "A sample taken at t_k arrives so much later, between the least and the largest, in any order."


def delays_problems(use: Use | None, typed: bool, at: FieldPath) -> Iterator[Problem]:
    """What is to be done with late measurements; typed: whether a delay is."""
    if use is not None and not typed:
        yield Problem(at, "goes with `delay`, which is not given")
    if use == "innovation":
        what = "adding the innovation of the stamp on arrival is not taken yet"
        hint = "write delays: recompute: the estimate is computed again from the stamp on, with the rate of no delay"
        yield Problem(at, what, use, "recompute", hint)


def overtaking_problem(delay: Ends, shortest: Exact, at: FieldPath) -> Iterator[Problem]:
    """Samples as close as one likes, of which any number may overtake one: nothing could be proved."""
    if shortest.sign() == 0 and (delay[1] - delay[0]).sign() != 0:
        what = "with min_period 0 any number of samples may overtake one that is late"
        hint = f"give a min_period above 0, or hold every sample until the largest delay and write delay: {delay[1]}"
        yield Problem(at, what, f"[{delay[0]}, {delay[1]}]", hint=hint)


def listed(sensors: Sequence[tuple[str, int]], delays: Mapping[str, Ends | None]) -> tuple[Delay, ...]:
    """The nouns of sensors (name, number of outputs); none where nothing is late."""
    told, first = [], 0
    for name, count in sensors:
        low, high = delays.get(name) or (EXACT_ZERO, EXACT_ZERO)
        told.append(Delay(name, tuple(range(first, first + count)), low, high))
        first += count
    return tuple(told) if any(one.is_late for one in told) else ()
