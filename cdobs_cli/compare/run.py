"""A comparison carried out: every observer designed, checked and run, the filter beside; then table, page, figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cdobs_cli.batch import Settings, jobs
from cdobs_cli.compare.entries import Compared, compared
from cdobs_cli.compare.figures import Figures, figures_of, filter_figures, predictor_figures
from cdobs_cli.compare.table import compare_chart, compare_csv, compare_page, text_lines, times_csv
from cdobs_cli.console import Console, say
from cdobs_cli.errors import ExitCode, SpecError, UsageError
from cdobs_cli.outcome import Message, Result, exit_code
from cdobs_cli.printable import line
from cdobs_cli.records import dataclass
from cdobs_cli.report.drawings import Drawings
from cdobs_cli.store import Store, sweep
from cdobs_cli.sweep.engine import carried_out

FOLDER, TABLE, TIMES, PAGE = "compare", "compare.csv", "compare_times.csv", "compare.html"
STAGES = ("synthesize", "check", "simulate")


@dataclass(frozen=True)
class Comparing:
    """What is compared, and the folder of everything."""

    asked: Compared
    folder: Path

    @staticmethod
    def of(paths: Sequence[Path], settings: Settings) -> Comparing:
        """Raises: SpecError, UsageError."""
        specs = []
        for job in jobs(paths, settings.out, writing=False):
            if job.refused is not None:
                raise UsageError(f"{job.spec}: {job.refused}")
            specs.append(job.spec)
        folder = settings.out / specs[0].stem / FOLDER
        return Comparing(compared(specs, settings.effort, folder), folder)

    @property
    def page(self) -> Path:
        return self.folder / PAGE

    def carried_out(self, settings: Settings, console: Console) -> tuple[list[Result], bool]:
        """Every observer, and whether all were carried out. Raises: ToolError."""
        sweep(self.folder)
        points, names = zip(*((entry.point, entry.name) for entry in self.asked.entries), strict=True)
        settings = replace(settings, out=self.folder, no_report=True)
        return carried_out(points, names, STAGES, settings, console, shown=False)

    def rows(self, results: Sequence[Result]) -> tuple[list[Figures], list[str]]:
        """Each observer, behind a spec's own the baselines on its measurements; and what is not there."""
        rows, notes = [], list(self.asked.notes)
        for entry, result in zip(self.asked.entries, results, strict=True):
            unit = self.asked.specs[entry.place].labels.time
            rows.append(figures_of(entry, result, entry.point.seconds(), self.asked.states, unit))
            if entry.kind == "spec":
                own, spec = rows[-1], self.asked.specs[entry.place]
                for beside in (filter_figures(own, result), predictor_figures(own, spec, result)):
                    if isinstance(beside, Figures):
                        rows.append(beside)
                    elif beside is not None:
                        notes.append(beside)
        if not any(spec.simulation for spec in self.asked.specs):
            notes.append("Nothing is run: the spec has no simulation block.")
        return rows, list(dict.fromkeys(notes))

    def write(self, rows: Sequence[Figures], notes: Sequence[str]) -> list[Path]:
        """Tables, page and figure; returns the table and the page. Raises: ToolError."""
        states = self.asked.states
        store, chart = Store(self.folder), compare_chart(rows, states)
        charts = [] if chart is None else [chart]
        pictures, files = Drawings.of(store.read_bytes).drawn(charts, ("svg",))
        title = f"{self.asked.specs[0].title}: observers compared"
        tables = {TABLE: compare_csv(rows, states), TIMES: times_csv(rows)}
        store.write_files(tables | {PAGE: compare_page(title, rows, states, notes, chart, pictures)} | files)
        return [self.folder / TABLE, self.page]


def carry_out(paths: Sequence[Path], settings: Settings, console: Console) -> ExitCode:
    """Compare what takes the plant of the specs. The exit code is that of the specs themselves: what a baseline does
    not prove is no finding of theirs; a crash of any is one of the tool.

    Raises: UsageError, ToolError.
    """
    try:
        this = Comparing.of(paths, settings)
    except SpecError as error:
        problem = error.problems[0]
        invalid = Result(problem.file or str(paths[0]), "invalid", tuple(map(Message.from_problem, error.problems)))
        console.show(invalid)
        console.finish("compare", [invalid], ExitCode.INVALID)
        return ExitCode.INVALID
    results, is_whole = this.carried_out(settings, console)
    if not is_whole:
        console.finish("compare", results, ExitCode.FAILED)
        return ExitCode.FAILED
    rows, notes = this.rows(results)
    written = this.write(rows, notes)
    counted = [result for entry, result in zip(this.asked.entries, results, strict=True)
               if entry.kind == "spec" or result.status == "failed"]  # fmt: skip
    code = exit_code(counted)
    if console.format == "text" and not console.quiet:
        for told in (*text_lines(rows, this.asked.states), *notes, f"written: {', '.join(map(str, written))}"):
            say(line(told))
    console.finish("compare", results, code) if console.format != "text" else None
    return code
