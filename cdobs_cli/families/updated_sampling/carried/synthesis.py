"""The law that a design runs by: typed, or found for the least error, the least measurements, or the longest T_min."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Bound
from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.updated_sampling.carried import errors
from cdobs_cli.families.updated_sampling.carried.law import CHOICES, LAW, MATRICES, Law
from cdobs_cli.families.updated_sampling.carried.proof import floor
from cdobs_cli.families.updated_sampling.carried.search import Target, has_law, least_error, longest, rounded
from cdobs_cli.families.updated_sampling.carried.slopes import largest_slopes
from cdobs_cli.families.updated_sampling.carried.typed import is_whole, typed_parts
from cdobs_cli.families.updated_sampling.lipschitz import rate_of
from cdobs_cli.plant import Entry, Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

THETA = "1/4"
SLOWEST, STEADY = "0.1", "1"  # idle where time between samples is all that counts, and where an error is asked for
LONGEST_SHARE = 0.9  # of the longest T_min: at the longest itself Pi has no floor
_ROOM = (1.0, 0.98, 0.9)  # of F, for what rounding takes
_SHORTER = (1.0, 0.99, 0.97, 0.93, 0.85)  # T_min, where a proof leaves an error a little above what was asked
_TOO_SMALL = "no law was found whose proved error keeps error_at_most: a larger one, or less noise, may help"
_UNBOUNDED = "c(x_hat, u) = {} has no bound over the domain, so Pi has no floor; declare a domain"
_NOTHING = "no law with a floor of Pi was found at T_min = {}: a shorter one, or smaller slopes, may help"
_NEVER = "no law with a floor of Pi was found for any T_min; the outputs must see the state, whatever the slopes"
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
    target = Target.of(plant, largest, own["idle"], own["epsilon"], **pinned, one=parts["one"])
    own |= {name: parts[name] for name in ("kappa", *CHOICES)}
    times = [parts["T_min"]] if "T_min" in parts else _times(family, target, plant, effort)
    reason = _NOTHING.format(times[0]) if "T_min" in parts else _NEVER
    if not times and family.error_at_most is not None:
        reason = _TOO_SMALL
    for T in times:
        made = least_error(target, float(T), effort)
        if made is None:
            continue
        for share in _ROOM:
            law = replace(rounded(made, target, share), T_min=T, **own, **_matrices(parts))
            proved = floor(plant, law, largest)
            if proved.holds and _keeps(family, errors.bounds(plant, law, largest, proved.share or Fraction(0))):
                return law, ""
            reason = _TOO_SMALL if proved.holds else _UNPROVED
    return None, reason


def _keeps(family: UpdatedSampling, bounds: Mapping[str, Bound]) -> bool:
    """Whether the proved errors are what was asked for."""
    for state, limit in (family.error_at_most or {}).items():
        bound = bounds.get(f"error.{state}")
        if bound is None or bound.proved is None or not Exact(bound.proved).is_at_most(limit):
            return False
    return True


def defaults(n: int, *, idle: str) -> dict[str, Exact]:
    """theta, epsilon and idle. det(Pi - F) is a product of n numbers that are small beside F near T_min."""
    return {"theta": Exact(THETA), "epsilon": Exact(Fraction(1, 10 ** (3 + 3 * n))), "idle": Exact(idle)}


def _idle(family: UpdatedSampling) -> str:
    return SLOWEST if family.objective == "max_period" and family.error_at_most is None else STEADY


def _matrices(parts: Mapping[str, Any]) -> dict[str, Any]:
    return {name: parts[name] for name in MATRICES if name in parts}


def _times(family: UpdatedSampling, target: Target, plant: Plant, effort: int) -> list[Exact]:
    """The longest T_min with errors that are small enough, then a little shorter ones, for what a proof takes; or nine
    tenths of the longest with any floor at all."""
    wanted = [family.error_at_most.get(state) for state in plant.states] if family.error_at_most else []
    limits = [inf if one is None else float(one) for one in wanted]

    def within(T: float) -> bool:
        if not limits:
            return has_law(target, T)
        made = least_error(target, T, effort)
        return made is not None and all(error <= limit for error, limit in zip(made.errors, limits, strict=True))

    T = longest(within, *target.times)
    shares = () if T is None else _SHORTER if limits else (LONGEST_SHARE, LONGEST_SHARE**2)
    return [Exact(decimal_text((T or 0.0) * share, 3)) for share in shares]
