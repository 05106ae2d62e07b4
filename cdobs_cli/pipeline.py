"""The stages of one spec as functions: synthesize, check, simulate, report, export.

Each stage reads the artefacts before it, makes them anew where the chain is broken, and writes its own.
A key says what a stage has read; a stage whose key stands in the stored artefact is not redone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cdobs_cli import __version__
from cdobs_cli.certificate import Check, Witness
from cdobs_cli.design import Design
from cdobs_cli.errors import ArtefactError, CdobsError, UsageError
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.outcome import readable
from cdobs_cli.progress import stage
from cdobs_cli.records import dataclass
from cdobs_cli.store import CONTENT, Store, digest
from cdobs_cli.synthesis import certify, initial_errors, is_design_of, new_design, plant_of, system_of

if TYPE_CHECKING:
    from cdobs_cli.chart import Chart
    from cdobs_cli.export.targets import Exported, Target
    from cdobs_cli.report.drawings import Drawings
    from cdobs_cli.report.model import Report
    from cdobs_cli.run import Run
    from cdobs_cli.spec.model import Spec

T = TypeVar("T")
PARTS = "simulation.parts"  # the folder of what is there of a simulation of many runs that is not through
ARCHIVE = "archive"  # the entry of `digests` for the trajectories beside a summary
_PERIOD_MAX = "period_max"  # whose refuted end has a counterexample of its own law
_FIGURE_OF_RUN = "figures/states.svg"


@dataclass
class Work:
    """One spec on its way through the stages; what a stage made is kept for the next.

    Attributes:
        spec: with the family that was chosen, once there is a design of one.
        forced: stages to redo although their artefact is current.
        effort: 0..3, the refinement schedule of searches and counterexamples.
        draws: whether figures are drawn.
        workers: batches of runs simulated at a time; resumes: whether those of a killed simulation are used.
    """

    spec: Spec
    store: Store
    effort: int = 1
    forced: frozenset[str] = frozenset()
    draws: bool = True
    workers: int = 1
    resumes: bool = False
    design: Design | None = field(default=None, init=False)
    check: Check | None = field(default=None, init=False)
    simulation: dict[str, Any] | None = field(default=None, init=False)
    replayed: dict[str, Any] | None = field(default=None, init=False)
    run: Run | None = field(default=None, init=False)
    exported: list[Path] = field(default_factory=list, init=False)
    redone: set[str] = field(default_factory=set, init=False)

    @cached_property
    def drawings(self) -> Drawings:
        """The figures of the folder; none that stands where stages that draw are forced."""
        from cdobs_cli.report.drawings import Drawings

        forced = self.forced & {"simulate", "replay", "report"}
        return Drawings(self.store.read_bytes) if forced else Drawings.of(self.store.read_bytes)

    def key(self, *sections: str) -> str:
        """Digest of what a stage reads: sections of the spec, normalised, and the versions that matter."""
        content = self.spec.normalised()  # the same whatever family is chosen
        return digest({"sections": {name: content.get(name) for name in sections}, "cdobs": __version__})

    @property
    def design_key(self) -> str:
        cards = self.spec.choice.cards if self.spec.choice else (self.spec.observer.name,)
        starts = (initial_errors(self.spec.chosen(name)) for name in cards)
        start = next((start for start in starts if start is not None), None)
        ends = None if start is None else [[str(value) for value in side] for side in (start.lower, start.upper)]
        return digest({"spec": self.key("plant", "measurement", "observer"), "start": ends, "effort": self.effort})


def synthesize(work: Work) -> Design:
    """The current design, or a new one, stored."""
    if work.design is None and "synthesize" not in work.forced:
        stored = work.store.design()
        current = stored is not None and not stored.cut and _is_current(work, stored)
        work.design = stored if current else None
    if work.design is None:
        with stage("synthesize"):
            if work.spec.choice is None:
                design = new_design(work.spec, work.effort)
            else:
                from cdobs_cli.choice import chosen_design

                work.spec, design = chosen_design(work.spec, work.effort)
        design = replace(design, digests={"key": work.design_key})
        work.design = replace(design, digests=work.store.write("design.json", design.document())["digests"])
        work.redone.add("synthesize")
    return work.design


def _is_current(work: Work, stored: Design) -> bool:
    """Of a spec that leaves its family open, whether it is of one that takes it; that family is the spec's then."""
    choice = work.spec.choice
    if not _comes_from(stored.digests, {"key": work.design_key}) or (choice and stored.family not in choice.cards):
        return False
    spec = work.spec.chosen(stored.family) if choice else work.spec
    if not is_design_of(spec, stored):
        return False
    work.spec = spec
    return True


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _comes_from(digests: Mapping[str, str], expected: Mapping[str, str]) -> bool:
    """Whether an artefact names what it was made of: all that is expected and, besides its own content, no more."""
    return {**digests, CONTENT: ""} == {**expected, CONTENT: ""}


def check(work: Work) -> Check:
    """Re-prove the stored design (or synthesize first), prove the slopes, search counterexamples."""
    if work.check is None:
        design = synthesize(work)
        stored = None if "check" in work.forced else work.store.check()
        if stored is None or not _comes_from(stored.digests, _check_digests(work, design)):
            proved, design = _of_design(work, design, _certify)
            stored = _written(work, replace(proved, digests=_check_digests(work, design)))
            work.redone.add("check")
        work.check = _labelled(work, stored)
    return work.check


def _written(work: Work, proved: Check) -> Check:
    labelled = work.spec.labels.bounds(proved)
    return replace(labelled, digests=work.store.write("check.json", labelled.document())["digests"])


def _labelled(work: Work, stored: Check) -> Check:
    """With the labels of the spec; another label is written anew, and nothing else."""
    if work.spec.labels.bounds(stored) == stored:
        return stored
    return _written(work, stored)


def _check_digests(work: Work, design: Design) -> dict[str, str]:
    return {"key": work.design_key, "design": design.digests[CONTENT]}


def _of_design(work: Work, design: Design, make: Callable[[Work, Design], T]) -> tuple[T, Design]:
    """What is made of a design, and that design: a stored one of which it cannot be made counts as absent."""
    try:
        return make(work, design), design
    except CdobsError:
        raise
    except Exception:
        if "synthesize" in work.redone:
            raise
    work.design, work.forced = None, work.forced | {"synthesize"}
    design = synthesize(work)
    if work.check is not None:
        work.check = None
        check(work)
    return make(work, design), design


def _certify(work: Work, design: Design) -> Check:
    return certify(work.spec, design, work.effort)


def simulate(work: Work) -> dict[str, Any] | None:
    """Plant and observer together; None where the spec asks for no simulation or there is no design.

    Returns the summary as in simulation.json.
    """
    design = synthesize(work)
    if work.simulation is None and work.spec.simulation is not None and design.outcome != "none":
        if "simulate" not in work.forced:
            try:
                work.simulation = _stored_simulation(work, design)
            except ArtefactError:  # edited or damaged: made anew
                work.simulation = None
        if work.simulation is None:
            run, design = _of_design(work, design, _new_run)
            work.run, work.simulation = run, _write_run(work, design, run)
        if work.draws and ("simulate" in work.redone or not work.store.has(_FIGURE_OF_RUN)):
            _draw_run(work, design)
    return work.simulation


def _simulation_digests(work: Work, design: Design) -> dict[str, str]:
    return {"key": work.key("plant", "measurement", "observer", "simulation"), "design": design.digests[CONTENT]}


def _stored_simulation(work: Work, design: Design) -> dict[str, Any] | None:
    """The stored summary; None where there is none of this spec and design. Its trajectories are kept for the report.

    Raises:
        ArtefactError: summary or trajectories are not what was written, or do not belong together.
    """
    document = work.store.read("simulation.json")
    if document is None:
        if work.store.has("simulation.json"):
            raise _damaged(work, "simulation.json")
        return None
    digests = dict(document["digests"])
    named = digests.pop(ARCHIVE, None)
    if not _comes_from(digests, _simulation_digests(work, design)):
        return None
    archive = work.store.read_bytes("simulation.npz")
    if archive is None or _sha256(archive) != named:
        raise _damaged(work, "simulation.npz")
    from cdobs_cli.simulate.agreement import agrees
    from cdobs_cli.simulate.archive import from_bytes

    run = from_bytes(archive, document)
    if not agrees(run, system_of(work.spec, design)):
        raise _damaged(work, "simulation.json")
    work.run = run
    return document


def _damaged(work: Work, name: str) -> ArtefactError:
    told = "was edited or damaged: it is not what was written there" if work.store.has(name) else "is missing"
    return ArtefactError(f"{work.store.folder / name} {told}; `cdobs run` makes it anew")


def _new_run(work: Work, design: Design) -> Run:
    from cdobs_cli.comparison import compared
    from cdobs_cli.simulate.ensemble import Parts, ensemble

    assert work.spec.simulation is not None
    loop = system_of(work.spec, design), work.spec.simulation, design.sampling
    parts = Parts(work.store.folder / PARTS, _simulation_digests(work, design), work.workers, work.resumes)
    return compared(ensemble(*loop, parts), *loop)


def _write_run(work: Work, design: Design, run: Run) -> dict[str, Any]:
    from cdobs_cli.simulate.archive import to_bytes

    # The archive first: simulation.json, which names its digest, is what makes a run count as there.
    archive = to_bytes(run, design.sampling.sensors)
    work.store.write_files({"simulation.npz": archive})
    run = replace(run, digests={**_simulation_digests(work, design), ARCHIVE: _sha256(archive)})
    work.redone.add("simulate")
    return work.store.write("simulation.json", run.document())


def _draw_run(work: Work, design: Design) -> None:
    stored = _stored_check(work, design)
    check = None if stored is None else work.spec.labels.check(stored)
    work.store.write_files(_figures(work, replace(report_model(work, {}), check=check).run_charts))


def _figures(work: Work, charts: Iterable[Chart]) -> dict[str, bytes]:
    """Those of the charts that are not drawn yet, as files by relative name."""
    return work.drawings.drawn(charts, work.spec.figures)[1]


def _stored_check(work: Work, design: Design) -> Check | None:
    """The check made or stored, where it is of this design."""
    stored = work.check or work.store.check()
    if stored is None or not _comes_from(stored.digests, _check_digests(work, design)):
        return None
    return _labelled(work, stored)


def replay(work: Work, identifier: str) -> dict[str, Any]:
    """Run the counterexample of a claim, or of the refuted end of `period_max`; `witness_<claim>_run.json`, its archive
    and its figure.

    Raises:
        UsageError: there is no such claim, or it has no counterexample that can be run.
    """
    proved, design = check(work), synthesize(work)
    known = {one.id: (one.witness, design.sampling) for one in proved.claims if one.witness is not None}
    end = proved.bounds.get(_PERIOD_MAX)
    beyond = None if end is None else design.counterexample(end.refuted)
    if beyond is not None:
        known[_PERIOD_MAX] = Witness.from_document(beyond.data["witness"]), beyond.sampling
    if identifier not in known:
        told = ", ".join(known) or "none"
        raise UsageError(f"{work.spec.source_path}: no counterexample to {identifier!r}; claims that have one: {told}")
    witness, law = known[identifier]
    from cdobs_cli.report.replays import attained_chart, crossing_chart, replay_chart
    from cdobs_cli.report.witnesses import witness_name
    from cdobs_cli.simulate.archive import packed
    from cdobs_cli.simulate.attained import AttainedReplay, replay_attained
    from cdobs_cli.simulate.box import BoxReplay, replay_box
    from cdobs_cli.simulate.witness import Replay
    from cdobs_cli.simulate.witness import replay as run_witness

    observer, name = work.spec.observer, f"{witness_name(identifier)}_run"
    plant = replace(plant_of(work.spec, design), sampling=law)
    again: Replay | BoxReplay | AttainedReplay
    if witness.kind == "box":
        again = replay_box(HybridSystem(plant, observer.observer(plant, design)), design.sampling, witness)
        chart = crossing_chart(name, identifier, plant.states, again.arrays())
    elif witness.kind == "noise":
        again = replay_attained(observer.inclusion(plant, design.gain), witness)
        chart = attained_chart(name, identifier, plant.states[again.state], again.state, again.arrays(), again.entries)
    else:
        again = run_witness(observer.inclusion(plant, design.gain), witness)
        chart = replay_chart(name, identifier, again.arrays(), again.entries)
    archive = packed(again.arrays())
    axes = {label: state for state in plant.states for label in (state, f"error of {state}")}
    shown = work.spec.labels.chart(chart, axes)
    work.store.write_files({f"{name}.npz": archive, **_figures(work, [shown])})
    digests = _check_digests(work, design) | {"check": proved.digests[CONTENT], ARCHIVE: _sha256(archive)}
    document = {"schema_version": 1, "claim": identifier, **again.document(), "digests": digests}
    work.replayed = work.store.write(f"{name}.json", document)
    return work.replayed


def report(work: Work) -> list[Path]:
    """report.md, report.html and all figures, from artefacts that form one chain.

    Raises:
        ArtefactError: there is no current design or check, or an artefact was edited or damaged; a stored run of
            another design is left out.
    """
    try:
        return _report(work)
    except CdobsError:
        raise
    except Exception as error:
        if work.redone:
            raise
        told = f"its artefacts cannot be shown ({type(error).__name__}: {error}); `cdobs run --force` makes them anew"
        raise ArtefactError(f"{work.store.folder}: {told}") from error


def _report(work: Work) -> list[Path]:
    design = take_stored(work)
    if work.simulation is None and work.spec.simulation is not None and design.outcome != "none":
        work.simulation = _stored_simulation(work, design)
    return _render(work)


def take_stored(work: Work) -> Design:
    """Design and check of this spec as they are stored, or as this command made them; returns the design.

    Raises:
        ArtefactError: there is none of them, or it was edited or damaged.
    """
    design = work.design or work.store.design()
    if design is None or not (design is work.design or _is_current(work, design)):
        raise _unusable(work, "design.json", "for this spec", is_whole=design is not None)
    stored = _stored_check(work, design)
    if stored is None:
        raise _unusable(work, "check.json", "for this design", is_whole=work.store.check() is not None)
    work.design, work.check = design, stored
    return design


def _unusable(work: Work, name: str, what_for: str, *, is_whole: bool) -> ArtefactError:
    """Why a stored artefact is not shown: none is there, it is of something else, or it is not what was written."""
    if work.store.has(name) and not is_whole:
        return _damaged(work, name)
    return ArtefactError(f"{work.store.folder}: no current {name} {what_for}; run `cdobs check` first")


def export(work: Work, target: Target, real: str) -> list[Path]:
    """The designed observer as files for use elsewhere, below `export/`; from stored artefacts alone.

    Raises:
        ArtefactError: as `report`.
        UsageError: there is no observer, or the target cannot express it.
    """
    design = take_stored(work)
    if design.outcome == "none":
        raise UsageError(
            f"{work.spec.source_path}: there is no observer to export: {design.reason or 'none was found'}"
        )
    from cdobs_cli.export.targets import files

    written = files(target, _exported(work, design), real)
    work.exported = work.store.write_files({f"export/{name}": content for name, content in written.items()})
    return work.exported


def _exported(work: Work, design: Design) -> Exported:
    """Everything that is written down, with a simulated run to compare it with where the spec has one."""
    from cdobs_cli.export.about import About
    from cdobs_cli.export.portable import portable
    from cdobs_cli.export.step import with_step
    from cdobs_cli.export.targets import Exported
    from cdobs_cli.export.vectors import held, vectors
    from cdobs_cli.report.verdict import words
    from cdobs_cli.simulate.engine import simulate as run_of

    assert work.check is not None
    spec, report, system = work.spec, report_model(work, {}), system_of(work.spec, design)
    law, told, longest = design.sampling, None, float(design.sampling.T_max)
    one = portable(work.store.folder.name, system.plant, system.observer, design, system.original)
    if spec.simulation is not None:
        asked = held(system, spec.simulation, law)
        seen = run_of(*asked, law).trajectories[0]
        told = vectors(one, asked[1], seen, system.plant.n)
        longest = longest or max((call.dt for call in told.calls), default=0.0)
    digests = (("design", design.digests[CONTENT]), ("check", work.check.digests[CONTENT]))
    about = About(
        readable(spec.title), readable(spec.source_path.name), work.check.verdict, words(report), digests,
        law.text(spec.labels.time), spec.labels,
    )  # fmt: skip
    about, told = with_step(one, about, told, longest or 1.0)
    return Exported(one, about, told, system.plant, design, work.check, spec.observer)


def report_model(work: Work, digests: Mapping[str, str]) -> Report:
    """What there is to say of the artefacts made or read so far (a design at least)."""
    from cdobs_cli.findings import at_hand
    from cdobs_cli.report.model import Report

    assert work.design is not None
    told = [(str(one.expectation), one.holds, one.told) for one in at_hand(work.spec, documents(work))]
    spec, design, labels = work.spec, work.design, work.spec.labels
    check = None if work.check is None else labels.check(work.check)
    return Report(
        readable(work.store.folder.name), readable(spec.title), readable(str(spec.source_path)), plant_of(spec, design),
        spec.observer, labels.design(design), check, work.run, spec.typed, spec.coordinates, tuple(told), digests,
        spec.signals, labels, spec.figures,
    )  # fmt: skip


def _render(work: Work) -> list[Path]:
    digests = {name: document["digests"][CONTENT] for name, document in documents(work).items() if document is not None}
    # What the page shows and is not in an artefact.
    spec, shown = work.spec, {"time": work.spec.labels.time, "states": dict(work.spec.labels.states)}
    more = {"spec": spec.normalised(), "title": spec.title, "labels": shown, "cdobs": __version__}
    more["figures"] = spec.figures
    marker, pages = ".report.sha256", ("report.md", "report.html")

    def content() -> bytes:
        written = {name: _sha256(work.store.read_bytes(name) or b"") for name in pages}
        return f"{digest({**digests, **more, 'path': str(spec.source_path), 'pages': written})}\n".encode()

    are_there = all((work.store.folder / name).is_file() for name in (marker, *pages))
    if "report" not in work.forced and are_there and work.store.read_bytes(marker) == content():
        return []
    from cdobs_cli.report.files import render

    model = report_model(work, digests)
    if model.run is None and model.design.outcome == "none" and spec.simulation is not None:
        from cdobs_cli.simulate.alone import plant_alone

        model = replace(model, run=plant_alone(model.plant, spec.simulation))
    paths = work.store.write_files(render(model, work.drawings))
    work.store.write_files({marker: content()})
    work.redone.add("report")
    return paths


def documents(work: Work) -> dict[str, dict[str, Any] | None]:
    """The artefacts made or read so far, as JSON documents."""
    return {
        "design": work.design.document() if work.design else None,
        "check": work.check.document() if work.check else None,
        "simulation": work.simulation,
    }
