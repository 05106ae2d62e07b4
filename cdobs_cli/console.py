"""What is printed: data on stdout in one of the formats, everything for people on stderr."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, field

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Result

_COLOURS = {"proved": "32", "ok": "32", "refuted": "31", "failed": "31", "invalid": "31", "undecided": "33", "finding": "33"}


@dataclass
class Console:
    """One command's output.

    text: a summary of each spec on stdout as it ends, findings on stderr. json: one document at the end.
    """

    format: str = "text"
    quiet: bool = False
    verbose: bool = False
    no_color: bool = False
    started: list[str] = field(default_factory=list)

    def start(self, spec: str, number: int, total: int) -> None:
        """A spec begins: told on terminals only."""
        if sys.stderr.isatty() and not self.quiet:
            print(f"\r\033[K[{number}/{total}] {spec} ..", end="", file=sys.stderr, flush=True)

    def show(self, result: Result) -> None:
        """A spec has ended."""
        if sys.stderr.isatty() and not self.quiet:
            print("\r\033[K", end="", file=sys.stderr, flush=True)
        for message in result.messages:
            print(f"{self._paint(message.severity, '31')}: {message}", file=sys.stderr)
        if self.format == "text" and not (self.quiet and result.status == "ok"):
            print(f"{self._word(result.status)}  {result.spec}  ({result.seconds:.1f} s)")
            for line in result.summary if not self.quiet else ():
                print(f"  {self._coloured(line)}")

    def finish(self, command: str, results: list[Result], code: ExitCode) -> None:
        """The command has ended."""
        if self.format == "json":
            document = {"command": command, "exit_code": int(code), "results": [result.document() for result in results]}
            print(json.dumps(document, indent=1, allow_nan=False))
        elif len(results) > 1:
            counts = {status: sum(result.status == status for result in results) for status in ("ok", "finding", "invalid", "failed")}
            print(", ".join(f"{count} {status}" for status, count in counts.items() if count) + f" of {len(results)} specs")
        sys.stdout.flush()

    @property
    def _colour(self) -> bool:
        return sys.stdout.isatty() and not self.no_color and not os.environ.get("NO_COLOR")

    def _paint(self, text: str, code: str) -> str:
        return f"\033[{code}m{text}\033[0m" if self._colour else text

    def _word(self, word: str) -> str:
        return self._paint(word, _COLOURS.get(word, "0"))

    def _coloured(self, line: str) -> str:
        if not self._colour:
            return line
        return " ".join(self._word(word) for word in line.split(" "))
