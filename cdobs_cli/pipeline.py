"""The stages of one spec as functions: synthesize, check, simulate, report.

Each stage reads the artefacts before it, makes them anew where the chain is broken, and writes its own.
A key says what a stage has read; a stage whose key stands in the stored artefact is not redone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cdobs_cli import __version__
from cdobs_cli.certificate import Check, Claim
from cdobs_cli.design import Design
from cdobs_cli.errors import ArtefactError, UsageError
from cdobs_cli.outcome import readable
from cdobs_cli.plant import Plant
from cdobs_cli.store import Store, digest

if TYPE_CHECKING:
    from cdobs_cli.report.model import Report
    from cdobs_cli.run import Run
    from cdobs_cli.spec.model import Spec

STAGES = ("synthesize", "check", "simulate", "report")


@dataclass
class Work:
    """One spec on its way through the stages; what a stage made is kept for the next.

    Attributes:
        forced: stages to redo although their artefact is current.
        effort: 0..3, the refinement schedule of searches and counterexamples.
    """

    spec: Spec
    store: Store
    effort: int = 1
    forced: frozenset[str] = frozenset()
    design: Design | None = field(default=None, init=False)
    check: Check | None = field(default=None, init=False)
    simulation: dict[str, Any] | None = field(default=None, init=False)
    run: Run | None = field(default=None, init=False)
    redone: set[str] = field(default_factory=set, init=False)

    def key(self, *sections: str) -> str:
        """Digest of what a stage reads: sections of the spec, normalised, and the versions that matter."""
        content = self.spec.normalised()
        return digest({"sections": {name: content.get(name) for name in sections}, "cdobs": __version__})

    @property
    def design_key(self) -> str:
        return digest({"spec": self.key("plant", "measurement", "observer"), "effort": self.effort})

    def plant(self, design: Design) -> Plant:
        """The plant with the slopes that `synthesize` found where they are `auto`."""
        return self.spec.plant.with_slopes(design.slopes)


def synthesize(work: Work) -> Design:
    """The current design, or a new one, stored."""
    if work.design is None and "synthesize" not in work.forced:
        stored = work.store.design()
        if stored is not None and _is_current(work, stored):
            work.design = stored
    if work.design is None:
        design = replace(_new_design(work), digests={"key": work.design_key})
        work.store.write("design.json", design.document())
        work.redone.add("synthesize")
        work.design = design
    return work.design


def _is_current(work: Work, stored: Design) -> bool:
    """Whether a stored design was made of this spec, and is for the sampling law that the spec asks for (under
    max_period: that law at the same period or a longer one)."""
    if stored.family != work.spec.observer.name or stored.digests.get("key") != work.design_key:
        return False
    asked, law = work.spec.plant.sampling, stored.sampling
    if law == asked:
        return True
    longer = (law.T_max - asked.T_max).sign() == 1 and law == asked.with_period(law.T_max)
    return longer and getattr(work.spec.observer, "objective", None) == "max_period"


def _new_design(work: Work) -> Design:
    plant = work.spec.plant
    found: dict[str, tuple[str, str]] = {}
    if plant.slopes.auto:
        from cdobs_cli.certify.slopes import resolve

        plant, found = resolve(plant)
        if plant.slopes.auto:
            names = ", ".join(f"d phi_{i + 1}/d x_{j + 1}" for i, j in sorted(plant.slopes.auto))
            reason = f"no bound could be proved for {names}; declare a smaller domain or the slopes themselves"
            return Design(work.spec.observer.name, "none", plant.sampling, {}, reason=reason)
    return replace(work.spec.observer.synthesize(plant, work.effort), slopes=found)


def check(work: Work) -> Check:
    """Re-prove the stored design (or synthesize first), prove the slopes, search counterexamples."""
    if work.check is None:
        design = synthesize(work)
        digests = {"key": work.design_key, "design": digest(design.document())}
        stored = None if "check" in work.forced else work.store.check()
        if stored is None or stored.digests != digests:
            stored = replace(_certify(work, design), digests=digests)
            work.store.write("check.json", stored.document())
            work.redone.add("check")
        work.check = stored
    return work.check


def _certify(work: Work, design: Design) -> Check:
    from cdobs_cli.certify.slopes import slope_claims

    family = work.spec.observer
    if work.spec.plant.slopes.auto and not design.slopes:
        statement = f"The error converges: {design.reason or 'there is no design'}."
        return Check((Claim("convergence", "consequence", "undecided", statement, family.source, required=True),))
    plant = work.plant(design)
    made = family.certify(plant, design, work.effort)
    premises = slope_claims(plant)
    if work.spec.coordinates is not None:
        premises = work.spec.coordinates.premises(premises)
    return Check((*premises, *made.claims), made.bounds)


def simulate(work: Work) -> dict[str, Any] | None:
    """Plant and observer together; None where the spec asks for no simulation or there is no design.

    Returns the summary as in simulation.json; the trajectories are read back only where they are needed.
    """
    design = synthesize(work)
    if work.simulation is None and work.spec.simulation is not None and design.outcome != "none":
        if "simulate" not in work.forced:
            work.simulation = _current_simulation(work, design)
        if work.simulation is None:
            work.run = replace(_new_run(work, design), digests=_simulation_digests(work, design))
            work.simulation = work.run.document()
            _write_run(work, design, work.run)
    return work.simulation


def _simulation_digests(work: Work, design: Design) -> dict[str, str]:
    return {"key": work.key("plant", "measurement", "observer", "simulation"), "design": digest(design.document())}


def _current_simulation(work: Work, design: Design) -> dict[str, Any] | None:
    document = work.store.read("simulation.json")
    current = document is not None and document.get("digests") == _simulation_digests(work, design)
    return document if current and (work.store.folder / "simulation.npz").is_file() else None


def _new_run(work: Work, design: Design) -> Run:
    from cdobs_cli.hybrid import HybridSystem
    from cdobs_cli.simulate.engine import simulate as engine

    assert work.spec.simulation is not None
    plant = work.plant(design)
    system = HybridSystem(plant, work.spec.observer.observer(plant, design))
    return engine(system, work.spec.simulation, design.sampling)


def _write_run(work: Work, design: Design, run: Run) -> None:
    from cdobs_cli.report.files import figures_of_run
    from cdobs_cli.simulate.archive import to_bytes

    # The archive first: simulation.json, which names its digests, is what makes a run count as there.
    work.store.write_files({"simulation.npz": to_bytes(run)})
    spec = work.spec
    work.store.write_files(figures_of_run(work.plant(design), spec.observer, design, work.store.check(), run, spec.coordinates))
    work.store.write("simulation.json", run.document())
    work.redone.add("simulate")


def replay(work: Work, identifier: str) -> dict[str, Any]:
    """Run the counterexample of a claim; `witness_<claim>_run.json`, its archive and its figure.

    Raises:
        UsageError: there is no such claim, or it has no counterexample that can be run.
    """
    made = check(work)
    claim = made.claim(identifier)
    if claim is None or claim.witness is None:
        told = ", ".join(one.id for one in made.claims if one.witness is not None) or "none"
        raise UsageError(f"{work.spec.source_path}: no counterexample to {identifier!r}; claims that have one: {told}")
    from cdobs_cli.hybrid import HybridSystem
    from cdobs_cli.report.replays import crossing_chart, replay_chart, replay_figures
    from cdobs_cli.report.witnesses import witness_name
    from cdobs_cli.simulate.box import BoxReplay, replay_box
    from cdobs_cli.simulate.witness import Replay
    from cdobs_cli.simulate.witness import replay as run_witness

    design = synthesize(work)
    name, plant = f"{witness_name(claim)}_run", work.plant(design)
    made_run: Replay | BoxReplay
    if claim.witness.kind == "box":
        made_run = replay_box(HybridSystem(plant, work.spec.observer.observer(plant, design)), design.sampling, claim.witness)
        chart = crossing_chart(name, identifier, plant.states, made_run.arrays())
    else:
        made_run = run_witness(work.spec.observer.inclusion(plant, design.gain), claim.witness)
        chart = replay_chart(name, identifier, made_run.arrays(), made_run.entries)
    work.store.write_files({f"{name}.npz": made_run.to_bytes(), **replay_figures(chart)})
    work.simulation = {"schema_version": 1, "claim": identifier, **made_run.document(), "digests": dict(made.digests)}
    work.store.write(f"{name}.json", work.simulation)
    return work.simulation


def report(work: Work) -> list[Path]:
    """report.md, report.html and all figures, from artefacts that form one chain.

    Raises:
        ArtefactError: there is no current design or check; a stored run of another design is left out.
    """
    design = work.design or work.store.design()
    if design is None or design.digests.get("key") != work.design_key:
        raise ArtefactError(f"{work.store.folder}: no current design.json for this spec; run `cdobs check` first")
    made = work.check or work.store.check()
    if made is None or made.digests != {"key": work.design_key, "design": digest(design.document())}:
        raise ArtefactError(f"{work.store.folder}: no current check.json for this design; run `cdobs check` first")
    work.design, work.check = design, made
    if work.simulation is None and work.spec.simulation is not None and design.outcome != "none":
        work.simulation = _current_simulation(work, design)
    return _render(work, design, made)


def report_model(work: Work, digests: Mapping[str, str]) -> Report:
    """What there is to say of the artefacts made or read so far (a design at least)."""
    from cdobs_cli.findings import decided
    from cdobs_cli.report.model import build_report

    assert work.design is not None
    told = [(str(outcome.expectation), outcome.holds, outcome.text) for outcome in decided(work.spec, documents(work), frozenset(STAGES))]
    return build_report(
        name=readable(work.store.folder.name), title=readable(work.spec.title), spec_path=readable(str(work.spec.source_path)),
        plant=work.plant(work.design), family=work.spec.observer, design=work.design, check=work.check, run=work.run,
        expectations=told, digests=digests, typed=work.spec.typed, coordinates=work.spec.coordinates,
    )  # fmt: skip


def _render(work: Work, design: Design, made: Check) -> list[Path]:
    digests = {"design": digest(design.document()), "check": digest(made.document()), "simulation": digest(work.simulation)}
    # What the page shows and is not in an artefact.
    content = digest(
        {**digests, "spec": work.spec.normalised(), "title": work.spec.title, "path": str(work.spec.source_path), "cdobs": __version__}
    )
    marker = work.store.folder / ".report.sha256"
    page = work.store.folder / "report.html"
    if "report" not in work.forced and page.is_file() and marker.is_file() and marker.read_text().strip() == content:
        return []
    if work.run is None and work.simulation is not None:
        from cdobs_cli.simulate.archive import from_file

        work.run = from_file(work.store.folder / "simulation.npz", work.simulation)
    from cdobs_cli.report.files import render

    paths = work.store.write_files(render(report_model(work, digests)))
    work.store.write_files({marker.name: (content + "\n").encode()})
    work.redone.add("report")
    return paths


def documents(work: Work) -> dict[str, dict[str, Any] | None]:
    """The artefacts made or read so far, as JSON documents."""
    return {
        "design": work.design.document() if work.design else None,
        "check": work.check.document() if work.check else None,
        "simulation": work.simulation,
    }
