"""Sensors that send on change: how far each output may leave its prediction before it is sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass
from cdobs_cli.sensors import MAX_SENSORS


@dataclass(frozen=True)
class Threshold:
    """A sensor of one output, by its number, that sends when |y - C x_hat| reaches delta > 0."""

    name: str
    output: int
    delta: Exact


def document(thresholds: Sequence[Threshold]) -> list[dict[str, Any]]:
    """In the order of the outputs."""
    return [{"name": one.name, "delta": str(one.delta)} for one in thresholds]


def from_document(entries: Any) -> tuple[Threshold, ...]:
    """Raises: TypeError, ValueError, KeyError on anything `document` did not write."""
    if not isinstance(entries, list) or not 1 <= len(entries) <= MAX_SENSORS:
        raise ValueError("not a list of thresholds")
    thresholds = tuple(_threshold(k, entry) for k, entry in enumerate(entries))
    if len({one.name for one in thresholds}) < len(thresholds):
        raise ValueError("names that are not one sensor's each")
    return thresholds


def _threshold(output: int, entry: Any) -> Threshold:
    if not isinstance(entry, Mapping) or entry.keys() != {"name", "delta"}:
        raise ValueError("not a threshold")
    if not isinstance(entry["name"], str) or not isinstance(entry["delta"], str):
        raise ValueError("not a threshold")
    delta = Exact(entry["delta"])
    if delta.sign() != 1:
        raise ValueError("a threshold is positive")
    return Threshold(entry["name"], output, delta)
