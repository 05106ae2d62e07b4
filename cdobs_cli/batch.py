"""Many specs: which files a PATH means, where their results go, and one Result for each, whatever happens."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cdobs_cli.errors import ArtefactError, CdobsError, ExitCode, SpecError, UsageError
from cdobs_cli.outcome import Message, Result, ResultStatus, exit_code

if TYPE_CHECKING:
    from cdobs_cli.console import Console
    from cdobs_cli.errors import Problem
    from cdobs_cli.pipeline import Work
    from cdobs_cli.spec.model import Spec

SPEC_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class Job:
    """One spec and the folder of its artefacts."""

    spec: Path
    folder: Path


@dataclass(frozen=True)
class Settings:
    """The common options of the commands."""

    out: Path = Path("results")
    effort: int = 1
    force: bool = False
    verbose: bool = False
    jobs: int = 1
    time_limit: float | None = None
    witness: str | None = None


def jobs(paths: Iterable[Path], out: Path) -> list[Job]:
    """The specs that the paths mean, in a stable order, each once.

    Raises:
        UsageError: a path that does not exist, a directory without a spec, two specs for one folder.
    """
    found: dict[Path, Job] = {}
    for path in paths:
        specs = _below(path, out) if path.is_dir() else [path]
        if not specs:
            raise UsageError(f"{path}: no spec (*.yaml, *.yml) below this directory")
        for spec in specs:
            relative = spec.relative_to(path).parent if path.is_dir() else Path()
            found.setdefault(spec.resolve(), Job(spec, out / relative / spec.stem))
    folders: dict[Path, Path] = {}
    for job in found.values():
        other = folders.setdefault(job.folder, job.spec)
        if other != job.spec:
            raise UsageError(f"{other} and {job.spec} would both write {job.folder}; give one of them another name or another --out")
    return list(found.values())


def _below(folder: Path, out: Path) -> list[Path]:
    results, specs = out.resolve(), []
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and (Path(place) / name).resolve() != results)
        for name in sorted(files):
            if name.endswith(SPEC_SUFFIXES) and not name.startswith(".") and not name.endswith((".plant.yaml", ".plant.yml")):
                specs.append(Path(place) / name)
    return sorted(specs)


def run(job: Job, stages: tuple[str, ...], settings: Settings) -> Result:
    """Carry out the stages on one spec. Every failure becomes a Result; only KeyboardInterrupt passes."""
    start = time.perf_counter()
    try:
        result = _run(job, stages, settings)
    except UsageError as error:
        result = Result(str(job.spec), "invalid", (Message("error", str(error), rule="command"),))
    except SpecError as error:
        result = Result(str(job.spec), "invalid", tuple(Message.from_problem(problem) for problem in error.problems))
    except ArtefactError as error:
        result = Result(str(job.spec), "invalid", (Message("error", str(error), str(job.spec), rule="artefact"),))
    except CdobsError as error:
        result = Result(str(job.spec), "failed", (Message("error", str(error), str(job.spec), rule="tool"),))
    except (Exception, RecursionError, MemoryError) as error:
        if settings.verbose:
            import traceback

            traceback.print_exc(file=sys.stderr)
        text = f"internal error, {type(error).__name__}: {error}; please report it (-v prints where it happened)"
        result = Result(str(job.spec), "failed", (Message("error", text, str(job.spec), rule="tool"),))
    return replace(result, seconds=time.perf_counter() - start)


def _run(job: Job, stages: tuple[str, ...], settings: Settings) -> Result:
    from cdobs_cli.spec.model import load

    spec = load(job.spec)
    if not stages:
        return Result(str(job.spec), "ok")
    from cdobs_cli import pipeline
    from cdobs_cli.findings import find
    from cdobs_cli.store import Store

    work = pipeline.Work(spec, Store(job.folder), settings.effort, frozenset(stages) if settings.force else frozenset())
    verbs: dict[str, Callable[[pipeline.Work], object]] = {
        "synthesize": pipeline.synthesize, "check": pipeline.check, "simulate": pipeline.simulate, "report": pipeline.report,
        "replay": partial(pipeline.replay, identifier=settings.witness or ""),
    }  # fmt: skip
    try:
        for stage in stages:
            verbs[stage](work)
    except SpecError as error:  # what only a run can see, e.g. a signal that leaves its interval
        raise SpecError(tuple(_placed(problem, spec) for problem in error.problems)) from error
    documents = pipeline.documents(work)
    messages = find(spec, documents, frozenset(stages))
    status: ResultStatus = "finding" if messages else "ok"
    return Result(str(job.spec), status, tuple(messages), **documents, **_told(work, job, stages, settings))  # type: ignore[arg-type]


def _placed(problem: Problem, spec: Spec) -> Problem:
    if problem.file is not None:
        return problem
    file, line, column = spec.location(problem.field)
    return replace(problem, file=file, line=line, column=column)


def _told(work: Work, job: Job, stages: tuple[str, ...], settings: Settings) -> dict[str, object]:
    """The lines for people, and the row of the index page."""
    from cdobs_cli.pipeline import report_model
    from cdobs_cli.report.text import summary_lines

    report = report_model(work, {})
    told: dict[str, object] = {"summary": tuple(summary_lines(report))}
    if "report" in stages:
        from cdobs_cli.report.index import IndexEntry

        pictures = sorted(path.stem for path in (job.folder / "figures").glob("*.svg"))
        told["index"] = IndexEntry.of(report, job.folder.relative_to(settings.out).as_posix(), pictures)
    return told


def carry_out(command: str, paths: Sequence[Path], stages: tuple[str, ...], settings: Settings, console: Console) -> ExitCode:
    """Carry out a command on every spec the paths mean; the largest exit code wins, every spec is processed.

    Raises:
        UsageError: the paths mean no spec.
    """
    todo = jobs(paths, settings.out)
    results: dict[int, Result] = {}
    with console.following([str(job.spec) for job in todo]) as follow:
        for number, result in _each(todo, stages, settings, follow.started):
            results[number] = result
            follow.ended(number, result)
    ordered = [results[number] for number in range(len(todo))]
    if "report" in stages and any(path.is_dir() for path in paths):
        _write_index(ordered, settings.out)
    code = exit_code(ordered)
    console.finish(command, ordered, code)
    return code


def _each(todo: list[Job], stages: tuple[str, ...], settings: Settings, started: Callable[[int], None]) -> Iterator[tuple[int, Result]]:
    call = partial(run, stages=stages, settings=settings)
    if settings.time_limit is not None or (stages and len(todo) > 1):
        from cdobs_cli.isolation import each_isolated

        yield from each_isolated(todo, call, workers=settings.jobs, time_limit=settings.time_limit, started=started)
        return
    for number, job in enumerate(todo):
        started(number)
        yield number, call(job)


def _write_index(results: list[Result], out: Path) -> None:
    from cdobs_cli.report.index import IndexEntry, index_page
    from cdobs_cli.store import write_atomically

    rows = []
    for result in results:
        message = "; ".join(str(message) for message in result.messages)
        row = result.index or IndexEntry(Path(result.spec).stem, result.spec, result.status, holds=False)
        rows.append(replace(row, message=message, holds=result.status == "ok", seconds=result.seconds))
    write_atomically(out / "index.html", index_page(rows))
