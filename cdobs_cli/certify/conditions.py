"""Under what a convergence is claimed: what is said of it, and when it must be lowered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from cdobs_cli.certificate import CONVERGENCE, ERROR_BOUNDED, UNDER_NOISE, Bound, Check, Claim
from cdobs_cli.design import Confinement
from cdobs_cli.exact.numbers import Exact, text_below
from cdobs_cli.plant import Domain, Plant
from cdobs_cli.sampling import SamplingLaw

_PERIODS = ("period_max", "period_max_any_gain", "period_max_at_rate")
_ERRORS = ("error", "error_transient", "rms")
_CONSEQUENCES = ("decay_rate", "guaranteed_period", *_ERRORS)


def with_conditions(
    claims: Sequence[Claim],
    plant: Plant,
    confinement: Confinement,
    domain: Domain,
    *,
    disturbed: bool,
    reason: str | None = None,
) -> tuple[Claim, ...]:
    """The claims with all conditions of `convergence` in its own sentence.

    Where the estimate is not shown to stay where the slopes hold, a proof of convergence is none: undecided.

    Args:
        domain: in the states that the user typed.
        reason: why the design falls short of what was asked.
        disturbed: whether the family's convergence speaks of the declared disturbance and noise themselves.
    """
    by_id = {claim.id: claim for claim in claims}
    stays, estimate = by_id.get("domain_invariant"), by_id.get("estimate")
    told = []
    for claim in claims:
        if claim.id == ERROR_BOUNDED:
            told.append(_bounded(claim, domain, confinement, by_id))
            continue
        if claim.id != CONVERGENCE:
            told.append(claim)
            continue
        conditions = []
        if not disturbed and plant.is_perturbed:
            conditions.append(f"without {_unknown(plant)}")
        conditions += _while_inside(domain, confinement, stays)
        if confinement.way == "margin":
            conditions.append(f"for initial errors {confinement.start_text}")
        statement = ", ".join([claim.statement.rstrip("."), *conditions])
        if claim.status == "proved" and estimate is not None and estimate.status != "proved":
            claim = replace(claim, status="undecided", margin=None, by=None)
            statement = f"{statement}: {estimate.statement}"
        elif claim.status == "undecided" and reason is not None:
            statement = f"{statement}: {reason}"
        if claim.status == "refuted":
            claim, statement = _refuted(claim, plant, statement)
        if not disturbed and plant.is_perturbed and ERROR_BOUNDED not in by_id and claim.status == "proved":
            statement += f"; no bound of the error under the declared {_unknown(plant)} is proved"
        told.append(replace(claim, statement=f"{statement}."))
    return tuple(told)


def _while_inside(domain: Domain, confinement: Confinement, stays: Claim | None) -> list[str]:
    if not domain or confinement.way == "everywhere" or (stays is not None and stays.status == "proved"):
        return []
    return [f"while the plant stays in {domain.text}"]


def _bounded(claim: Claim, domain: Domain, confinement: Confinement, by_id: Mapping[str, Claim]) -> Claim:
    """`error_bounded` with its conditions; a margin that is shown without disturbance and noise alone does not hold
    it."""
    conditions = _while_inside(domain, confinement, by_id.get("domain_invariant"))
    if confinement.way == "margin":
        conditions.append(f"for initial errors {confinement.start_text}")
    statement = ", ".join([claim.statement.rstrip("."), *conditions])
    estimate = by_id.get(UNDER_NOISE, by_id.get("estimate"))
    if claim.status == "proved" and estimate is not None and estimate.status != "proved":
        claim, statement = replace(claim, status="undecided", by=None), f"{statement}: {estimate.statement}"
    return replace(claim, statement=f"{statement.rstrip('.')}.")


def proved_of_the_plant(check: Check, law: SamplingLaw, confinement: Confinement) -> dict[str, Bound]:
    """The bounds that are proved of this plant and observer, not only of the slope class.

    A required premise that is not proved, or an estimate that may leave the slopes, leaves no period and no rate
    proved; a margin holds for the law that it was shown for, so that periods beyond it are not proved.
    """
    premises = [
        claim for claim in check.claims if claim.kind == "premise" and (claim.required or claim.id == "estimate")
    ]
    stands = all(claim.status == "proved" for claim in premises)
    under_noise = check.claim(UNDER_NOISE)
    stays_under_noise = under_noise is None or under_noise.status == "proved"
    kept = {}
    for name, bound in check.bounds.items():
        head, _, method = name.partition(".")
        if (head in _ERRORS and not stays_under_noise) or (not stands and head in (*_PERIODS, *_CONSEQUENCES)):
            bound = replace(bound, proved=None)
        elif confinement.way == "margin" and head in _PERIODS and bound.proved is not None:
            bound = replace(bound, proved=None if method else _at_most(bound.proved, law))
        if bound.proved is not None or bound.refuted is not None:
            kept[name] = bound
    return kept


def _at_most(proved: str, law: SamplingLaw) -> str:
    """The proved end, not beyond the law's own period."""
    return proved if proved != "inf" and Exact(proved).is_at_most(law.period) else text_below(law.period)


def _unknown(plant: Plant) -> str:
    names = ("disturbance",) if plant.is_disturbed else ()
    return " and ".join((*names, "noise") if plant.is_noisy else names)


def _refuted(claim: Claim, plant: Plant, statement: str) -> tuple[Claim, str]:
    """What the counterexample is about: a class of one member is the plant itself."""
    witness = claim.witness
    if witness is None:
        return claim, statement
    alone = not plant.slopes.uncertain and not plant.output_quantities
    if alone or witness.about == "plant":
        return replace(claim, witness=replace(witness, about="plant")), f"{statement}: refuted for the plant as typed"
    return (
        claim,
        f"{statement}: refuted for the class, some plant with these slopes defeats it; the plant as typed may "
        f"still converge",
    )
