"""Many specs: which files a PATH means, where their results go, and one Result for each, whatever happens."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from cdobs_cli.errors import INTERRUPTED, CdobsError, ExitCode, Problem, SpecError, ToolError, UsageError, untold
from cdobs_cli.exact.budget import WorkError
from cdobs_cli.outcome import Job, Message, Result, ResultStatus, exit_code, failure, judged, readable
from cdobs_cli.printable import lines
from cdobs_cli.progress import stage, watched
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.console import Console, Follow
    from cdobs_cli.export.targets import Target
    from cdobs_cli.pipeline import Work
    from cdobs_cli.report.index import IndexEntry
    from cdobs_cli.report.model import Report
    from cdobs_cli.spec.model import Spec

Tell = Callable[[Result | str], None]
# (number, Result) of each job as it ends; told which begin and what they do.
Engine = Callable[..., Generator[tuple[int, Result], None, None]]
_FOR_SEARCHES = 0.75  # of a time limit: after it searches end with what they have, so that it can be proved and told
SPEC_SUFFIXES = (".yaml", ".yml")
PLANT_SUFFIXES = (".plant.yaml", ".plant.yml")


@dataclass(frozen=True)
class Settings:
    """The common options of the commands; followed: whether somebody watches; workers: within a spec; executor: a
    cluster as it is typed, None for this machine."""

    out: Path = Path("results")
    effort: int = 1
    force: bool = False
    verbose: bool = False
    jobs: int = 1
    time_limit: float | None = None
    witness: str | None = None
    no_report: bool = False
    resume: bool = False
    to: Target = "c99"
    precision: str = "double"
    workers: int = 1
    followed: bool = False
    executor: str | None = None


def jobs(paths: Iterable[Path], out: Path, *, writing: bool = True) -> list[Job]:
    """The specs that the paths mean, in a stable order, each once; never empty for a path.

    A directory without a spec, a folder that cannot be read, and a spec whose results would fall on those of
    another (where there is any `writing`) are jobs too, `refused`: they cost an exit code, and the others are
    carried out.
    """
    todo: dict[Path, Job] = {}
    owners: dict[Path, Path] = {}
    for path in paths:
        for job in _below(path, out) if path.is_dir() else [Job(path, out / path.stem)]:
            if job.spec.absolute() in todo:
                continue
            owner = owners.setdefault(job.folder, job.spec) if job.refused is None else job.spec
            if writing and owner.resolve() != job.spec.resolve():
                taken = f"{owner} has its results in {job.folder} already"
                job = replace(job, refused=f"{taken}; give one of them another name or another --out")
            elif owner != job.spec and owner.resolve() == job.spec.resolve():
                continue  # the same file by another name
            todo[job.spec.absolute()] = job
    return list(todo.values())


def _below(top: Path, out: Path) -> list[Job]:
    """The jobs of a directory: sorted by path; links to directories are not followed."""
    results, specs, refused = out.resolve(), [], []

    def unreadable(error: OSError) -> None:
        refused.append(Job(Path(error.filename or top), out, f"cannot be read: {error.strerror or error}"))

    for place, folders, files in os.walk(top, onerror=unreadable):
        seen = sorted(name for name in folders if not name.startswith("."))
        folders[:] = [name for name in seen if (Path(place) / name).resolve() != results]
        names = [name for name in files if not name.startswith(".") and not name.endswith(PLANT_SUFFIXES)]
        specs += [Path(place) / name for name in names if name.endswith(SPEC_SUFFIXES)]
    if not specs and not refused:
        return [Job(top, out, "no spec (*.yaml, *.yml) below this directory")]
    return [*refused, *(Job(spec, out / spec.relative_to(top).with_suffix("")) for spec in sorted(specs))]


def run(job: Job, stages: tuple[str, ...], settings: Settings, tell: Tell | None = None) -> Result:
    """Carry out the stages on one spec. Every failure becomes a Result; only KeyboardInterrupt passes.

    With a time limit, what is known before each stage is given to `tell`; where it is followed, what is being done.
    """
    start, busy = time.perf_counter(), time.process_time()
    try:
        if job.refused is not None:
            raise UsageError(job.refused)
        result = _run(job, stages, settings, tell)
    except Exception as error:
        result = _ended_by(error, str(job.spec), settings)
    return replace(result, seconds=time.perf_counter() - start, cpu=time.process_time() - busy)


def _ended_by(error: Exception, spec: str, settings: Settings) -> Result:
    """What an error says of a spec."""
    if isinstance(error, SpecError):
        return Result(spec, "invalid", tuple(Message.from_problem(problem) for problem in error.problems))
    if isinstance(error, WorkError):  # not a mistake that reading could tell, and nothing was decided
        return Result(spec, "finding", (Message("error", f"undecided: {error}", spec, rule="work"),))
    if isinstance(error, CdobsError):
        status: ResultStatus = "invalid" if error.exit_code == ExitCode.INVALID else "failed"
        return Result(spec, status, (Message("error", str(error), spec, rule=error.rule),))
    if settings.verbose and not isinstance(error, OSError):
        _show_where(error)
    return failure(spec, untold(error))


def _run(job: Job, stages: tuple[str, ...], settings: Settings, tell: Tell | None) -> Result:
    from cdobs_cli.spec.model import load

    spec = load(job.spec)
    if not stages:
        from cdobs_cli.findings import remarks

        return Result(str(job.spec), "ok", tuple(remarks(spec)))
    from cdobs_cli import pipeline
    from cdobs_cli.store import Store

    store = Store(job.folder)
    store.open()
    forced = frozenset(stages) if settings.force else frozenset()
    work = pipeline.Work(spec, store, settings.effort, forced, draws=not settings.no_report)
    work.workers, work.resumes = settings.workers, settings.resume
    limit = settings.time_limit
    further = {"replay": (settings.witness,), "export": (settings.to, settings.precision)}
    try:
        with watched(tell if settings.followed else None, None if limit is None else limit * _FOR_SEARCHES) as watch:
            for number, name in enumerate(stages, start=1):
                if tell is not None and limit is not None:
                    tell(_known(work, job, stages[: number - 1], settings, stages[number - 1 :]))
                with stage(name):  # they are the functions of their names
                    getattr(pipeline, name)(work, *further.get(name, ()))
    except SpecError as error:  # what only a run can see, e.g. a signal that leaves its interval
        raise SpecError(tuple(_placed(problem, spec) for problem in error.problems)) from error
    return replace(_known(work, job, stages, settings), stages=watch.stages)


def _known(work: Work, job: Job, stages: tuple[str, ...], settings: Settings, waiting: tuple[str, ...] = ()) -> Result:
    """What there is to say after the stages that were carried out."""
    if not stages:
        return Result(str(job.spec), "ok", waiting=waiting)
    from cdobs_cli import findings, pipeline
    from cdobs_cli.report.summary import headline, summary_lines

    documents, report = pipeline.documents(work), pipeline.report_model(work, {})
    seen = _seen_by(stages, documents)
    messages = tuple(findings.find(work.spec, documents, seen))
    lines = (*summary_lines(report), *(f"  written: {readable(str(path))}" for path in work.exported))
    expected = tuple(Problem(one.expectation.field, "").path for one in findings.decided(work.spec, documents, seen))
    return Result(
        str(job.spec), judged(messages), messages, documents["design"], documents["check"],
        work.replayed or documents["simulation"],
        headline(report), lines, expected,
        _row(report, job, settings) if "report" in stages else None, waiting=waiting,
    )  # fmt: skip


def _row(report: Report, job: Job, settings: Settings) -> IndexEntry:
    """Of the index page."""
    from cdobs_cli.report.index import IndexEntry

    pictures = sorted(path.stem for path in (job.folder / "figures").glob("*.svg"))
    return IndexEntry.of(report, job.folder.relative_to(settings.out).as_posix(), pictures)


def _show_where(error: BaseException) -> None:
    import traceback

    with suppress(OSError, ValueError):
        print(lines("".join(traceback.format_exception(error))), file=sys.stderr)  # noqa: T201


def _placed(problem: Problem, spec: Spec) -> Problem:
    if problem.file is not None:
        return problem
    file, line, column = spec.location(problem.field)
    return replace(problem, file=file, line=line, column=column)


def _seen_by(stages: tuple[str, ...], documents: Mapping[str, object]) -> frozenset[str]:
    """The stages whose findings count: a report tells what is there of the check and the simulation, an export of the
    check."""
    if stages == ("export",):
        return frozenset({"export", "check"})
    shown = {"check", *(("simulate",) if documents["simulation"] is not None else ())} if stages == ("report",) else ()
    return frozenset({*stages, *shown})


def carry_out(
    command: str, paths: Sequence[Path], stages: tuple[str, ...], settings: Settings, console: Console
) -> ExitCode:
    """Carry out a command on every spec the paths mean; the largest exit code wins, every spec is processed.

    After an interrupt, what has ended is told as it is, and the rest as failed.
    """
    todo = jobs(paths, settings.out, writing=bool(stages))
    results: dict[int, Result] = {}
    interrupted = False
    with console.following([str(job.spec) for job in todo], briefly=not stages) as follow:
        alone = len(todo) == 1
        settings = replace(settings, followed=follow.live is not None, workers=settings.jobs if alone else 1)
        try:
            with closing(_each(todo, stages, settings, follow)) as ended:
                for number, result in ended:
                    results[number] = result
                    follow.ended(number, result)
        except KeyboardInterrupt:
            interrupted = True
    ordered = [results.get(number) or failure(str(job.spec), INTERRUPTED) for number, job in enumerate(todo)]
    if "report" in stages and not interrupted and any(path.is_dir() for path in paths):
        try:
            _write_index(ordered, settings.out)
        except ToolError as error:
            ordered.append(failure(str(settings.out / "index.html"), str(error)))
            console.show(ordered[-1])
    code = exit_code(ordered)
    if interrupted:
        console.warn(INTERRUPTED)
    console.finish(command, ordered, code)
    return code


def _each(
    todo: list[Job], stages: tuple[str, ...], settings: Settings, follow: Follow
) -> Generator[tuple[int, Result], None, None]:
    if stages or settings.time_limit is not None:
        # What every worker needs is loaded once, before they part.
        for module in ("cdobs_cli.spec.model", *(("cdobs_cli.report.index",) if "report" in stages else ())):
            import_module(module)
        call, limit = partial(run, stages=stages, settings=settings), settings.time_limit
        yield from engine_of(settings)(
            todo, call, workers=settings.jobs, time_limit=limit, started=follow.started, heard=follow.heard
        )
        return
    for number, job in enumerate(todo):
        follow.started(number)
        yield number, run(job, stages, settings)


def engine_of(settings: Settings) -> Engine:
    """What carries jobs out: worker processes here, or a cluster. Raises: UsageError."""
    if settings.executor is not None:
        from cdobs_cli.remote import Cluster

        return Cluster.of(settings.executor).each
    from cdobs_cli.isolation import each_isolated

    return each_isolated


def _write_index(results: list[Result], out: Path) -> None:
    from cdobs_cli.report.index import IndexEntry, index_page
    from cdobs_cli.store import sweep, write_atomically

    sweep(out)
    rows = []
    for result in results:
        message = readable("; ".join(str(message) for message in result.messages))
        row = result.index or IndexEntry(readable(Path(result.spec).stem), readable(result.spec), result.status)
        rows.append(replace(row, message=message, holds=result.status == "ok"))
    write_atomically(out / "index.html", index_page(rows))
