"""The commands as functions, for notebooks and scripts: the same nouns, artefacts, proofs and errors.

    from cdobs_cli import api

    spec = api.load("motor.yaml")
    checked = api.check(spec)
    checked.verdict, checked.bounds["period_max"].proved
    api.simulate(spec).run.overall.rmse
    api.report(spec)

Everything is stored as the commands store it, `<out>/<name of the spec>/`, and what is current there is not done
again: `check` after `synthesize` takes the design that stands. Work is done in this process, unless several specs or
points are asked for with `jobs` or an executor. Exact results are text (`Bound.proved`), to be turned into what is
wanted.

A spec that is wrong raises `errors.SpecError` with every mistake, and what else cannot be done another
`errors.CdobsError`; nothing is printed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cdobs_cli import pipeline
from cdobs_cli.batch import Settings, engine_of
from cdobs_cli.batch import jobs as jobs_of
from cdobs_cli.batch import run as run_one
from cdobs_cli.certificate import Bound, Check, Claim, Status
from cdobs_cli.console import Console
from cdobs_cli.design import Design
from cdobs_cli.errors import SpecError, UsageError
from cdobs_cli.findings import remarks
from cdobs_cli.outcome import STAGES, Message, Result
from cdobs_cli.progress import watched
from cdobs_cli.records import dataclass
from cdobs_cli.report.html import fragment, pictures_html
from cdobs_cli.report.model import Report
from cdobs_cli.report.verdict import words
from cdobs_cli.run import Run
from cdobs_cli.spec.model import Spec, load, load_document
from cdobs_cli.spec.reader import read_text
from cdobs_cli.spec.replaced import Setting, checked, flow_text
from cdobs_cli.store import Store

if TYPE_CHECKING:
    from cdobs_cli.catalogue import Entry
    from cdobs_cli.compare.figures import Figures
    from cdobs_cli.export.targets import Target

__all__ = [
    "Checked", "Compared", "Designed", "Simulated", "check", "compare", "example", "explain", "export", "load", "parse",
    "replay", "report", "run", "schema", "simulate", "sweep", "synthesize", "theorems", "validate", "with_gain",
]  # fmt: skip

Source = Spec | str | Path
Folder = str | Path
_RESULTS = "results"
_SHOWN = ("states", "error", "bands")


@dataclass(frozen=True, repr=False)
class Told:
    """What was made of a spec; `told` is all that a report says of it."""

    spec: Spec
    told: Report = field(compare=False)


@dataclass(frozen=True, repr=False)
class Designed(Told):
    """A design of a spec; in a notebook observer and gain are shown."""

    design: Design

    def __repr__(self) -> str:
        return f"<{self.told.name}: {self.design.family}, {self.design.outcome}>"

    def _repr_html_(self) -> str:
        return fragment(self.told, ("Observer",))


@dataclass(frozen=True, repr=False)
class Checked(Designed):
    """A design and what is proved and refuted of it; in a notebook verdict, bounds and claims are shown."""

    check: Check

    def __repr__(self) -> str:
        return f"<{self.told.name}: {self.verdict}>"

    @property
    def verdict(self) -> Status:
        return self.check.verdict

    @property
    def words(self) -> tuple[str, ...]:
        """The verdict in sentences."""
        return words(self.told)

    @property
    def bounds(self) -> Mapping[str, Bound]:
        """By name, the two ends of each as exact text, None where there is none."""
        return self.check.bounds

    @property
    def claims(self) -> Mapping[str, Claim]:
        """By id."""
        return {claim.id: claim for claim in self.check.claims}

    def _repr_html_(self) -> str:
        return fragment(self.told, ("Bounds", "Claims"), headed=True)


@dataclass(frozen=True, repr=False)
class Simulated(Told):
    """A simulation of a spec; in a notebook states and errors are shown."""

    run: Run

    def __repr__(self) -> str:
        return f"<{self.told.name}: {len(self.run.summaries)} runs>"

    def _repr_html_(self) -> str:
        return pictures_html([chart for chart in self.told.run_charts if chart.name in _SHOWN])


@dataclass(frozen=True)
class Compared:
    """Observers of one plant side by side, what is left out and why, and the page with table and figure."""

    rows: tuple[Figures, ...]
    notes: tuple[str, ...]
    page: Path


def parse(text: str, name: str = "spec", folder: Folder = ".") -> Spec:
    """A spec from text; `name` stands for that of a file, `folder` is where the files that it names are.

    Raises: SpecError.
    """
    path = Path(folder) / f"{name}.yaml"
    return load_document(read_text(text, str(path)), path)


def with_gain(spec: Source, **gain: Any) -> Spec:
    """The spec with a given gain, by its letters: arrays, numbers, or a state space of python-control (for K or L).

    `api.with_gain("motor.yaml", L=design)`; what is kept is exact: every float is the decimal that Python prints.

    Raises:
        SpecError: the gain is not one of the spec's family.
        UsageError: an object is no gain of an observer of this plant.
    """
    from cdobs_cli.foreign import gain_rows

    known = _spec(spec)
    settings = []
    for letter, value in gain.items():
        try:
            settings.append(Setting(f"observer.gain.{letter}", flow_text(gain_rows(value, known.plant))))
        except (ValueError, TypeError) as error:
            raise UsageError(f"{known.source_path}: {letter}: {error}") from None
    return load_document(checked(known.document, settings, known.source_path), known.source_path)


def validate(spec: Source) -> tuple[Message, ...]:
    """Every mistake, or the remarks on what is right; nothing is computed."""
    try:
        return tuple(remarks(_spec(spec)))
    except SpecError as error:
        return tuple(map(Message.from_problem, error.problems))


def synthesize(
    spec: Source, *, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None
) -> Designed:
    """The gain and a certificate for each period wanted. time_limit: seconds after which searches end with the best.

    Raises: CdobsError.
    """
    with _work(spec, out, effort, force, time_limit) as work:
        design = pipeline.synthesize(work)
        return Designed(work.spec, pipeline.report_model(work, {}), design)


def check(
    spec: Source, *, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None
) -> Checked:
    """The stored certificates and the slopes proved, counterexamples searched. Raises: CdobsError."""
    with _work(spec, out, effort, force, time_limit) as work:
        found = pipeline.check(work)
        assert work.design is not None
        return Checked(work.spec, pipeline.report_model(work, {}), work.design, found)


def simulate(
    spec: Source, *, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None,
    workers: int = 1, resume: bool = False,
) -> Simulated:  # fmt: skip
    """Plant and observer together; `run.trajectories` has times, states and estimates of the first runs as arrays.

    workers: batches of many runs at a time; resume: go on where a killed simulation of many runs was.

    Raises:
        UsageError: the spec has no `simulation` block, or there is no observer to run.
        CdobsError: as `synthesize`.
    """
    with _work(spec, out, effort, force, time_limit) as work:
        work.workers, work.resumes, work.draws = workers, resume, False
        pipeline.simulate(work)
        if work.run is None:
            why = "there is no observer" if work.spec.simulation else "the spec has no simulation block"
            raise UsageError(f"{work.spec.source_path}: nothing is run: {why}")
        return Simulated(work.spec, pipeline.report_model(work, {}), work.run)


def replay(spec: Source, claim: str, *, out: Folder = _RESULTS, effort: int = 1) -> dict[str, Any]:
    """Run the counterexample of a claim, or of `period_max`. Raises: UsageError where it has none; CdobsError."""
    with _work(spec, out, effort) as work:
        work.draws = False
        return pipeline.replay(work, claim)


def report(
    spec: Source, *, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None
) -> Path:
    """All stages and the page of them: report.html, with report.md and the figures beside. Raises: CdobsError."""
    with _work(spec, out, effort, force, time_limit) as work:
        pipeline.check(work)
        pipeline.simulate(work)
        pipeline.report(work)
        return work.store.folder / "report.html"


def export(
    spec: Source, to: Target, *, precision: Literal["double", "float"] = "double", out: Folder = _RESULTS,
    effort: int = 1,
) -> list[Path]:  # fmt: skip
    """Write the designed observer for use elsewhere; returns the files. Raises: CdobsError."""
    with _work(spec, out, effort) as work:
        pipeline.check(work)
        return pipeline.export(work, to, precision)


def run(
    *paths: str | Path, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None,
    jobs: int = 1, executor: str | None = None,
) -> list[Result]:  # fmt: skip
    """All stages on every spec of files and directories, with what each expects; a failure of one is its result.

    jobs: specs at a time, in processes of their own where it is more than 1 or there is a limit; executor:
    `dask=ADDRESS`.

    Raises: UsageError.
    """
    settings = Settings(Path(out), effort, force, jobs=jobs, time_limit=time_limit, executor=executor)
    todo = jobs_of(map(Path, paths), settings.out)
    if jobs == 1 and executor is None and time_limit is None:
        return [run_one(job, STAGES, settings) for job in todo]
    call = partial(run_one, stages=STAGES, settings=settings)
    every = engine_of(settings)(todo, call, workers=jobs, time_limit=time_limit, started=lambda _: None)
    return [result for _, result in sorted(every, key=lambda one: one[0])]


def sweep(
    spec: str | Path, fields: Mapping[str, Sequence[object] | str], *, out: Folder = _RESULTS, effort: int = 1,
    force: bool = False, time_limit: float | None = None, jobs: int = 1, executor: str | None = None,
) -> list[dict[str, str]]:  # fmt: skip
    """The spec designed and checked at every point of a grid; returns the rows of `sweep.csv`.

    fields: by dotted path values, or `lo:hi:count`.

    Raises: SpecError, UsageError, ToolError.
    """
    from cdobs_cli.sweep.grid import axes_of
    from cdobs_cli.sweep.run import Sweep

    settings = Settings(Path(out), effort, force, jobs=jobs, time_limit=time_limit, executor=executor)
    return Sweep.of(Path(spec), axes_of(fields), settings).whole(settings, _SILENT)


def compare(
    *paths: str | Path, out: Folder = _RESULTS, effort: int = 1, force: bool = False, time_limit: float | None = None,
    jobs: int = 1,
) -> Compared:  # fmt: skip
    """Specs of one plant, the families that take it, and baselines, side by side. Raises: SpecError, UsageError."""
    from cdobs_cli.compare.run import Comparing

    settings = Settings(Path(out), effort, force, jobs=jobs, time_limit=time_limit)
    asked = Comparing.of(list(map(Path, paths)), settings)
    results, is_whole = asked.carried_out(settings, _SILENT)
    if not is_whole:
        raise KeyboardInterrupt
    rows, notes = asked.rows(results)
    asked.write(rows, notes)
    return Compared(tuple(rows), tuple(notes), asked.page)


def explain(identifier: str) -> str:
    """The page of a claim, bound, verdict, method or message. Raises: UsageError, with the nearest names."""
    from cdobs_cli.explanation import explained, page_text

    return page_text(*explained(identifier), None)


def theorems() -> list[Entry]:
    """What is implemented: name, source, equation, file:line."""
    from cdobs_cli.catalogue import catalogue

    return list(catalogue())


def schema() -> dict[str, Any]:
    """The JSON Schema of a spec."""
    from cdobs_cli.spec.schema import json_schema

    return json_schema()


def example(family: str = "auto") -> str:
    """A commented spec that runs as it is. Raises: UsageError where there is no such family."""
    from cdobs_cli.scaffold import example as example_of

    return example_of(family)


_SILENT = Console("json", quiet=True)  # prints its document at the end, which nobody asks it for


def _spec(source: Source) -> Spec:
    return source if isinstance(source, Spec) else load(source)


@contextmanager
def _work(
    source: Source, out: Folder, effort: int, force: bool = False, time_limit: float | None = None
) -> Iterator[pipeline.Work]:
    spec = _spec(source)
    store = Store(Path(out) / spec.source_path.stem)
    store.open()
    with watched(None, time_limit):
        yield pipeline.Work(spec, store, effort, frozenset(STAGES) if force else frozenset())
