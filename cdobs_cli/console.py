"""What is printed: data on stdout in one of the formats, everything for people on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Result

if TYPE_CHECKING:
    from rich.live import Live

_COLOURS = {"proved": "32", "ok": "32", "refuted": "31", "failed": "31", "invalid": "31", "undecided": "33", "finding": "33"}


@dataclass
class Console:
    """One command's output.

    text: a summary of each spec on stdout, findings on stderr, in the order of the specs. The other
    formats: findings on stderr, one document on stdout at the end.
    """

    format: str = "text"
    quiet: bool = False
    no_color: bool = False

    @contextmanager
    def following(self, specs: list[str]) -> Iterator[Follow]:
        """Follow a batch: a live table on terminals, one line a spec in logs."""
        follow = Follow(self, specs)
        if sys.stderr.isatty() and not self.quiet:
            with _live(self) as live:
                follow.live = live
                yield follow
        else:
            yield follow

    def show(self, result: Result) -> None:
        """A spec has ended."""
        sys.stdout.flush()
        for message in result.messages:
            print(f"{self._paint(message.severity, '31', sys.stderr)}: {message}", file=sys.stderr)
        sys.stderr.flush()
        if self.format == "text" and not (self.quiet and result.status == "ok"):
            print(f"{self._word(result.status)}  {result.spec}  ({result.seconds:.1f} s)")
            for line in result.summary if not self.quiet else ():
                print(f"  {self._coloured(line)}")

    def finish(self, command: str, results: list[Result], code: ExitCode) -> None:
        """The command has ended: print the document, or the count."""
        if self.format == "text":
            if len(results) > 1:
                print(count(results))
        else:
            from cdobs_cli.formats import render

            print(render(self.format, command, results, code))
        sys.stdout.flush()

    def _colour(self, stream: Any) -> bool:
        return bool(stream.isatty()) and not self.no_color and not os.environ.get("NO_COLOR")

    def _paint(self, text: str, code: str, stream: Any) -> str:
        return f"\033[{code}m{text}\033[0m" if self._colour(stream) else text

    def _word(self, word: str) -> str:
        return self._paint(word, _COLOURS[word], sys.stdout) if word in _COLOURS else word

    def _coloured(self, line: str) -> str:
        return " ".join(self._word(word) for word in line.split(" "))


@dataclass
class Follow:
    """The progress of one batch; results are shown in the order of the specs."""

    console: Console
    specs: list[str]
    live: Live | None = None
    _running: dict[int, None] = field(default_factory=dict)
    _ended: dict[int, Result] = field(default_factory=dict)
    _shown: int = 0

    def started(self, number: int) -> None:
        self._running[number] = None
        self._refresh()

    def ended(self, number: int, result: Result) -> None:
        self._running.pop(number, None)
        self._ended[number] = result
        while self._shown in self._ended:
            self.console.show(self._ended[self._shown])
            self._shown += 1
        self._refresh()

    def _refresh(self) -> None:
        if self.live is not None:
            self.live.update(_table(self.specs, list(self._running), list(self._ended.values())), refresh=True)


def count(results: list[Result]) -> str:
    """`3 ok, 1 finding of 4 specs`."""
    counts = {status: sum(result.status == status for result in results) for status in ("ok", "finding", "invalid", "failed")}
    return ", ".join(f"{number} {status}" for status, number in counts.items() if number) + f" of {len(results)} specs"


def _live(console: Console) -> Live:
    from rich.console import Console as RichConsole
    from rich.live import Live

    return Live(console=RichConsole(stderr=True, no_color=console.no_color or None), transient=True, auto_refresh=False)


def _table(specs: list[str], running: list[int], ended: list[Result]) -> Any:
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    for number in running:
        table.add_row("running", specs[number])
    table.add_row(f"{len(ended)}/{len(specs)}", count(ended) if ended else "")
    return table
