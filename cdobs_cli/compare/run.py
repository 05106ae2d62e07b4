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
from cdobs_cli.report.drawings import Drawings
from cdobs_cli.store import Store, sweep
from cdobs_cli.sweep.carried import carried_out

FOLDER, TABLE, TIMES, PAGE = "compare", "compare.csv", "compare_times.csv", "compare.html"
STAGES = ("synthesize", "check", "simulate")


def carry_out(paths: Sequence[Path], settings: Settings, console: Console) -> ExitCode:
    """Compare what takes the plant of the specs. The exit code is that of the specs themselves: what a baseline does
    not prove is no finding of theirs; a crash of any is one of the tool.

    Raises: UsageError, ToolError.
    """
    specs = []
    for job in jobs(paths, settings.out, writing=False):
        if job.refused is not None:
            raise UsageError(f"{job.spec}: {job.refused}")
        specs.append(job.spec)
    folder = settings.out / specs[0].stem / FOLDER
    try:
        asked = compared(specs, settings.effort, folder)
    except SpecError as error:
        problem = error.problems[0]
        invalid = Result(problem.file or str(specs[0]), "invalid", tuple(map(Message.from_problem, error.problems)))
        console.show(invalid)
        console.finish("compare", [invalid], ExitCode.INVALID)
        return ExitCode.INVALID
    sweep(folder)
    points, names = [entry.point for entry in asked.entries], [entry.name for entry in asked.entries]
    settings = replace(settings, out=folder, no_report=True)
    results, is_whole = carried_out(points, names, STAGES, settings, console, shown=False)
    if not is_whole:
        console.finish("compare", results, ExitCode.FAILED)
        return ExitCode.FAILED
    rows, notes = _rows(asked, results)
    written = _write(asked, rows, notes, folder)
    counted = [result for entry, result in zip(asked.entries, results, strict=True)
               if entry.kind == "spec" or result.status == "failed"]  # fmt: skip
    code = exit_code(counted)
    if console.format == "text" and not console.quiet:
        for told in (*text_lines(rows, asked.states), *notes, f"written: {', '.join(map(str, written))}"):
            say(line(told))
    console.finish("compare", results, code) if console.format != "text" else None
    return code


def _rows(asked: Compared, results: Sequence[Result]) -> tuple[list[Figures], list[str]]:
    """Each observer, behind a spec's own the baselines on its measurements; and what is not there."""
    rows, notes = [], list(asked.notes)
    for entry, result in zip(asked.entries, results, strict=True):
        unit = asked.specs[entry.place].labels.time
        rows.append(figures_of(entry, result, entry.point.seconds(), asked.states, unit))
        if entry.kind == "spec":
            own, spec = rows[-1], asked.specs[entry.place]
            for beside in (filter_figures(own, result), predictor_figures(own, spec, result)):
                if isinstance(beside, Figures):
                    rows.append(beside)
                elif beside is not None:
                    notes.append(beside)
    if not any(spec.simulation for spec in asked.specs):
        notes.append("Nothing is run: the spec has no simulation block.")
    return rows, list(dict.fromkeys(notes))


def _write(asked: Compared, rows: Sequence[Figures], notes: Sequence[str], folder: Path) -> list[Path]:
    store, chart = Store(folder), compare_chart(rows, asked.states)
    charts = [] if chart is None else [chart]
    pictures, files = Drawings.of(store.read_bytes).drawn(charts, ("svg",))
    title = f"{asked.specs[0].title}: observers compared"
    tables = {TABLE: compare_csv(rows, asked.states), TIMES: times_csv(rows)}
    store.write_files(tables | {PAGE: compare_page(title, rows, asked.states, notes, chart, pictures)} | files)
    return [folder / TABLE, folder / PAGE]
