"""How long the steps of the exported integration may be: found by replaying a simulated run with ever shorter ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.python import python_text
from cdobs_cli.export.vectors import TOLERANCE, Vectors

_SHARE = 0.1  # of the tolerance: what the integration may take of it
_MOST = 2048  # steps from a sample to the next: many where the flow has kinks
_BLIND = 16  # such steps where there is nothing to compare with
_WORK = 50_000  # steps of a replay: where each call takes many, fewer calls are kept


def with_step(portable: Portable, about: About, told: Vectors | None, period: float) -> tuple[About, Vectors | None]:
    """Half of the longest of period/1, period/2, period/4, .. that keeps within a tenth of the tolerance, as other runs
    ask for more; else the shortest. With it the vectors, cut where they would take too long.

    period: the longest time from a sample to the next.
    """
    if told is None:
        return about.with_step(period / _BLIND, None), None
    space: dict[str, Any] = {"__name__": "replayed"}
    text = python_text(portable, about.with_step(period, 0.0), told)
    exec(compile(text, "<exported observer>", "exec"), space)  # noqa: S102 - our own text, made of expression trees
    parts, wanted = 1, _SHARE * TOLERANCE
    while parts < _MOST and _distance(space, _cut(told, parts), period / parts, wanted) > wanted:
        parts *= 2
    parts = min(_MOST, 2 * parts)
    kept = _cut(told, parts)
    return about.with_step(period / parts, _distance(space, kept, period / parts, float("inf"))), kept


def _cut(told: Vectors, parts: int) -> Vectors:
    return replace(told, calls=told.calls[: max(4, _WORK // parts)])


def _distance(space: dict[str, Any], told: Vectors, step: float, enough: float) -> float:
    """Of the replayed estimates from the simulated ones; no more is looked at once it is beyond `enough`."""
    space["CALLS"] = space["CALLS"][: len(told.calls)]
    try:
        return float(space["self_test"](step, enough))
    except (ArithmeticError, ValueError):  # a step so long that the estimate leaves where the flow is defined
        return float("inf")
