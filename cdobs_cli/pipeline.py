"""The stages of one spec as functions: synthesize, check, simulate, report.

Each stage reads the artefacts before it, makes them anew where the chain is broken, and writes its own.
A key says what a stage has read; a stage whose key stands in the stored artefact is not redone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cdobs_cli import __version__
from cdobs_cli.certificate import Check, Claim
from cdobs_cli.design import Design
from cdobs_cli.errors import ArtefactError, CdobsError, UsageError
from cdobs_cli.exact.numbers import Exact, upper_text
from cdobs_cli.outcome import readable
from cdobs_cli.plant import Box, Plant
from cdobs_cli.store import CONTENT, Store, digest

if TYPE_CHECKING:
    from cdobs_cli.hybrid import HybridSystem
    from cdobs_cli.report.model import Report
    from cdobs_cli.run import Run
    from cdobs_cli.spec.model import Spec

T = TypeVar("T")
ARCHIVE = "archive"  # the entry of `digests` for the trajectories beside a summary
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
        work.design = replace(design, digests=work.store.write("design.json", design.document())["digests"])
        work.redone.add("synthesize")
    return work.design


def _is_current(work: Work, stored: Design) -> bool:
    """Whether a stored design was made of this spec, holds what the spec gives, and is for the sampling law that
    the spec asks for (under max_period: that law at the same period or a longer one)."""
    if stored.family != work.spec.observer.name or not _comes_from(stored.digests, {"key": work.design_key}):
        return False
    if not _holds_what_is_given(work, stored) or not _makes_an_observer(work, stored):
        return False
    asked, law = work.spec.plant.sampling, stored.sampling
    if law == asked:
        return True
    longer = (law.T_max - asked.T_max).sign() == 1 and law == asked.with_period(law.T_max)
    return longer and getattr(work.spec.observer, "objective", None) == "max_period"


def _comes_from(digests: Mapping[str, str], expected: Mapping[str, str]) -> bool:
    """Whether an artefact names what it was made of: all that is expected and, besides its own content, no more."""
    return {**digests, CONTENT: ""} == {**expected, CONTENT: ""}


def _holds_what_is_given(work: Work, stored: Design) -> bool:
    """Whether the gains, the feedback and the options that the spec types are those of the design, and the slopes
    those that it leaves to be found."""
    given, auto = work.spec.observer.given(), work.spec.plant.slopes.auto
    if stored.outcome == "none":
        return all(letter in given and given[letter] in (None, matrix) for letter, matrix in stored.gain.items())
    typed = getattr(work.spec.observer, "gain", None) is not None
    if (stored.outcome == "given") != typed or stored.slopes.keys() != {f"{i + 1}.{j + 1}" for i, j in auto}:
        return False
    if not _is_confined_as_typed(work, stored):
        return False
    return given.keys() == stored.gain.keys() and all(
        given[letter] in (None, matrix) for letter, matrix in stored.gain.items()
    )


def _is_confined_as_typed(work: Work, stored: Design) -> bool:
    """Whether the estimate is kept where the slopes hold in a way that the family has and `saturate` leaves (that it
    is kept is proved by `check`)."""
    way, saturate = stored.estimate.way, getattr(work.spec.observer, "saturate", False)
    if way == "cut":
        return work.spec.observer.confine(work.spec.plant, replace(stored, certificates=()), None).way == "cut"
    return not (way == "continuation" and saturate is False) and not (way == "margin" and saturate is True)


def _makes_an_observer(work: Work, stored: Design) -> bool:
    """Whether gains and details are of the shapes that the family's equations take."""
    if stored.outcome == "none":
        return True
    try:
        _system(work, stored)
    except Exception:  # whatever a matrix of another shape, or a text that is no number, comes to
        return False
    return True


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
    return {
        name: Exact(upper_text(bound * _SPARE, 3)) for name, bound in zip(work.spec.plant.states, bounds, strict=True)
    }


def check(work: Work) -> Check:
    """Re-prove the stored design (or synthesize first), prove the slopes, search counterexamples."""
    if work.check is None:
        design = synthesize(work)
        stored = None if "check" in work.forced else work.store.check()
        if stored is None or not _comes_from(stored.digests, _check_digests(work, design)):
            made, design = _of_design(work, design, _certify)
            made = replace(made, digests=_check_digests(work, design))
            stored = replace(made, digests=work.store.write("check.json", made.document())["digests"])
            work.redone.add("check")
        work.check = stored
    return work.check


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
    from cdobs_cli.bounds.estimate import confinement_claim
    from cdobs_cli.bounds.slopes import resolve, slope_claims, unbounded_claims
    from cdobs_cli.certify.conditions import proved_of_the_plant, with_conditions

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
    judged = Check(claims, made.bounds)
    return replace(judged, bounds=proved_of_the_plant(judged, design.sampling, design.estimate))


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
    if archive is None or hashlib.sha256(archive).hexdigest() != named:
        raise _damaged(work, "simulation.npz")
    from cdobs_cli.simulate.agreement import agrees
    from cdobs_cli.simulate.archive import from_bytes

    run = from_bytes(archive, document)
    if not agrees(run, _system(work, design)):
        raise _damaged(work, "simulation.json")
    work.run = run
    return document


def _damaged(work: Work, name: str) -> ArtefactError:
    told = "was edited or damaged: it is not what was written there" if work.store.has(name) else "is missing"
    return ArtefactError(f"{work.store.folder / name} {told}; `cdobs run` makes it anew")


def _new_run(work: Work, design: Design) -> Run:
    from cdobs_cli.simulate.engine import simulate as engine

    assert work.spec.simulation is not None
    return engine(_system(work, design), work.spec.simulation, design.sampling)


def _system(work: Work, design: Design) -> HybridSystem:
    from cdobs_cli.hybrid import HybridSystem

    plant = work.plant(design)
    return HybridSystem(plant, work.spec.observer.observer_as_run(plant, design), design.estimate.way == "open")


def _write_run(work: Work, design: Design, run: Run) -> dict[str, Any]:
    from cdobs_cli.report.files import figures_of_run
    from cdobs_cli.simulate.archive import to_bytes

    # The archive first: simulation.json, which names its digest, is what makes a run count as there.
    archive, spec = to_bytes(run), work.spec
    work.store.write_files({"simulation.npz": archive})
    work.store.write_files(
        figures_of_run(work.plant(design), spec.observer, design, _stored_check(work, design), run, spec.coordinates)
    )
    run = replace(run, digests={**_simulation_digests(work, design), ARCHIVE: hashlib.sha256(archive).hexdigest()})
    work.redone.add("simulate")
    return work.store.write("simulation.json", run.document())


def _stored_check(work: Work, design: Design) -> Check | None:
    """The check made or stored, where it is of this design."""
    made = work.check or work.store.check()
    return made if made is not None and _comes_from(made.digests, _check_digests(work, design)) else None


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
        made_run = replay_box(
            HybridSystem(plant, work.spec.observer.observer(plant, design)), design.sampling, claim.witness
        )
        chart = crossing_chart(name, identifier, plant.states, made_run.arrays())
    else:
        made_run = run_witness(work.spec.observer.inclusion(plant, design.gain), claim.witness)
        chart = replay_chart(name, identifier, made_run.arrays(), made_run.entries)
    archive = made_run.to_bytes()
    work.store.write_files({f"{name}.npz": archive, **replay_figures(chart)})
    digests = {
        **_check_digests(work, design),
        "check": made.digests[CONTENT],
        ARCHIVE: hashlib.sha256(archive).hexdigest(),
    }
    document = {"schema_version": 1, "claim": identifier, **made_run.document(), "digests": digests}
    work.simulation = work.store.write(f"{name}.json", document)
    return work.simulation


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
    design = work.design or work.store.design()
    if design is None or not (design is work.design or _is_current(work, design)):
        raise _unusable(work, "design.json", "for this spec", is_whole=design is not None)
    made = _stored_check(work, design)
    if made is None:
        raise _unusable(work, "check.json", "for this design", is_whole=work.store.check() is not None)
    work.design, work.check = design, made
    if work.simulation is None and work.spec.simulation is not None and design.outcome != "none":
        work.simulation = _stored_simulation(work, design)
    return _render(work)


def _unusable(work: Work, name: str, what_for: str, *, is_whole: bool) -> ArtefactError:
    """Why a stored artefact is not shown: none is there, it is of something else, or it is not what was written."""
    if work.store.has(name) and not is_whole:
        return _damaged(work, name)
    return ArtefactError(f"{work.store.folder}: no current {name} {what_for}; run `cdobs check` first")


def report_model(work: Work, digests: Mapping[str, str]) -> Report:
    """What there is to say of the artefacts made or read so far (a design at least)."""
    from cdobs_cli.findings import at_hand
    from cdobs_cli.report.model import build_report

    assert work.design is not None
    told = [(str(outcome.expectation), outcome.holds, outcome.text) for outcome in at_hand(work.spec, documents(work))]
    return build_report(
        name=readable(work.store.folder.name), title=readable(work.spec.title), spec_path=readable(str(work.spec.source_path)),
        plant=work.plant(work.design), family=work.spec.observer, design=work.design, check=work.check, run=work.run,
        expectations=told, digests=digests, typed=work.spec.typed, coordinates=work.spec.coordinates,
    )  # fmt: skip


def _render(work: Work) -> list[Path]:
    digests = {name: document["digests"][CONTENT] for name, document in documents(work).items() if document is not None}
    # What the page shows and is not in an artefact.
    shown = {
        **digests,
        "spec": work.spec.normalised(),
        "title": work.spec.title,
        "path": str(work.spec.source_path),
        "cdobs": __version__,
    }
    marker, pages = ".report.sha256", ("report.md", "report.html")

    def content() -> bytes:
        found = {name: hashlib.sha256(work.store.read_bytes(name) or b"").hexdigest() for name in pages}
        return f"{digest({**shown, 'pages': found})}\n".encode()

    are_there = all((work.store.folder / name).is_file() for name in (marker, *pages))
    if "report" not in work.forced and are_there and work.store.read_bytes(marker) == content():
        return []
    from cdobs_cli.report.files import render

    paths = work.store.write_files(render(report_model(work, digests)))
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
