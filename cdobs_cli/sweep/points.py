"""The points of a sweep: each a spec of its own in a folder named by its content, and what is known of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import Literal

from cdobs_cli import __version__
from cdobs_cli.certificate import Bound, Status
from cdobs_cli.codec import Artefact, Noun
from cdobs_cli.labels import OF_STATES
from cdobs_cli.outcome import Job, Message, Result, ResultStatus, Severity
from cdobs_cli.printable import printable
from cdobs_cli.records import dataclass
from cdobs_cli.spec.reader import Document
from cdobs_cli.spec.replaced import Setting, replaced, written
from cdobs_cli.store import Store, digest, write_atomically

POINTS, SPEC, ROW, TIME = "points", "spec.yaml", "point.json", "time.json"
_KEY_LENGTH = 20  # hex digits of a folder's name
_PASSING = ("time-limit", "tool")  # rules of messages about this run and not about the point


@dataclass(frozen=True)
class Told(Noun):
    """A message without its file, which is the point's spec."""

    severity: Severity
    text: str
    rule: str
    field: str | None = None
    line: int | None = None
    column: int | None = None


@dataclass(frozen=True)
class Row(Artefact):
    """What is known of a point: point.json. verdict, family and outcome are None where the point did not get there.

    passing: whether it is about one run of the tool (a limit, a crash) and is to be done again.
    """

    status: ResultStatus
    verdict: Status | None
    family: str | None
    outcome: Literal["found", "given", "short", "none"] | None
    passing: bool
    bounds: dict[str, Bound] = field(default_factory=dict)
    messages: tuple[Told, ...] = ()
    headline: str = ""
    digests: dict[str, str] = field(default_factory=dict)

    @staticmethod
    def of(result: Result, key: str) -> Row:
        """Of what a run said; bounds by method are left to check.json."""
        check, design = result.check or {}, result.design or {}
        bounds = {name: Bound.from_document(one) for name, one in check.get("bounds", {}).items() if _is_headline(name)}
        messages = tuple(
            Told(one.severity, one.text, one.rule, one.field, one.line, one.column) for one in result.messages
        )
        passing = bool(design.get("cut")) or any(one.rule in _PASSING for one in messages)
        return Row(
            result.status, check.get("verdict"), design.get("family"), design.get("outcome"), passing, bounds, messages,
            result.headline, {"key": key},
        )  # fmt: skip


def _is_headline(name: str) -> bool:
    return "." not in name or name.partition(".")[0] in OF_STATES


@dataclass(frozen=True)
class Point:
    """One point: its settings, its spec as text, the digest of that, and its folder."""

    settings: tuple[Setting, ...]
    text: str
    key: str
    folder: Path

    @staticmethod
    def of(document: Document, settings: tuple[Setting, ...], effort: int, top: Path) -> Point:
        """The title costs nothing: it is a comment of the point's spec. Raises: SpecError, as `replaced`."""
        root = dict(replaced(document, settings).root)
        title = root.pop("title", None)
        text = written(root)
        key = digest({"spec": text, "effort": effort, "cdobs": __version__})
        head = " ".join(printable(str(one)) for one in (title or "", *settings))
        return Point(settings, f"# {head.strip()}\n{text}", key, top / POINTS / key[:_KEY_LENGTH])

    @property
    def job(self) -> Job:
        return Job(self.folder / SPEC, self.folder)

    @property
    def name(self) -> str:
        """`measurement.sampling.period=0.6, plant.A[1][0]=-1`."""
        return ", ".join(map(str, self.settings))

    def row(self) -> Row | None:
        """What is stored of this very point; None where nothing is, or it is not what was written."""
        document = Store(self.folder).read(ROW)
        try:
            row = None if document is None else Row.from_document(document)
        except (KeyError, TypeError, ValueError, ArithmeticError):
            return None
        return row if row is not None and row.digests.get("key") == self.key else None

    def seconds(self) -> float | None:
        """CPU time of the run that the row is from."""
        found = (Store(self.folder).read(TIME) or {}).get("cpu")
        return found if isinstance(found, float) else None

    def prepare(self) -> None:
        """Write the spec. Raises: ToolError."""
        write_atomically(self.folder / SPEC, self.text.encode())

    def keep(self, result: Result) -> Row:
        """Store what a run said. Raises: ToolError."""
        row, store = Row.of(result, self.key), Store(self.folder)
        store.write(TIME, {"schema_version": 1, "cpu": result.cpu, "digests": {"key": self.key}})
        store.write(ROW, row.document())
        return row

    def result(self, spec: str, row: Row) -> Result:
        """What is stored, as if it had just been done."""
        store, file = Store(self.folder), str(self.folder / SPEC)
        messages = (
            Message(one.severity, one.text, file, one.line, one.column, one.field, one.rule) for one in row.messages
        )
        told = f"{row.headline or row.status} (stands)"
        return Result(
            spec, row.status, tuple(messages), store.read("design.json"), store.read("check.json"),
            store.read("simulation.json"), headline=told, summary=(told,),
        )  # fmt: skip


def sweep_points(document: Document, grid: Sequence[tuple[Setting, ...]], effort: int, top: Path) -> list[Point]:
    """All points in the order of the grid. Raises: SpecError, as `replaced`."""
    return [Point.of(document, settings, effort, top) for settings in grid]


def shown_value(setting: Setting) -> str:
    """A value without the quotes around it."""
    match = re.fullmatch(r"\s*([\"'])([^\"']*)\1\s*", setting.text)
    return match[2] if match else setting.text.strip()
