"""What only Dinh2014 says of a design: how long the box (31) holds, the inclusion of a typed set, Theorem II.1."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.certificate import Bound, Claim
from cdobs_cli.certify.judge import Judgement
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.families.reachability.certificate import SOURCE, ReachableSet
from cdobs_cli.families.reachability.continuous import reference_claims
from cdobs_cli.families.reachability.escape import inclusion_claim
from cdobs_cli.families.reachability.on_change import why_undecided
from cdobs_cli.families.reachability.sets import box_holds, inclusion_12, reachable_box, set_limit, set_round
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability


def claims_beside(family: Reachability, judgement: Judgement) -> tuple[list[Claim], dict[str, Bound]]:
    """Claims and bounds beyond the certificates'."""
    plant, law, claims = judgement.plant, judgement.law, list[Claim]()
    has_set = any(isinstance(item.method, ReachableSet) for item in judgement.here)
    if law.is_periodic and not has_set and _asks_a_set(family, plant):
        claims += _typed_inclusion(family, plant, law.T_max)
        statement = f"(13) holds over the set at {law.T_max}: no certificate was found."
        claims.append(Claim("set.contraction", "certificate", "undecided", statement, f"{SOURCE}, (13)"))
    claims += undecided_claims(judgement)
    return [*claims, *reference_claims(plant, judgement.design)], _delta_star(family, plant)


def _asks_a_set(family: Reachability, plant: Plant) -> bool:
    return family.method != "clock" and not plant.output_quantities


def _delta_star(family: Reachability, plant: Plant) -> dict[str, Bound]:
    if plant.sampling.is_on_change or not is_chain(plant) or not plant.slopes.uncertain:
        return {}
    if not _asks_a_set(family, plant):
        return {}
    limit = set_limit(plant)
    low = lower_text(limit, 17) if limit.is_finite() else "inf" if limit > 0 else None
    high = upper_text(limit, 17) if limit.is_finite() else None
    return {"delta_star": Bound(low, high, "s", "Dinh2014, Theorem III.2", "how long the box (31) holds")}


def _typed_inclusion(family: Reachability, plant: Plant, delta: Exact) -> list[Claim]:
    """The inclusion of a typed set for which no certificate is stored."""
    if family.set == "clarke":
        return []
    box = reachable_box(plant, delta.ball())
    boxes = set_round(family, box, delta)
    proved = box is not None and boxes is not None and inclusion_12(box, boxes) and box_holds(plant, delta.ball())
    return [inclusion_claim(family, plant, delta, proved)]


def undecided_claims(judgement: Judgement) -> list[Claim]:
    """Where nothing is proved of the gain, why."""
    if not judgement.law.is_on_change or any(item.method.law == judgement.law for item in judgement.here):
        return []
    from cdobs_cli.certify.methods.on_change.certificate import OnChange

    why = why_undecided(judgement.plant, judgement.design.gain["K"])
    statement = f"The error falls, sampling {judgement.law.words}: {why}."
    return [Claim(OnChange.rung, "certificate", "undecided", statement, OnChange.source)]
