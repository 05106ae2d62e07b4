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
from cdobs_cli.exact.numbers import Exact, upper_text
from cdobs_cli.outcome import readable
from cdobs_cli.plant import Box, Plant
from cdobs_cli.store import Store, digest

if TYPE_CHECKING:
    from cdobs_cli.report.model import Report
    from cdobs_cli.run import Run
    from cdobs_cli.spec.model import Spec

STAGES = ("synthesize", "check", "simulate", "report")
# Room for a transient that grows as the slopes over a wider domain do.
_SPARE = 1.5


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
        start = self.initial_errors
        ends = None if start is None else [[str(value) for value in side] for side in (start.lower, start.upper)]
        return digest({"spec": self.key("plant", "measurement", "observer"), "start": ends, "effort": self.effort})

    @property
    def initial_errors(self) -> Box | None:
        """The typed x_hat(0) - x(0), where the estimate may have to be shown to stay near the domain."""
        spec = self.spec
        if spec.simulation is None or not spec.plant.domain or getattr(spec.observer, "saturate", True) is True:
            return None
        return spec.simulation.initial_errors(spec.plant.n)

    def plant(self, design: Design) -> Plant:
        """The plant with the slopes that `synthesize` found where they are `auto`; as it is where it found none."""
        return self.spec.plant.with_slopes(design.slopes) if design.slopes else self.spec.plant


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
    """A design with its slopes found and its estimate confined: of the regions that automatic slopes may be found
    over the first that leaves the estimate room, else the design for the domain itself."""
    plant = work.spec.plant
    if not plant.slopes.auto:
        return _design_for(work, plant)
    saturate = getattr(work.spec.observer, "saturate", False)
    # With affine limits the continuation needs slopes on the whole box: wherever the estimate goes, that one serves.
    if plant.domain.where and saturate is not False and (design := _design_for(work, plant.on_box)).outcome != "none":
        return design
    design = _design_for(work, plant)
    if design.outcome == "none" or design.estimate.way != "open":
        return design
    margin = {} if saturate is True else _margin_needed(work, design)
    again = _design_for(work, plant.widened(margin)) if margin else design
    return again if again.outcome != "none" and again.estimate.way != "open" else design


def _design_for(work: Work, over: Plant) -> Design:
    """A design, its automatic slopes found over the domain of `over`."""
    plant, observer = work.spec.plant, work.spec.observer
    found: dict[str, tuple[str, str]] = {}
    if plant.slopes.auto:
        from cdobs_cli.bounds.slopes import resolve, unbounded_claims

        resolved, found = resolve(over)
        if resolved.slopes.auto:
            reason = "; ".join(claim.statement for claim in unbounded_claims(resolved))
            return Design(observer.name, "none", plant.sampling, {}, reason=reason)
        plant = plant.with_slopes(found)
    design = replace(observer.synthesize(plant, work.effort), slopes=found)
    if design.outcome == "none":
        return design
    return replace(design, estimate=observer.confine(plant, design, work.initial_errors))


def _margin_needed(work: Work, design: Design) -> dict[str, Exact]:
    """How far the estimate goes beyond the domain, with some room; empty where no level set shows it."""
    start = work.initial_errors
    transients = work.spec.observer.transients(work.plant(design), design) if start is not None else ()
    if start is None or not transients:
        return {}
    bounds = min((transient(start) for transient in transients), key=lambda ends: max(float(end) for end in ends))
    if not all(bound.is_finite() for bound in bounds):
        return {}
    return {name: Exact(upper_text(bound * _SPARE, 3)) for name, bound in zip(work.spec.plant.states, bounds, strict=True)}


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
    from cdobs_cli.bounds.estimate import confinement_claim
    from cdobs_cli.bounds.slopes import resolve, slope_claims, unbounded_claims
    from cdobs_cli.certify.conditions import confined_bounds, with_conditions

    family = work.spec.observer
    if work.spec.plant.slopes.auto and not design.slopes:
        statement = f"The error converges: {design.reason or 'there is no design'}."
        convergence = Claim("convergence", "consequence", "undecided", statement, family.source, required=True)
        return Check((convergence, *unbounded_claims(resolve(work.spec.plant)[0])))
    plant = work.plant(design)
    made = family.certify(plant, design, work.effort)
    premises = slope_claims(plant)
    if plant.domain and design.outcome != "none":
        premises += (confinement_claim(plant, design.estimate, family.transients(plant, design)),)
    if work.spec.coordinates is not None:
        premises = work.spec.coordinates.premises(premises)
    domain = work.spec.typed.domain if work.spec.typed else plant.domain
    claims = with_conditions((*premises, *made.claims), plant, design.estimate, domain, disturbed=family.disturbed)
    return Check(claims, confined_bounds(made.bounds, design.sampling, design.estimate))


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
    system = HybridSystem(plant, work.spec.observer.observer_as_run(plant, design), design.estimate.way == "open")
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
    from cdobs_cli.report.replays import replay_chart, replay_figures
    from cdobs_cli.report.witnesses import witness_name
    from cdobs_cli.simulate.witness import replay as run_witness

    design = synthesize(work)
    made_run = run_witness(work.spec.observer.inclusion(work.plant(design), design.gain), claim.witness)
    name = f"{witness_name(claim)}_run"
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
