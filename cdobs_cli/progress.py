"""What is being done, for whoever waits for it; and the time after which a search ends with what it has."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import field

from cdobs_cli.records import dataclass

_EVERY = 0.2  # s between two words about the same stage


class TimeIsUp(Exception):  # noqa: N818 - it ends a search, nothing went wrong
    """Raised within `searching` when the time that a watch leaves is over."""


@dataclass
class Watch:
    """tell: who is told what is being done, if anybody is. ends: when searches end, by `time.monotonic`; None: never.
    stages: seconds of those that have ended, by name."""

    tell: Callable[[str], None] | None = None
    ends: float | None = None
    stages: dict[str, float] = field(default_factory=dict)
    _stage: str = ""
    _what: str = ""
    _proved: str = ""
    _calls: int = 0
    _within: float = 0.0  # s of the stages within this one
    _told: float = 0.0
    _searches: bool = False

    def look(self) -> None:
        """Tell how far it is, now and then. Raises: TimeIsUp."""
        now = time.monotonic()
        if self.tell is not None and now - self._told >= _EVERY:
            self._told = now
            self.tell(self._words)
        if self.ends is not None and now >= self.ends and self._searches:
            raise TimeIsUp

    @property
    def _words(self) -> str:
        calls = f", {self._calls} solver calls" if self._calls else ""
        proved = f"; proved: {self._proved}" if self._proved else ""
        return f"{self._stage}{': ' if self._what else ''}{self._what}{calls}{proved}"


_NOBODY = Watch()
_WATCH: ContextVar[Watch] = ContextVar("watch", default=_NOBODY)


@contextmanager
def watched(tell: Callable[[str], None] | None = None, seconds: float | None = None) -> Iterator[Watch]:
    """Within the block `tell` hears what is being done, and searches end after so many seconds."""
    watch = Watch(tell, None if seconds is None else time.monotonic() + seconds)
    token = _WATCH.set(watch)
    try:
        yield watch
    finally:
        _WATCH.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """The block is a stage of that name; the time of a stage within another is not counted twice."""
    watch, started = _WATCH.get(), time.perf_counter()
    if watch is _NOBODY:
        yield
        return
    outer, watch._stage, watch._within = (watch._stage, watch._within), name, 0.0
    watch._what, watch._proved, watch._calls, watch._told = "", "", 0, 0.0
    watch.look()
    try:
        yield
    finally:
        seconds = time.perf_counter() - started
        watch.stages[name] = watch.stages.get(name, 0.0) + seconds - watch._within
        watch._stage, watch._within = outer[0], outer[1] + seconds
        watch._what, watch._proved, watch._calls = "", "", 0


def doing(what: str) -> None:
    """Say what is tried. Raises: TimeIsUp."""
    watch = _WATCH.get()
    if watch is not _NOBODY:
        watch._what = what
        watch.look()


def proved(what: str) -> None:
    """Say what is proved by now."""
    watch = _WATCH.get()
    if watch is not _NOBODY:
        watch._proved = what


def called() -> None:
    """The solver has answered. Raises: TimeIsUp."""
    watch = _WATCH.get()
    if watch is not _NOBODY:
        watch._calls += 1
        watch.look()


@contextmanager
def searching() -> Iterator[None]:
    """The block is a search that can end with what it has: `TimeIsUp` may be raised in it."""
    watch = _WATCH.get()
    outer, watch._searches = watch._searches, watch is not _NOBODY
    try:
        yield
    finally:
        watch._searches = outer


def is_limited() -> bool:
    """Whether searches will have to end at some time."""
    return _WATCH.get().ends is not None


def is_late() -> bool:
    """Whether the time is over: what is not needed is left out."""
    ends = _WATCH.get().ends
    return ends is not None and time.monotonic() >= ends
