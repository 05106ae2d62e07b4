"""From artefacts to findings: what `expect` decides, and what is a finding without it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cdobs_cli.outcome import Message
from cdobs_cli.spec.expect import Outcome, evaluate

if TYPE_CHECKING:
    from cdobs_cli.pipeline import Work

Documents = dict[str, dict[str, Any] | None]
# Where a claim's verdict is decided in the spec: annotations point there.
_PLACES = {"gain": ("observer", "gain"), "sampling": ("measurement", "sampling"), "family": ("observer", "family")}


def expectations(work: Work, documents: Documents, stages: frozenset[str]) -> list[Outcome]:
    """Every `expect` entry whose artefact belongs to one of `stages`, decided."""
    artefact_of = {"synthesize": "design", "check": "check", "simulate": "simulation"}
    wanted = {artefact_of[stage] for stage in stages if stage in artefact_of}
    return [evaluate(entry, documents) for entry in work.spec.expect if entry.artefact in wanted]


def find(work: Work, documents: Documents, stages: frozenset[str]) -> list[Message]:
    """All findings of the stages that ran, each at its place in the spec."""
    messages = []
    decided = expectations(work, documents, stages)
    named = {outcome.expectation.quantity for outcome in decided}
    for outcome in decided:
        if not outcome.holds:
            messages.append(_message(work, outcome.text, outcome.expectation.field, "expect"))
    if "synthesize" in stages:
        messages += _of_design(work, documents["design"], named)
    if "check" in stages:
        messages += _of_check(work, documents["check"], named)
    if "simulate" in stages:
        messages += _of_simulation(work, documents["simulation"], named)
    return messages


def _message(work: Work, text: str, field: tuple[str | int, ...], rule: str) -> Message:
    from cdobs_cli.errors import Problem

    file, line, column = work.spec.location(field)
    return Message("error", text, file, line, column, Problem(field, "").path, rule)


def _gain_or_family(work: Work) -> tuple[str | int, ...]:
    return _PLACES["gain"] if getattr(work.spec.observer, "gain", None) is not None else _PLACES["family"]


def _of_design(work: Work, design: dict[str, Any] | None, named: set[str]) -> list[Message]:
    if design is None or design["outcome"] != "none" or "design.outcome" in named or "verdict" in named:
        return []
    return [_message(work, f"no design found: {design['reason']}", _PLACES["family"], "design")]


def _of_check(work: Work, check: dict[str, Any] | None, named: set[str]) -> list[Message]:
    if check is None or check["verdict"] == "proved" or "verdict" in named:
        return []
    messages = []
    for claim in check["claims"]:
        if claim["required"] and claim["status"] != "proved":
            field = _gain_or_family(work)
            if claim["id"].startswith("slopes."):
                i, j = (int(part) - 1 for part in claim["id"].split(".")[1:3])
                field = ("plant", "lipschitz", i, j)
            messages.append(_message(work, f"{claim['id']} {claim['status']}: {claim['statement']}", field, claim["id"]))
    return messages


def _of_simulation(work: Work, simulation: dict[str, Any] | None, named: set[str]) -> list[Message]:
    if simulation is None:
        return []
    overall, messages = simulation["overall"], []
    margin = overall["inclusion_margin"]
    told = {
        "diverged": (overall["diverged"], f"the error diverges: {overall['stopped'] or 'above 1e6 (1 + |e(0)|)'}"),
        "left_domain": (overall["left_domain"], "a state or its estimate leaves the domain where the slopes are claimed"),
        "inclusion_margin": (margin is not None and margin < 0, f"the state leaves its bounds, by {margin}"),
        "stopped": (overall["stopped"] is not None and not overall["diverged"], f"the run stops: {overall['stopped']}"),
    }
    for quantity, (found, text) in told.items():
        if found and not any(name.startswith("simulation.") and name.endswith(f".{quantity}") for name in named):
            messages.append(_message(work, text, ("simulation",), f"simulation.{quantity}"))
    return messages
