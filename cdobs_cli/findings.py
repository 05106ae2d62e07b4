"""From artefacts to findings: what `expect` decides, and what is a finding without it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cdobs_cli.errors import Problem
from cdobs_cli.outcome import Message
from cdobs_cli.run import Departure
from cdobs_cli.spec.expect import Outcome, evaluate

if TYPE_CHECKING:
    from cdobs_cli.spec.model import Spec
    from cdobs_cli.spec.reader import FieldPath

Documents = dict[str, dict[str, Any] | None]
STAGE_OF = {"design": "synthesize", "check": "check", "simulation": "simulate"}
REPLAY = "replay"
_PLACES = {"aperiodic": "max_period", "updated": "updated"}  # of a law's numbers; of others it is `period`


def decided(spec: Spec, documents: Documents, stages: frozenset[str]) -> list[Outcome]:
    """Every `expect` entry about what the stages made; a stage that reads a design makes it where there is none."""
    return [evaluate(one, documents) for one in spec.expect if _made(one.artefact, documents, stages)]


def at_hand(spec: Spec, documents: Documents) -> list[Outcome]:
    """Every `expect` entry but those about an artefact that is still to be made."""
    runs = spec.simulation is not None and (documents["design"] or {}).get("outcome") != "none"
    missing = {"check": documents["check"] is None, "simulation": documents["simulation"] is None and runs}
    return [evaluate(one, documents) for one in spec.expect if not missing.get(one.artefact, False)]


def _made(artefact: str, documents: Documents, stages: frozenset[str]) -> bool:
    if REPLAY in stages:
        return False  # asked of one counterexample only
    return STAGE_OF[artefact] in stages or (artefact == "design" and bool(stages) and documents["design"] is not None)


def find(spec: Spec, documents: Documents, stages: frozenset[str]) -> list[Message]:
    """All findings of the stages that ran, each at its place in the spec, and what was left out."""
    failed = [outcome for outcome in decided(spec, documents, stages) if not outcome.holds]
    messages = [_message(spec, outcome.text, outcome.expectation.field, "expect") for outcome in failed]
    named = {expectation.quantity.removeprefix("check.") for expectation in spec.expect}
    if "check" in stages and "verdict" not in named:
        messages += _unproved(spec, documents["check"])
    if stages == {"synthesize"}:
        messages += _without_design(spec, documents["design"], named)
    if "simulate" in stages:
        messages += _of_simulation(spec, documents["simulation"], named)
        messages += _stiff(spec, documents["simulation"])
        messages += _beyond_bounds(spec, documents["simulation"], documents["check"], named)
    return [*messages, *_cut(spec, documents["design"]), *_left_out(spec, documents, stages)]


def _cut(spec: Spec, design: dict[str, Any] | None) -> Iterator[Message]:
    """A remark on a design whose searches had no more time."""
    if design is not None and design.get("cut"):
        text = "the design is the best that was found within --time-limit; without it, it is looked for again"
        yield replace(_message(spec, text, ("observer",), "time-limit"), severity="warning")


def remarks(spec: Spec) -> list[Message]:
    """What reading a spec tells that is no mistake."""
    from cdobs_cli.spec.seen import unseen_warning

    told = unseen_warning(spec.plant)
    if told is None:
        return []
    field = ("plant", "output") if spec.typed is not None else ("measurement", "C")
    return [replace(_message(spec, told, field, "output"), severity="warning")]


def _left_out(spec: Spec, documents: Documents, stages: frozenset[str]) -> Iterator[Message]:
    """One remark for each stage that `expect` is about and that was not run."""
    for artefact, stage in STAGE_OF.items():
        entries = [one for one in spec.expect if one.artefact == artefact and not _made(artefact, documents, stages)]
        if entries:
            count = "1 expect entry" if len(entries) == 1 else f"{len(entries)} expect entries"
            verb = "was" if len(entries) == 1 else "were"
            text = f"{count} about {stage} {verb} left out: {stage} was not run"
            yield replace(_message(spec, text, entries[0].field, "expect"), severity="note")


def _message(spec: Spec, text: str, field: FieldPath, rule: str) -> Message:
    file, line, column = spec.location(field)
    return Message("error", text, file, line, column, Problem(field, "").path, rule)


def _unproved(spec: Spec, check: dict[str, Any] | None) -> Iterator[Message]:
    """One message for each required claim that is not proved, at the line that it is about."""
    for claim in (check or {"claims": ()})["claims"]:
        if claim["required"] and claim["status"] != "proved":
            text = f"{claim['id']} {claim['status']}: {spec.labels.sentence(claim['statement'])}"
            yield _message(spec, text, _place(spec, claim["id"]), claim["id"])


def _place(spec: Spec, claim: str) -> FieldPath:
    if claim.startswith("slopes."):
        return ("plant", *_place_of_slope(claim.split(".")[1:]))
    if claim == "defined":
        return ("plant", "dynamics" if spec.typed else "phi")
    if getattr(spec.observer, "gain", None) is not None:
        return ("observer", "gain")
    if spec.plant.sampling.has_sensors or spec.plant.sampling.is_on_change:
        return ("measurement", "sensors")
    return ("measurement", "sampling", _PLACES.get(spec.plant.sampling.kind, "period"))


def _place_of_slope(parts: list[str]) -> FieldPath:
    """Where `2.1`, `output.1.2` or `rho1` was typed, within the plant."""
    match parts:
        case ["output", k, _]:
            return ("output", int(k) - 1)
        case [i, j]:
            return ("lipschitz", int(i) - 1, int(j) - 1)
    return ("lipschitz",)


def _without_design(spec: Spec, design: dict[str, Any] | None, named: set[str]) -> Iterator[Message]:
    if design is not None and design["outcome"] == "none" and "design.outcome" not in named:
        yield _message(spec, f"no design found: {spec.labels.sentence(str(design['reason']))}", ("observer",), "design")


def _of_simulation(spec: Spec, simulation: dict[str, Any] | None, named: set[str]) -> Iterator[Message]:
    """Divergence, a lost inclusion and leaving the domain, unless an entry of `expect` names them."""
    if simulation is None:
        return
    overall = simulation["overall"]
    margin, stopped = overall["inclusion_margin"], overall["stopped"]
    flags = {
        "diverged": (overall["diverged"], f"the error diverges: {stopped or 'it exceeds 1e6 (1 + |e(0)|)'}"),
        "left_domain": (overall["left_domain"], departure_text(spec, simulation)),
        "inclusion_margin": (margin is not None and margin < 0, f"the state leaves its bounds by {_size(margin)}"),
        "stopped": (stopped is not None and not overall["diverged"], f"the run stops early: {stopped}"),
    }
    for quantity, (is_set, text) in flags.items():
        if is_set and not any(name.startswith("simulation.") and name.endswith(f".{quantity}") for name in named):
            yield _message(spec, text, ("simulation",), f"simulation.{quantity}")


def _stiff(spec: Spec, simulation: dict[str, Any] | None) -> Iterator[Message]:
    """A remark on runs that were not integrated with the usual method."""
    if simulation is not None and simulation.get("implicit"):
        from cdobs_cli.report.numbers import implicit_sentence

        text = implicit_sentence(simulation["implicit"], len(simulation["runs"]))
        yield replace(_message(spec, text, ("simulation",), "simulation.implicit"), severity="note")


def _beyond_bounds(
    spec: Spec, simulation: dict[str, Any] | None, check: dict[str, Any] | None, named: set[str]
) -> Iterator[Message]:
    """A run whose error passes what is proved for all time from its own initial errors."""
    if simulation is None or check is None or any(name.endswith(".error_max") for name in named):
        return
    if simulation["overall"]["left_domain"]:  # nothing is claimed of such a run
        return
    for state, most in simulation["overall"]["error_max"].items():
        bound = check["bounds"].get(f"error_transient.{state}")
        if bound is not None and bound["proved"] not in (None, "inf") and most > float(bound["proved"]) * (1 + 1e-9):
            text = f"the error of {state} comes to {_size(-most)}, above the {bound['proved']} that is proved"
            yield _message(spec, text, ("simulation",), "simulation.error_max")


def departure_text(spec: Spec, simulation: dict[str, Any]) -> str:
    """Which state leaves the domain, when, at which value, and by how much in all; of several runs the earliest."""
    overall, runs = simulation["overall"], simulation["runs"]
    if overall["departure"] is None:
        return ""
    from cdobs_cli.report.numbers import departure_sentence

    told = departure_sentence(Departure.from_document(overall["departure"]), spec.labels)
    left = [number for number, one in enumerate(runs, start=1) if one["left_domain"]]
    if len(runs) == 1:
        return told
    first = next(number for number in left if runs[number - 1]["departure"] == overall["departure"])
    return f"{told} (run {first}; {len(left)} of {len(runs)} runs leave it)"


def _size(margin: float | None) -> str:
    if margin is None or margin >= 0:
        return "nothing"
    from cdobs_cli.report.numbers import number_text

    return number_text(-margin, 3)
