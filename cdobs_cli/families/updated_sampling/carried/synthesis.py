"""The law that a design runs by: typed, or found for the least error, the least measurements, or the longest T_min."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Any

from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.updated_sampling.carried.law import LAW, MATRICES, NUMBERS, Law
from cdobs_cli.families.updated_sampling.carried.proof import floor
from cdobs_cli.families.updated_sampling.carried.search import (
    Candidate,
    Target,
    least_error,
    longest,
    rounded,
)
from cdobs_cli.families.updated_sampling.carried.slopes import largest_slopes
from cdobs_cli.families.updated_sampling.lipschitz import rate_of
from cdobs_cli.plant import Entry, Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

THETA = "1/4"
SLOWEST, STEADY = "0.1", "1"  # idle where time between samples is all that counts, and where an error is asked for
LONGEST_SHARE = 0.9  # of the longest T_min: at the longest itself Pi has no floor
_ROOM = (1.0, 0.98, 0.9)  # of F, for what rounding takes
_UNBOUNDED = "c(x_hat, u) = {} has no bound over the domain, so Pi has no floor; declare a domain"
_NOTHING = "no law with a floor of Pi was found at T_min = {}: a shorter one, or smaller slopes, may help"
_NEVER = "no law with a floor of Pi was found for any T_min: is the state seen by the outputs, whatever the slopes?"
_UNFIT = "the typed law does not fit the slopes that the estimate can meet: split has a positive entry for each of them"
_UNPROVED = "a law was found in floating point, but its floor could not be proved for rounded numbers"


def synthesize(family: UpdatedSampling, plant: Plant, effort: int) -> Design:
    """A law with a floor that is proved already, or the typed law as it is."""
    rate = rate_of(family, plant)
    largest = largest_slopes(plant, rate)
    details = {"rate": rate.document()}
    law, reason = None, _UNBOUNDED.format(rate.c)
    if largest is not None:
        typed = typed_law(family, plant)
        law, reason = _found(family, plant, largest, effort) if typed is None else (typed, _UNFIT)
    if law is None or largest is None or not law.fits(plant.n, plant.p, tuple(largest)):
        return Design(family.name, "none", plant.sampling, {}, reason=reason, details=details)
    outcome: Outcome = "given" if is_whole(family) else "found"
    return Design(family.name, outcome, plant.sampling, {}, details={**details, LAW: law.document()})


def stored_law(family: UpdatedSampling, design: Design) -> Law:
    """The law of a stored design; what is typed of it is that of the spec.

    Raises: KeyError, TypeError, ValueError, ExpressionError where there is none, or another one.
    """
    law = Law.read(design.details[LAW])
    for name, value in typed_parts(family).items():
        if getattr(law, name) != value:
            raise ValueError(f"its {name} is not that of the spec")
    return law


def typed_parts(family: UpdatedSampling) -> dict[str, Any]:
    """What the spec says of the law itself, by the law's names."""
    block = family.law
    parts: dict[str, Any] = {}
    if block is not None:
        parts = {name: one for name in (*MATRICES, *NUMBERS) if (one := getattr(block, name)) is not None}
    if family.budget is not None:
        parts["T_min"] = per_budget(family.budget)
    return {**parts, "kappa": family.rule.kappa if family.rule else None, "reset": family.reset}


def per_budget(budget: Exact) -> Exact:
    """1 / budget, rounded up: never more measurements per time than that."""
    rational = budget.rational
    if rational is None:
        return Exact(decimal_text(Fraction(1 / float(budget)) * (1 + Fraction(1, 10**9)), 12))
    return Exact(1 / rational)


def is_whole(family: UpdatedSampling) -> bool:
    """Whether the spec types the law itself: F, split, sigma and T_min."""
    return set(typed_parts(family)) >= {"F", "split", "sigma", "T_min"}


def typed_law(family: UpdatedSampling, plant: Plant) -> Law | None:
    """The whole law where F and split are typed; what is left out of the rest has its default."""
    parts = typed_parts(family)
    if not is_whole(family):
        return None
    own = {"Lambda": ExactMatrix([["1"] * plant.p]), "gamma": ExactMatrix([["0"] * plant.n])}
    return Law(**{**own, **defaults(plant.n, idle=SLOWEST), **parts})


def _found(
    family: UpdatedSampling, plant: Plant, largest: Mapping[Entry, Fraction], effort: int
) -> tuple[Law | None, str]:
    """The law that the objective asks for, or why there is none."""
    parts = typed_parts(family)
    own = {name: parts.get(name, one) for name, one in defaults(plant.n, idle=_idle(family)).items()}
    pinned = {name: parts.get(name) for name in ("Lambda", "split", "sigma")}
    pinned["share"] = family.law.share if family.law else None
    target = Target.of(plant, largest, own["idle"], own["epsilon"], **pinned)
    typed = parts.get("T_min")
    if typed is not None:
        made, nothing = least_error(target, float(typed), effort), _NOTHING.format(typed)
    else:
        made, nothing = _longest(family, target, plant, effort), _NEVER
    if made is None:
        return None, nothing
    T = typed or Exact(decimal_text(made.T, 4))
    own |= {"T_min": T, "kappa": parts["kappa"], "reset": parts["reset"]}
    for share in _ROOM:
        law = replace(rounded(made, target, share), **own, **_matrices(parts))
        if floor(plant, law, largest).holds:
            return law, ""
    return None, _UNPROVED


def defaults(n: int, *, idle: str) -> dict[str, Exact]:
    """theta, epsilon and idle. det(Pi - F) is a product of n numbers that are small beside F near T_min."""
    return {"theta": Exact(THETA), "epsilon": Exact(Fraction(1, 10 ** (3 + 3 * n))), "idle": Exact(idle)}


def _idle(family: UpdatedSampling) -> str:
    return SLOWEST if family.objective == "max_period" and family.error_at_most is None else STEADY


def _matrices(parts: Mapping[str, Any]) -> dict[str, Any]:
    return {name: parts[name] for name in MATRICES if name in parts}


def _longest(family: UpdatedSampling, target: Target, plant: Plant, effort: int) -> Candidate | None:
    """Of the longest T_min the law with the least error: the longest with errors that are small enough, or nine tenths
    of the longest with any floor at all."""
    wanted = [family.error_at_most.get(state) for state in plant.states] if family.error_at_most else []
    limits = [inf if one is None else float(one) for one in wanted]

    def within(T: float) -> bool:
        made = least_error(target, T, effort)
        return made is not None and all(error <= limit for error, limit in zip(made.errors, limits, strict=False))

    T = longest(within, *target.times)
    if T is None:
        return None
    share = LONGEST_SHARE if not limits else 1.0
    return least_error(target, float(decimal_text(share * T, 3)), effort)
