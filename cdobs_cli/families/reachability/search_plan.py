"""Which gains and certificates are looked for: the set M and LMI (13), the clock-dependent function, which needs no
structure, and for planar plants the exact bound; `best` asks all and keeps the better answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.gains import Candidate, GainSearch
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
from cdobs_cli.certify.methods.clock.graph_design import GraphGain
from cdobs_cli.certify.methods.dead_beat import DeadBeat
from cdobs_cli.certify.methods.on_change.design import OnChangeGain, OnChangeRung
from cdobs_cli.certify.methods.planar import design as planar
from cdobs_cli.certify.methods.planar.extremals import Planar
from cdobs_cli.certify.methods.rung import GENERAL, One, Rung
from cdobs_cli.families.reachability.certificate import ReachableSet
from cdobs_cli.families.reachability.continuous import reference
from cdobs_cli.families.reachability.on_change import why_none
from cdobs_cli.families.reachability.set_design import SetGain, longest_any
from cdobs_cli.families.reachability.sets import box_holds
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

# Up to this many states the largest period of the set, over all gains, is looked for whatever the objective.
SMALL = 3

_FROM_ZERO = (
    "periods from 0 on: where the direction that an output measures changes with its slopes, no quadratic function "
    "falls at samples that follow at once; give min_period"
)


def by_set(family: Reachability, question: Question) -> bool:
    return family.method in ("best", "set") and question.law.is_periodic and not question.inclusion.outputs


def by_planar(family: Reachability, question: Question) -> bool:
    linear = not question.inclusion.outputs
    return linear and family.method == "best" and planar.open_class(question) is not None


def by_clock(family: Reachability, question: Question) -> bool:
    """Where the exact limit is known no other certificate reaches further, and none is looked for."""
    if family.method == "set":
        return False
    if question.inclusion.outputs:
        return True
    given = family.given()["K"]
    exact = family.method == "best" and family.objective != "decay_rate" and not question.rate
    return not (exact and planar.covers(question, given))


def rungs(family: Reachability, question: Question) -> Sequence[Rung]:
    """The lines of the ladder."""
    if question.law.is_on_change:
        return [OnChangeRung()]
    asked: list[tuple[bool, Rung]] = [
        (True, One(DeadBeat)), (by_set(family, question), One(ReachableSet)), (by_clock(family, question), GENERAL),
        (by_planar(family, question), One(Planar)),
    ]  # fmt: skip
    return [rung for wanted, rung in asked if wanted]


def gain_searches(family: Reachability, question: Question) -> Sequence[GainSearch]:
    """The set first; where n = rank C a sample tells the state, and no other gain is needed. Of sensors with periods of
    their own, or that send on change, one way alone."""
    if question.law.is_on_change:
        return [OnChangeGain()]
    if question.law.has_sensors:
        return [GraphGain()]
    weighed = family.objective in ("given_period", "min_error") or family.error_at_most
    quiet = bool(weighed) and family.method != "set"
    if kernel(question.plant.C).dimension == 0 and ResetGain().at(question) is not None:
        return [ResetGain(), ImpulsiveGain()] if quiet else [ResetGain()]
    asked: list[tuple[bool, GainSearch]] = [
        (by_set(family, question), SetGain()), (by_clock(family, question) or quiet, ImpulsiveGain()),
        (by_planar(family, question) and not question.rate, PlanarGain()),
    ]  # fmt: skip
    return [search for wanted, search in asked if wanted]


class ResetGain(GainSearch):
    """K with K C = I, where that ends as decimals: no error survives the first sample, under any law."""

    def at(self, question: Question) -> Candidate | None:
        K = kernel(question.plant.C).gain(None, 15)
        certificate = DeadBeat.propose(question.with_gain({"K": K}))
        return None if certificate is None else Candidate(K, question.law, inf, certificate)

    longest = fastest = at


class PlanarGain(GainSearch):
    """The gain in the middle of those that no extremal defeats."""

    def at(self, question: Question) -> Candidate | None:
        return Candidate.of(planar.gain_at(question), 0.0)

    def longest(self, question: Question) -> Candidate | None:
        return Candidate.of(planar.longest_any(question))


def why_nothing(family: Reachability, question: Question) -> str:
    """Why no gain was found."""
    if question.law.is_on_change:
        return why_none(question.plant)
    T = question.law.period
    if by_set(family, question) and not by_clock(family, question) and not box_holds(question.plant, T.ball()):
        return f"the set is known up to delta_star only, and delta = {T} is beyond it; method clock has no such limit"
    asked = {
        "best": "neither the set nor the clock-dependent certificate gave a gain",
        "set": "the set gave no gain",
        "clock": "the clock-dependent certificate gave no gain",
    }
    more = "more effort, a shorter period or smaller slopes may"
    if question.law.from_zero and _turns(question.plant):
        return _FROM_ZERO
    if question.inclusion.outputs:
        more = "more effort, a shorter period, or a smaller domain with smaller slopes of the outputs may"
        return f"{asked['clock']} with a proof at T = {T}; {more} help"
    return f"{asked[family.method]} with a proof at T = {T}; {more} help"


def _turns(plant: Plant) -> bool:
    """Whether the direction that an output measures changes with its slopes."""
    varying = {rho.entry[0] for rho in plant.output_quantities}
    moved = {rho.entry for rho in plant.output_quantities}
    felt = [(k, j) for k in varying for j in range(plant.n) if (k, j) in moved or plant.C[k, j].sign() != 0]
    return len(felt) > len(varying)


def beyond(family: Reachability, question: Question, own: Sequence[Method]) -> list[Certificate]:
    """Theorem II.1 for comparison, and the longest period over all gains, where that is quick."""
    plant = question.plant
    certificates = list(reference(plant))
    quick = plant.n <= SMALL and (is_chain(plant) or not plant.slopes.uncertain)
    sought = family.objective == "max_period" and family.gain is None
    designed = bool(own) or family.gain is not None
    reset = any(isinstance(method, DeadBeat) for method in own)
    if not designed or reset or sought or not quick or not by_set(family, question):
        return certificates
    for met in (longest_any(question), planar.longest_any(question) if by_planar(family, question) else None):
        certificates += [met[1].certificate({"K": met[0]})] if met is not None else []
    return certificates
