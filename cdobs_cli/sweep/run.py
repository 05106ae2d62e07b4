"""A sweep carried out: its points in worker processes, those that stand left alone, table and figures at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cdobs_cli.batch import Settings
from cdobs_cli.console import Console, say
from cdobs_cli.errors import ArtefactError, ExitCode, SpecError
from cdobs_cli.outcome import Message, Result, exit_code
from cdobs_cli.printable import line
from cdobs_cli.records import dataclass
from cdobs_cli.report.drawings import Drawings
from cdobs_cli.spec.model import with_files
from cdobs_cli.spec.reader import Document, read
from cdobs_cli.spec.replaced import checked
from cdobs_cli.store import Store, sweep
from cdobs_cli.sweep.charts import sweep_charts
from cdobs_cli.sweep.engine import carried_out
from cdobs_cli.sweep.grid import Axis, Shard, axes, points
from cdobs_cli.sweep.points import Point, Row, shown_value, sweep_points
from cdobs_cli.sweep.table import table_csv, table_rows, times_csv

FOLDER, TABLE, TIMES = "sweep", "sweep.csv", "sweep_times.csv"
STAGES = ("synthesize", "check")
_LISTED = 5


@dataclass(frozen=True)
class Sweep:
    """A spec, the fields that change, all points, and the folder of everything."""

    spec: Path
    axes: tuple[Axis, ...]
    points: tuple[Point, ...]
    folder: Path

    @staticmethod
    def of(spec: Path, found: tuple[Axis, ...], settings: Settings) -> Sweep:
        """Every field and value is tried in the spec first, those that cannot stand there are told at once.

        Raises: SpecError.
        """
        folder = settings.out / spec.stem / FOLDER
        document = with_files(read(spec), spec)
        document.root.pop("expect", None)  # it holds for the spec's own values alone
        _check(document, found, spec)
        return Sweep(spec, found, tuple(sweep_points(document, points(found), settings.effort, folder)), folder)

    def rows(self) -> list[Row | None]:
        """What is stored of each point."""
        return [point.row() for point in self.points]

    def name(self, point: Point) -> str:
        return f"{self.spec} ({point.name})"

    def carried_out(
        self, chosen: Sequence[Point], settings: Settings, console: Console, *, shown: bool = True
    ) -> tuple[list[Result], bool]:
        """Some of the points, and whether all of them were carried out. Raises: ToolError."""
        sweep(self.folder)
        names = list(map(self.name, chosen))
        return carried_out(chosen, names, STAGES, replace(settings, out=self.folder), console, shown=shown)

    def whole(self, settings: Settings, console: Console) -> list[dict[str, str]]:
        """Every point carried out and everything written; returns the rows of the table.

        Raises: ToolError; KeyboardInterrupt, once what had ended is stored.
        """
        _, is_whole = self.carried_out(self.points, settings, console, shown=False)
        if not is_whole:
            raise KeyboardInterrupt
        rows = [row for row in self.rows() if row is not None]
        self.write(rows)
        return table_rows(self.points, rows)

    def write(self, rows: Sequence[Row]) -> list[Path]:
        """Table, times and figures; returns the table and the pictures. Raises: ToolError."""
        shown = [[shown_value(setting) for setting in axis.settings] for axis in self.axes]
        store, charts = Store(self.folder), sweep_charts(self.axes, shown, rows)
        _, pictures = Drawings.of(store.read_bytes).drawn(charts, ("svg",))
        store.write_files({TABLE: table_csv(self.points, rows), TIMES: times_csv(self.points)} | pictures)
        return [self.folder / TABLE, *(self.folder / "figures" / f"{chart.name}.svg" for chart in charts)]


def _check(document: Document, found: Sequence[Axis], spec: Path) -> None:
    """Each value once, the other fields at their first ones. Raises: SpecError, with all mistakes, each once."""
    first = [axis.settings[0] for axis in found]
    problems = {}
    for place, axis in enumerate(found):
        for setting in axis.settings[min(place, 1) :]:  # the first ones were tried together
            try:
                checked(document, [*first[:place], setting, *first[place + 1 :]], spec)
            except SpecError as error:
                problems.update(dict.fromkeys(error.problems))
    if problems:
        raise SpecError(tuple(problems))


def carry_out(
    spec: Path, sets: Sequence[str], settings: Settings, console: Console, *, shard: str | None = None,
    merge: bool = False,
) -> ExitCode:  # fmt: skip
    """Carry out a sweep, or a part of it, or put together what all parts left. The largest exit code wins.

    Raises: UsageError, ArtefactError, ToolError.
    """
    part, found = Shard() if shard is None else Shard.of(shard), axes(sets)
    try:
        asked = Sweep.of(spec, found, settings)
    except SpecError as error:
        messages = tuple(Message.from_problem(problem) for problem in error.problems)
        invalid = Result(str(spec), "invalid", messages)
        console.show(invalid)
        console.finish("sweep", [invalid], ExitCode.INVALID)
        return ExitCode.INVALID
    chosen = [point for number, point in enumerate(asked.points) if part.holds(number)]
    if merge:
        _must_all_stand(asked)
        results, is_whole = [point.result(asked.name(point), row) for point in chosen if (row := point.row())], True
        for result in results:
            console.show(result, several=True)
    else:
        results, is_whole = asked.carried_out(chosen, settings, console)
    code = exit_code(results)
    rows = [row for row in asked.rows() if row is not None]
    if is_whole and part.count == 1 and len(rows) == len(asked.points):
        written = asked.write(rows)
        told = [f"written: {', '.join(map(str, written))}"]
    else:
        told = [f"{len(rows)} of {len(asked.points)} points are done"]
        told += ["--merge writes the table once all are"] if part.count > 1 else []
    say(line("; ".join(told)), aside=console.format != "text" or console.quiet)
    console.finish("sweep", results, code)
    return code


def _must_all_stand(asked: Sweep) -> None:
    """Raises: ArtefactError where a point is missing."""
    missing = [asked.name(point) for point, row in zip(asked.points, asked.rows(), strict=True) if row is None]
    if missing:
        more = f", and {len(missing) - _LISTED} more" if len(missing) > _LISTED else ""
        some = ", ".join(missing[:_LISTED])
        raise ArtefactError(f"{len(missing)} of {len(asked.points)} points are not done yet: {some}{more}")
