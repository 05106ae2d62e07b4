"""What a command has to say of one spec, whatever the format it is printed in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any, Literal

from cdobs_cli.errors import ExitCode, Problem
from cdobs_cli.records import dataclass

ResultStatus = Literal["ok", "finding", "invalid", "failed"]
Severity = Literal["error", "warning", "note"]
STAGES = ("synthesize", "check", "simulate", "report")  # in order
EXIT_CODES: dict[ResultStatus, ExitCode] = {
    "ok": ExitCode.HOLDS, "finding": ExitCode.FINDING, "invalid": ExitCode.INVALID, "failed": ExitCode.FAILED,
}  # fmt: skip


@dataclass(frozen=True)
class Job:
    """One spec and the folder of its artefacts; or a path that cannot be carried out, and why."""

    spec: Path
    folder: Path
    refused: str | None = None


@dataclass(frozen=True)
class Message:
    """One sentence about one place of a spec. `rule` names what raised it: a claim id, `expect`, `spec`."""

    severity: Severity
    text: str
    file: str | None = None
    line: int | None = None
    column: int | None = None
    field: str | None = None
    rule: str = "spec"

    @staticmethod
    def from_problem(problem: Problem) -> Message:
        return Message("error", problem.text, problem.file, problem.line, problem.column, problem.path)

    @property
    def told(self) -> str:
        """The field, where there is one, and the sentence."""
        return f"{self.field}: {self.text}" if self.field else self.text

    def __str__(self) -> str:
        where = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        return f"{where}: {self.told}" if where else self.told

    def document(self) -> dict[str, Any]:
        return {
            "severity": self.severity, "file": self.file, "line": self.line, "column": self.column,
            "field": self.field, "text": self.text,
        }  # fmt: skip


@dataclass(frozen=True)
class Result:
    """One spec's outcome: status, messages, and the artefacts as documents (None where there are none).

    headline, summary: one line and a few lines for people. expected: names of the `expect` entries that were
    decided. index: the row of the index page, once there is a report. waiting: stages still to be carried out, of a
    result that is told while the work goes on. seconds: elapsed; cpu: used by its process. stages: seconds of each that
    was carried out, by name.
    """

    spec: str
    status: ResultStatus
    messages: tuple[Message, ...] = ()
    design: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    simulation: dict[str, Any] | None = None
    headline: str = ""
    summary: tuple[str, ...] = ()
    expected: tuple[str, ...] = ()
    index: Any = None
    seconds: float = 0.0
    cpu: float = 0.0
    waiting: tuple[str, ...] = ()
    stages: Mapping[str, float] = field(default_factory=dict)

    @property
    def exit_code(self) -> ExitCode:
        return EXIT_CODES[self.status]

    def document(self) -> dict[str, Any]:
        return {
            "spec": self.spec, "status": self.status, "messages": [message.document() for message in self.messages],
            "design": self.design, "check": self.check, "simulation": self.simulation,
        }  # fmt: skip


def readable(name: str) -> str:
    """A file's name as text for a page: bytes that are no UTF-8 show as \ufffd."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def failure(spec: str, text: str) -> Result:
    """The tool failed on a spec."""
    return Result(spec, "failed", (Message("error", text, spec, rule="tool"),))


def judged(messages: Sequence[Message]) -> ResultStatus:
    """A finding, where there is a message that is more than a remark."""
    return "finding" if any(message.severity == "error" for message in messages) else "ok"


def cut_short(so_far: Result | None, spec: str, time_limit: float) -> Result:
    """What had been told when the time ran out: artefacts stored by then stand, the rest is undecided."""
    told = so_far or Result(spec, "finding")
    stages = f"{', '.join(told.waiting)} " if told.waiting else ""
    stands = "" if told.check is None else "; what was proved and stored by then stands"
    text = f"undecided: {stages}not finished within {time_limit:g} s (--time-limit){stands}"
    late = Message("error", text, spec, rule="time-limit")
    return replace(told, status="finding", messages=(*told.messages, late), waiting=())


def exit_code(results: list[Result]) -> ExitCode:
    """The largest of all."""
    return max((result.exit_code for result in results), default=ExitCode.INVALID)
