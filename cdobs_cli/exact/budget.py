"""How much symbolic work a task may do. Operations are counted, never timed: equal inputs end alike everywhere.

Whatever makes, differentiates, replaces, cancels, factors or writes out expressions says what it costs by `spend`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cdobs_cli.errors import ToolError

READING = 3_000_000  # validate: a second or two; shipped specs take at most 20 000


class WorkError(ToolError):
    """The expressions grow beyond what is worked with."""

    def __init__(self) -> None:
        super().__init__("the expressions grow beyond what is worked with")


_spent = 0
_limit: int | None = None
_memories: list[Callable[[], None]] = []


def spend(operations: int) -> None:
    """Count operations, of about a microsecond each.

    Raises: WorkError: the budget of the task is used up.
    """
    global _spent
    _spent += operations
    if _limit is not None and _spent > _limit:
        raise WorkError


def spent() -> int:
    """Operations counted since the program began."""
    return _spent


def forgotten(clear: Callable[[], None]) -> None:
    """What is remembered from other tasks would make equal work cost less: cleared before a task is counted."""
    _memories.append(clear)


@contextmanager
def budget(operations: int) -> Iterator[None]:
    """At most so many operations inside."""
    global _limit
    for clear in _memories:
        clear()
    before, _limit = _limit, _spent + operations
    try:
        yield
    finally:
        _limit = before
