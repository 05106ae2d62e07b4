"""The errors a user can meet, and the exit code each one stands for.

    CdobsError                  every error that carries a message for the user
    ├── SpecError        2      the spec is wrong: a list of Problem, all of them at once
    ├── UsageError       2      the command line is wrong
    ├── ArtefactError    2      a stored artefact is missing, unreadable, or from another spec
    └── ToolError        3      the tool failed: disk, solver crash, a bug

What linear algebra decides is never an error: it is a claim, a bound, or a design with `outcome: none`.
"""

from __future__ import annotations

from enum import IntEnum

from cdobs_cli.records import dataclass

LONGEST_GOT = 300  # characters of what was found in a message
INTERRUPTED = "interrupted; what was written is whole, run again to go on"


class ExitCode(IntEnum):
    """Exit codes of every command, whatever the output format."""

    HOLDS = 0
    FINDING = 1
    INVALID = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in a spec: where, what, got, allowed, and what to do next.

    `field` is the path of the value, e.g. ("plant", "A", 0, 1); `file`, `line`, `column` (from 1) are
    filled in by whoever knows the text.
    """

    field: tuple[str | int, ...]
    what: str
    got: str | None = None
    allowed: str | None = None
    hint: str | None = None
    file: str | None = None
    line: int | None = None
    column: int | None = None

    @property
    def path(self) -> str:
        """The dotted path of the field: `plant.A[0][1]`."""
        text = ""
        for part in self.field:
            text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else str(part))
        return text or "spec"

    @property
    def text(self) -> str:
        """What is wrong, without the place."""
        parts = [self.what]
        if self.got is not None:
            parts.append(f"got {self.got}" if len(self.got) <= LONGEST_GOT else f"got {self.got[: LONGEST_GOT - 3]}...")
        if self.allowed is not None:
            parts.append(f"allowed: {self.allowed}")
        if self.hint is not None:
            parts.append(self.hint)
        return "; ".join(parts)

    def __str__(self) -> str:
        where = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        return f"{where}: {self.path}: {self.text}" if where else f"{self.path}: {self.text}"


class CdobsError(Exception):
    """Base of every error whose message is meant for the user. `rule` is what findings call its kind."""

    exit_code, rule = ExitCode.FAILED, "tool"


def untold(error: Exception) -> str:
    """What is said of an error that nobody meant for the user."""
    if isinstance(error, OSError):  # few descriptors, a full disk
        return f"the system refuses: {error.strerror or error}{f': {error.filename}' if error.filename else ''}"
    return f"internal error, {type(error).__name__}: {error}; please report it (-v prints where it happened)"


class SpecError(CdobsError):
    """A spec that cannot be used; carries every problem that was found."""

    exit_code, rule = ExitCode.INVALID, "spec"

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        super().__init__("\n".join(str(problem) for problem in problems))

    @staticmethod
    def at(
        field: tuple[str | int, ...],
        what: str,
        got: str | None = None,
        allowed: str | None = None,
        hint: str | None = None,
    ) -> SpecError:
        """The error of one mistake."""
        return SpecError((Problem(field, what, got, allowed, hint),))


class UsageError(CdobsError):
    """A command line that cannot be carried out."""

    exit_code, rule = ExitCode.INVALID, "command"


class ArtefactError(CdobsError):
    """A stored artefact that is missing, unreadable, or made from something else."""

    exit_code, rule = ExitCode.INVALID, "artefact"


class ToolError(CdobsError):
    """The tool failed: disk, solver crash, a bug."""
