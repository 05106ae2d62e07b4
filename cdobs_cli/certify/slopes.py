"""The declared slopes, put to the proof: lower_ij <= d phi_i / d x_j <= upper_ij over the domain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

from flint import arb

from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.certify.points import high_points, point_balls
from cdobs_cli.certify.region import Region, point_text
from cdobs_cli.exact.expression import ZERO, Expression
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, fraction_text, lower_text, upper_text
from cdobs_cli.exact.ranges import range_of
from cdobs_cli.plant import Plant

SOURCE = "the slope premise of every family (Dinh2014, Assumption 1; Boukal2020, Section II)"


def slope_claims(plant: Plant) -> tuple[Claim, ...]:
    """One premise for each slope entry that is claimed, or that the typed phi has.

        lower_ij <= d phi_i / d x_j (x, u) <= upper_ij    for all (x, u) of the domain

    At kinks (abs, min, max, sat) the Clarke gradient is bounded. The domain is convex, so the bound holds
    for secants between any two of its points, which is what the error equation needs.

    Returns: claims `slopes.<i>.<j>` (from 1), required; proved, refuted with an exact point, or undecided
    with what would settle them.
    """
    region = Region.of(plant)
    claims = []
    for i, phi in enumerate(plant.phi):
        for j, name in enumerate(plant.states):
            slope = phi.derivative(name)
            if slope != ZERO or (i, j) in plant.slopes.entries:
                claims.append(_claim(plant, i, j, slope, region))
    return tuple(claims)


def _claim(plant: Plant, i: int, j: int, slope: Expression, region: Region) -> Claim:
    low, high = plant.slopes.lower[i, j], plant.slopes.upper[i, j]
    name = plant.states[j]
    statement = f"{low} <= d phi_{i + 1} / d {name} = {slope} <= {high} for {region.text() or 'all states'}"
    decided = decide(slope, low, high, region)
    return Claim(
        f"slopes.{i + 1}.{j + 1}", "premise", decided.status, statement if decided.reason is None else f"{statement}: {decided.reason}",
        SOURCE, required=True, margin=decided.margin, method=decided.method, witness=decided.witness,
    )  # fmt: skip


def resolve(plant: Plant) -> tuple[Plant, dict[str, tuple[str, str]]]:
    """Proved bounds for the entries declared `auto`, rounded outwards to short decimals.

    Returns: the plant with these bounds, and the bounds by entry, {"2.1": (lower, upper)}, from 1. An entry
    for which no finite bound was proved stays in `slopes.auto`.
    """
    region = Region.of(plant)
    found = {}
    for i, j in sorted(plant.slopes.auto):
        bounds = automatic(plant.phi[i].derivative(plant.states[j]), region)
        if bounds is not None:
            found[f"{i + 1}.{j + 1}"] = bounds
    missing = frozenset((i, j) for i, j in plant.slopes.auto if f"{i + 1}.{j + 1}" not in found)
    return replace(plant, slopes=replace(plant.slopes, auto=missing)) if missing else plant.with_slopes(found), found


def automatic(slope: Expression, region: Region) -> tuple[str, str] | None:
    """A proved enclosure of the slope over the region, or None where none was found."""
    enclosure = range_of(slope, region.box)
    if not enclosure.is_finite:
        return None
    return _short_below(Fraction(enclosure.lower)), _short_above(Fraction(enclosure.upper))


def _short_below(value: Fraction) -> str:
    text = fraction_text(value)
    return text if len(text) <= 8 and "/" not in text else lower_text(fraction_ball(value), 4)


def _short_above(value: Fraction) -> str:
    text = fraction_text(value)
    return text if len(text) <= 8 and "/" not in text else upper_text(fraction_ball(value), 4)


@dataclass(frozen=True)
class Decision:
    """What became of one bound: `reason` says what is left where it is undecided."""

    status: Status
    method: str
    margin: str | None = None
    witness: Witness | None = None
    reason: str | None = None


def decide(slope: Expression, low: Exact, high: Exact, region: Region) -> Decision:
    """Proved, refuted or undecided: low <= slope <= high over the region."""
    enclosure = range_of(slope, region.box)
    if enclosure.is_finite:
        above = _distance(high, Fraction(enclosure.upper))
        below = _distance(-low, -Fraction(enclosure.lower))
        margin = above.min(below)
        if margin >= 0:
            return Decision("proved", "range of the functions", lower_text(margin))
    for side, limit in ((slope, high), (-slope, -low)):
        for point in high_points(side, region):
            excess = side.ball(point_balls(point)) - limit.ball()
            if excess > 0 and region.holds(point):
                witness = Witness("point", "plant", data={"point": point_text(point), "slope": lower_text(slope.ball(point_balls(point)))})
                return Decision("refuted", "exact point", lower_text(-excess), witness)
    return Decision("undecided", "range of the functions", reason="the range of the functions alone does not decide it")


def _distance(limit: Exact, value: Fraction) -> arb:
    if limit.rational is not None:
        return fraction_ball(limit.rational - value)
    return limit.ball() - fraction_ball(value)
