"""The law that a design runs by: typed, or found for the least error, the least measurements, or the longest T_min."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Any

from cdobs_cli.design import Design
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
from cdobs_cli.families.updated_sampling.lipschitz import Rate, rate_of
from cdobs_cli.plant import Entry, Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

DEFAULTS = {"theta": "1/4", "epsilon": "1e-9"}
IDLE = {"max_period": "0.1", "min_error": "1"}
LONGEST_SHARE = 0.9  # of the longest T_min: at the longest itself Pi has no floor
_ROOM = (1.0, 0.98, 0.9)  # of F, for what rounding takes
_UNBOUNDED = "c(x_hat, u) = {} has no bound over the domain, so Pi has no floor; declare a domain"
_NOTHING = "no law with a floor of Pi was found at T_min = {}: a shorter one, or smaller slopes, may help"
_NEVER = "no law with a floor of Pi was found for any T_min: is the state seen by the outputs, whatever the slopes?"
_UNPROVED = "a law was found in floating point, but its floor could not be proved for rounded numbers"


def synthesize(family: UpdatedSampling, plant: Plant, effort: int) -> Design:
    """A law with a floor that is proved already, or the typed law as it is."""
    rate = rate_of(family, plant)
    largest = largest_slopes(plant, rate)
    details = {"rate": rate.document()}
    typed = typed_law(family, plant)
    if typed is not None:
        return _design(family, plant, "given", typed, rate)
    if largest is None:
        reason = _UNBOUNDED.format(rate.c)
        return Design(family.name, "none", plant.sampling, {}, reason=reason, details=details)
    law, reason = _found(family, plant, largest, effort)
    if law is None:
        return Design(family.name, "none", plant.sampling, {}, reason=reason, details=details)
    return _design(family, plant, "found", law, rate)


def _design(family: UpdatedSampling, plant: Plant, outcome: str, law: Law, rate: Rate) -> Design:
    details = {"rate": rate.document(), LAW: law.document()}
    return Design(family.name, outcome, plant.sampling, {}, details=details)  # type: ignore[arg-type]


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
    own: dict[str, Any] = {name: Exact(text) for name, text in DEFAULTS.items()} | {
        "Lambda": ExactMatrix([["1"] * plant.p]), "gamma": ExactMatrix([["0"] * plant.n]),
        "idle": Exact(IDLE["max_period"]),
    }  # fmt: skip
    return Law(**{**own, **parts})


def _found(
    family: UpdatedSampling, plant: Plant, largest: Mapping[Entry, Fraction], effort: int
) -> tuple[Law | None, str]:
    """The law that the objective asks for, or why there is none."""
    parts = typed_parts(family)
    own = {name: parts.get(name, Exact(text)) for name, text in DEFAULTS.items()}
    own["idle"] = parts.get("idle", Exact(IDLE["max_period"] if _is_longest(family) else IDLE["min_error"]))
    target = Target.of(plant, largest, float(own["idle"]), parts.get("Lambda"), parts.get("split"), parts.get("sigma"))
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


def _is_longest(family: UpdatedSampling) -> bool:
    """Whether the time between samples is all that counts, and no error is asked for."""
    return family.objective == "max_period" and family.error_at_most is None


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
