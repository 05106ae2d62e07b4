"""What is printed: data on stdout in one of the formats, everything for people on stderr."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field
from importlib import import_module
from typing import TYPE_CHECKING, Any, TextIO

from cdobs_cli.errors import ExitCode, ToolError
from cdobs_cli.outcome import EXIT_CODES, Result
from cdobs_cli.printable import line, printable
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from rich.live import Live

_COLOURS = dict.fromkeys(("proved", "ok"), "32") | dict.fromkeys(("refuted", "failed", "invalid"), "31")
_COLOURS |= dict.fromkeys(("undecided", "finding"), "33")
_SEVERITIES = {"error": "31", "warning": "33", "note": "36"}
_STYLES = {"ok": "green", "finding": "yellow", "invalid": "red", "failed": "red"}


class LostStreamError(ToolError):
    """stdout or stderr cannot be written: closed, on a full disk, without a reader."""

    def __init__(self, name: str, error: Exception) -> None:
        super().__init__(f"{name} cannot be written: {getattr(error, 'strerror', None) or 'it is closed'}")
        self.name = name
        self.unread = isinstance(error, BrokenPipeError)


def say(text: str, *, aside: bool = False) -> None:
    """A text that is safe to print, on stdout, or on stderr (`aside`: for people), at once.

    Raises: LostStreamError.
    """
    stream = sys.stderr if aside else sys.stdout
    try:
        print(text, file=stream, flush=True)
    except (OSError, ValueError) as error:
        raise LostStreamError("stderr" if aside else "stdout", error) from error


@dataclass
class Console:
    """One command's output.

    text: what became of each spec on stdout, in the order of the specs: a summary of a single one, one line of
    each of several (with `verbose` its summary too). The other formats: one document on stdout at the end.
    Findings and progress go to stderr.
    """

    format: str = "text"
    quiet: bool = False
    no_color: bool = False
    verbose: bool = False

    def __post_init__(self) -> None:
        if self.format != "text":
            import_module(f"cdobs_cli.formats.{self.format}")  # while there are descriptors left to load it

    @contextmanager
    def following(self, specs: list[str], *, briefly: bool = False) -> Iterator[Follow]:
        """Follow a batch: a live table on terminals, one line a spec in logs. What a live table held back
        is shown when the block ends, however it ends. briefly: a single spec is no work to be followed."""
        follow = Follow(self, specs)
        if not _is_terminal(sys.stderr) or self.quiet or (briefly and len(specs) < 2):
            yield follow
            return
        try:
            with _live(self) as live:
                follow.live = live
                yield follow
        finally:
            follow.live = None
            follow.show_ended()

    def show(self, result: Result, *, several: bool = False) -> None:
        """A spec has ended."""
        for message in result.messages:
            if message.severity == "error" or not self.quiet:
                severity = self._paint(message.severity, _SEVERITIES[message.severity], sys.stderr)
                say(f"{severity}: {line(str(message))}", aside=True)
        if self.quiet and (result.status == "ok" or self.format != "text"):
            return
        if self.format == "text":
            say(self._line(result, sys.stdout, headline=several))
            if not self.quiet and (self.verbose or not several):
                for told in result.summary:
                    say(f"  {self._coloured(line(told))}")
        elif several:
            say(self._line(result, sys.stderr, headline=True), aside=True)
        if self.verbose and result.stages:
            times = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result.stages.items())
            say(f"  {times}", aside=True)

    def warn(self, text: str) -> None:
        """Something about the whole command."""
        say(f"cdobs: {line(text)}", aside=True)

    def finish(self, command: str, results: list[Result], code: ExitCode) -> None:
        """The command has ended: print the document, or the count."""
        if self.format != "text":
            from cdobs_cli.formats import render

            say(render(self.format, command, results, code))
        elif len(results) > 1:
            say(count(results))

    def _line(self, result: Result, stream: TextIO, *, headline: bool) -> str:
        told = f"  {printable(result.headline)}" if headline and result.headline else ""
        return f"{self._word(result.status, stream)}  {line(result.spec)}{told}  ({result.seconds:.1f} s)"

    def _paint(self, text: str, code: str, stream: TextIO) -> str:
        colour = stream.isatty() and not self.no_color and not os.environ.get("NO_COLOR")
        return f"\033[{code}m{text}\033[0m" if colour else text

    def _word(self, word: str, stream: TextIO) -> str:
        return self._paint(word, _COLOURS[word], stream) if word in _COLOURS else word

    def _coloured(self, line: str) -> str:
        """With its status word in colour: the first word, or the one behind a name and a colon."""
        words = line.split(" ")
        first = next((k for k, word in enumerate(words) if word), 0)
        place = first + 1 if words[first].endswith(":") and len(words) > first + 1 else first
        words[place] = self._word(words[place], sys.stdout)
        return " ".join(words)


@dataclass
class Follow:
    """The progress of one batch; results are shown in the order of the specs."""

    console: Console
    specs: list[str]
    live: Live | None = None
    _running: dict[int, tuple[float, str]] = field(default_factory=dict)
    _ended: dict[int, Result] = field(default_factory=dict)
    _shown: int = 0

    def started(self, number: int) -> None:
        self._running[number] = time.monotonic(), ""
        self._refresh()

    def heard(self, number: int, words: str) -> None:
        """What is being done of a spec."""
        self._running[number] = self._running[number][0], words
        self._refresh()

    def ended(self, number: int, result: Result) -> None:
        self._running.pop(number, None)
        self._ended[number] = result
        if self.live is None:
            self.show_ended()
        self._refresh()

    def over(self, number: int) -> None:
        """A spec has ended of which something is said later."""
        self._running.pop(number, None)
        self._refresh()

    def show_ended(self) -> None:
        """Show what is next in order."""
        while self._shown in self._ended:
            self.console.show(self._ended[self._shown], several=len(self.specs) > 1)
            self._shown += 1

    def _refresh(self) -> None:
        if self.live is not None:
            self.live.update(_table(self, self.live.console.height - 2), refresh=True)

    def rows(self) -> Iterator[tuple[str, str, str]]:
        """(status, spec, what is known), the latest to end last, then what is running."""
        for number, result in self._ended.items():
            told = result.headline or "; ".join(message.text for message in result.messages)
            yield result.status, self.specs[number], told
        for number, (since, words) in self._running.items():
            yield "running", self.specs[number], f"{time.monotonic() - since:.0f} s, {words}" if words else ""

    def count(self) -> str:
        """`3/11  2 ok, 1 finding`."""
        ended = list(self._ended.values())
        return f"{len(ended)}/{len(self.specs)}  {_counts(ended)}"


def count(results: list[Result]) -> str:
    """`3 ok, 1 finding of 4 specs`."""
    return f"{_counts(results)} of {len(results)} specs"


def _counts(results: list[Result]) -> str:
    counts = Counter(result.status for result in results)
    return ", ".join(f"{counts[status]} {status}" for status in EXIT_CODES if counts[status])


def _is_terminal(stream: TextIO) -> bool:
    return stream.isatty() and os.environ.get("TERM") not in ("dumb", "unknown")


def _live(console: Console) -> Live:
    from rich.console import Console as RichConsole
    from rich.live import Live

    # stdout is for data: nothing that is printed there may take the way over the table.
    screen = RichConsole(stderr=True, no_color=console.no_color or None)
    return Live(console=screen, transient=True, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)


def _table(follow: Follow, height: int) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, show_header=False, pad_edge=False)
    for _ in range(3):
        table.add_column(no_wrap=True, overflow="ellipsis")
    for status, spec, told in list(follow.rows())[-max(1, height - 1) :]:
        table.add_row(Text(status, style=_STYLES.get(status, "")), Text(printable(spec)), Text(printable(told)))
    table.add_row("", Text(follow.count()), "")
    return table
