"""The declared slopes, put to the proof: lower_ij <= d phi_i / d x_j <= upper_ij over the domain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.bounds.bounded import FULL, bounded, least_bound
from cdobs_cli.bounds.definedness import Definedness, defined, defined_claim, is_total
from cdobs_cli.bounds.joint import joint_slopes
from cdobs_cli.bounds.points import high_points
from cdobs_cli.bounds.ranges import Point, known_range, value_at
from cdobs_cli.bounds.region import Content, Region, point_balls, point_witness
from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.exact.budget import forgotten
from cdobs_cli.exact.expression import ONE, ZERO, Expression
from cdobs_cli.exact.numbers import Exact, fraction_text, lower_text, upper_text
from cdobs_cli.exact.rational import is_zero, simplify
from cdobs_cli.plant import Entry, Plant, Quantity, Slopes
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.bounds.supremum import Bounded

# How names of bounds of the outputs' slopes begin.
OUTPUT = "output."
SOURCE = "the slope premise of every family (Dinh2014, Assumption 1; Boukal2020, Section II)"


def slope_claims(plant: Plant) -> tuple[Claim, ...]:
    """One premise for each slope entry that is claimed, or that the typed phi has.

        lower_ij <= d phi_i / d x_j (x, u) <= upper_ij    for all (x, u) of the domain

    At kinks (abs, min, max, sat) the Clarke gradient is bounded. The domain is convex, so the bound holds
    for secants between any two of its points, which is what the error equation needs.

    Returns: claims `slopes.<i>.<j>` (from 1), of outputs `slopes.output.<k>.<j>`, required; proved, refuted with an
    exact point, or undecided with what would settle them. Besides `defined` where phi or h may be undefined somewhere
    and, not required, `domain_invariant` where a domain is given.
    """
    region = Region.of(plant)
    judged = tuple(defined(one, region) for one in plant.functions)
    entries = dict.fromkeys(plant.slopes.entries, ZERO) | dict(varying(plant))
    claims = [_claim(plant, *at, entries[at], region, judged[at[0]]) for at in sorted(entries)]
    claims += [_joint_claim(plant, rho, region, judged) for rho in plant.slopes.joint]
    claims += [_output_claim(plant, at, slope, region, judged[plant.n + at[0]]) for at, slope in of_outputs(plant)]
    if not all(map(is_total, plant.functions)):
        what = "phi is" if plant.h is None else "phi and the outputs are"
        claims.append(defined_claim(judged, region, what))
    if plant.domain:
        from cdobs_cli.bounds.invariance import domain_invariant

        claims.append(domain_invariant(plant))
    return tuple(claims)


def varying(plant: Plant) -> Iterator[tuple[tuple[int, int], Expression]]:
    """The slopes that are not identically 0, as they are typed, with their places."""
    for i, phi in enumerate(plant.phi):
        for j, name in enumerate(plant.states):
            slope = phi.derivative(name)
            if slope != ZERO:
                yield (i, j), slope


def of_outputs(plant: Plant) -> Iterator[tuple[Entry, Expression]]:
    """The slopes of the outputs that are not constant, with their places."""
    for k, one in enumerate(plant.h or () if plant.H is not None else ()):
        for j, name in enumerate(plant.states):
            slope = one.derivative(name)
            if simplify(slope).variables:
                yield (k, j), slope


def claimed(plant: Plant) -> Iterator[tuple[Expression, Exact, Exact]]:
    """Functions with the bounds that the slope class claims: those of the entries (read by themselves too where they
    share functions), then of what entries share, then of the outputs."""
    slopes = plant.slopes
    yield from ((slope, slopes.lower[at], slopes.upper[at]) for at, slope in varying(plant))
    yield from ((rho.function, rho.lower, rho.upper) for rho in slopes.joint if rho.function is not None)
    if plant.H is not None:
        yield from ((slope, plant.H.lower[at], plant.H.upper[at]) for at, slope in of_outputs(plant))


def _claim(plant: Plant, i: int, j: int, slope: Expression, region: Region, judged: Definedness) -> Claim:
    ends, name = (plant.slopes.lower[i, j], plant.slopes.upper[i, j]), f"phi_{i + 1}"
    return _premise(f"{i + 1}.{j + 1}", (name, plant.states[j]), slope, ends, region, judged)


def _output_claim(plant: Plant, at: Entry, slope: Expression, region: Region, judged: Definedness) -> Claim:
    assert plant.H is not None
    k, j = at
    ends, names = (plant.H.lower[at], plant.H.upper[at]), (f"y_{k + 1}", plant.states[j])
    return _premise(f"{OUTPUT}{k + 1}.{j + 1}", names, slope, ends, region, judged)


def _premise(
    identifier: str, names: tuple[str, str], slope: Expression, ends: tuple[Exact, Exact], region: Region,
    judged: Definedness,
) -> Claim:  # fmt: skip
    """The bounds of one slope, d names[0] / d names[1]."""
    low, high = ends
    statement = f"{low} <= d {names[0]} / d {names[1]} = {simplify(slope)} <= {high} for {region.text()}"
    if region.where and next(high_points(ONE, region), None) is None:
        decided = Decision("undecided", "branch and bound", reason="no point of the domain was found; it may be empty")
    elif judged.status == "proved":
        decided = decide(slope, low, high, region)
    else:
        doubt = "proved to be " if judged.status == "undecided" else ""
        reason = f"{names[0]} is not {doubt}defined there, {judged.condition} is needed"
        decided = Decision(judged.status, "definedness", witness=point_witness(judged.point), reason=reason)
    text = statement if decided.reason is None else f"{statement}: {decided.reason}"
    return Claim(
        f"slopes.{identifier}", "premise", decided.status, text, SOURCE, required=True, margin=decided.margin,
        method=decided.method, witness=decided.witness,
    )  # fmt: skip


def _joint_claim(plant: Plant, rho: Quantity, region: Region, judged: Sequence[Definedness]) -> Claim:
    """A function that several entries share: its bounds, and that these entries are what it and the others make."""
    assert rho.function is not None
    moved = ", ".join(f"d phi_{i + 1} / d {plant.states[j]}" for (i, j), _ in rho.weights)
    bounds = f"{rho.lower} <= {rho.name} = {rho.function} <= {rho.upper} for {region.text()}"
    decided = decide(rho.function, rho.lower, rho.upper, region)
    if decided.status == "proved" and not all(_is_made(plant, entry) for entry, _ in rho.weights):
        reason = "these slopes are not what the functions make"
        decided = Decision("undecided", "canonical forms", reason=reason)
    elif decided.status == "proved" and not all(judged[i].status == "proved" for (i, _), _ in rho.weights):
        decided = Decision("undecided", "definedness", reason="phi is not proved to be defined there")
    why = "" if decided.reason is None else f": {decided.reason}"
    return Claim(
        f"slopes.{rho.name}", "premise", decided.status, f"{bounds}, which moves {moved} together{why}", SOURCE,
        required=True, margin=decided.margin, method=decided.method, witness=decided.witness,
    )  # fmt: skip


def _is_made(plant: Plant, entry: Entry) -> bool:
    """Whether an entry is exactly its offset and what the joint functions add."""
    i, j = entry
    total = plant.slopes.constant(entry).expression
    for rho in plant.slopes.joint:
        for at, weight in rho.weights:
            if at == entry and rho.function is not None:
                total = total + weight.expression * rho.function
    return is_zero(plant.phi[i].derivative(plant.states[j]) - total)


def resolve(
    plant: Plant, *, together: bool = True, over: Plant | None = None
) -> tuple[Plant, dict[str, tuple[str, str]]]:
    """Proved bounds for the entries declared `auto`, rounded outwards to short decimals.

    Returns: the plant with these bounds, and the bounds by entry, {"2.1": (lower, upper)}, from 1, and by function
    where several entries share some, {"rho1": (lower, upper)}, and of outputs, {"output.1.2": (lower, upper)}. An entry
    for which no finite bound was proved stays in `slopes.auto`, or `H.auto`.

    Args:
        together: whether entries that share functions are to move together.
        over: the plant with the domain that the bounds are wanted over, where that is a wider one.
    """
    region = Region.of(over or plant)
    found = {}
    for name, _, slope in to_be_found(plant):
        bounds = automatic(slope, region)
        if bounds is not None:
            found[name] = bounds
    missing = {name for name, _, _ in to_be_found(plant)} - found.keys()
    if missing:
        slopes, H = _left_of(plant.slopes, missing), None if plant.H is None else _left_of(plant.H, missing, OUTPUT)
        return replace(plant, slopes=slopes, H=H), found
    joint = joint_slopes(plant) if together else None
    ends = [automatic(one.function, region) for one in joint.functions] if joint is not None else []
    if ends and None not in ends:
        found |= {f"rho{k + 1}": bounds for k, bounds in enumerate(ends) if bounds is not None}
    return with_found(plant, found), found


def to_be_found(plant: Plant) -> Iterator[tuple[str, str, Expression]]:
    """The slopes left `auto`, of phi and of the outputs: the name of their bounds, their own, and what they are."""
    for i, j in sorted(plant.slopes.auto):
        name = plant.states[j]
        yield f"{i + 1}.{j + 1}", f"d phi_{i + 1}/d {name}", plant.phi[i].derivative(name)
    for k, j in sorted(plant.H.auto) if plant.H is not None else ():
        assert plant.h is not None
        name = plant.states[j]
        yield f"{OUTPUT}{k + 1}.{j + 1}", f"d y_{k + 1}/d {name}", plant.h[k].derivative(name)


def _left_of(slopes: Slopes, missing: Set[str], prefix: str = "") -> Slopes:
    """The slopes with `auto` only where a name is missing."""
    return replace(slopes, auto=frozenset((i, j) for i, j in slopes.auto if f"{prefix}{i + 1}.{j + 1}" in missing))


def is_shared(name: str) -> bool:
    """Whether a bound is that of a function of several entries."""
    return name.startswith("rho")


def with_found(plant: Plant, found: Mapping[str, tuple[str, str]]) -> Plant:
    """The plant with the slopes that were found: of each entry, of the functions that entries share, of outputs.

    Raises: KeyError where an `auto` entry has no bound, ValueError for functions that the plant's slopes do not share.
    """
    of_y = {name.removeprefix(OUTPUT): ends for name, ends in found.items() if name.startswith(OUTPUT)}
    resolved = plant.with_slopes(found).with_output_slopes(of_y)
    names = [name for name in found if is_shared(name)]
    if not names:
        return resolved
    joint = joint_slopes(plant)
    if joint is None or names != [f"rho{k + 1}" for k in range(len(joint.functions))]:
        raise ValueError("functions that these slopes do not share")
    quantities = []
    for name, one in zip(names, joint.functions, strict=True):
        weights = tuple((entry, Exact(weight)) for entry, weight in one.weights)
        low, high = found[name]
        quantities.append(Quantity(name, weights, Exact(low), Exact(high), one.function))
    return replace(resolved, slopes=replace(resolved.slopes, joint=tuple(quantities), offset=joint.offset))


def unbounded_claims(plant: Plant) -> tuple[Claim, ...]:
    """The premises of a plant with slopes left in `auto`: no bound was proved for them, and what would give one."""
    region = Region.of(plant)
    claims = []
    for name, what, derivative in to_be_found(plant):
        slope = simplify(derivative)
        free = [one for one in region.unbounded if one in slope.variables] or sorted(slope.variables)
        statement = f"no bound of {what} = {slope} was proved; declare a smaller domain of {', '.join(free)}"
        claims.append(Claim(f"slopes.{name}", "premise", "undecided", statement, SOURCE, required=True))
    return tuple(claims)


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
    enclosure = known_range(slope, region.box)
    if enclosure.is_finite:
        below, above = (Exact(Fraction(end)) for end in (enclosure.lower, enclosure.upper))
        margin = (high - above).ball().min((below - low).ball())
        if margin >= 0:
            return Decision("proved", "range of the functions", lower_text(margin))
    sides = (("above", slope, high), ("below", -slope, -low))
    for _, side, limit in sides:
        for point in high_points(side, region):
            if (refuted := _refuted(slope, side, limit, point, region)) is not None:
                return refuted
    margins, open_sides = [], []
    for name, side, limit in sides:
        bound = bounded(side, region, limit, FULL)
        refuted = None if bound.point is None else _refuted(slope, side, limit, bound.point, region)
        if refuted is not None:
            return refuted
        if bound.status == "proved":
            margins.append(limit.ball() - arb(bound.value))
        else:
            open_sides.append(_left(name, region, bound))
    if open_sides:
        return Decision("undecided", "branch and bound", reason="; ".join(open_sides))
    return Decision("proved", "branch and bound", lower_text(margins[0].min(margins[1]).max(arb(0))))


def _refuted(slope: Expression, side: Expression, limit: Exact, point: Point, region: Region) -> Decision | None:
    at = point_balls(point)
    excess = side.ball(at) - limit.ball()
    if not excess > 0 or not region.holds(point):
        return None
    value = value_at(slope, point)
    exact = value.is_point and isinstance(value.lower, Fraction)
    text = fraction_text(Fraction(value.lower)) if exact else lower_text(slope.ball(at))
    return Decision("refuted", "exact point", lower_text(-excess), point_witness(point, slope=text))


def _left(name: str, region: Region, bound: Bounded) -> str:
    """What is left, and what would settle it."""
    parts = [f"open {name}"]
    if bound.box:
        near = ", ".join(f"{name} in [{low:.6g}, {high:.6g}]" for name, (low, high) in bound.box.items())
        parts.append(f"near {near}")
    if isfinite(bound.value):
        reached = upper_text(arb(bound.value), 6)
        parts.append(f"{reached if name == 'above' else _negated(reached)} would be proved")
    else:
        parts.append(f"no finite bound was found; bound {', '.join(region.unbounded) or 'the domain more tightly'}")
    return ", ".join(parts)


def _negated(text: str) -> str:
    return fraction_text(-Fraction(text))


def automatic(slope: Expression, region: Region) -> tuple[str, str] | None:
    """A proved enclosure of the slope over the region, or None where none was found."""
    return _enclosed(slope, region.content)


# A design is tried over a few regions, and over each with slopes that move together and by themselves.
@lru_cache(256)
def _enclosed(slope: Expression, content: Content) -> tuple[str, str] | None:
    region = Region.of_content(content)
    own = known_range(slope, region.box)
    if own.is_point and isinstance(own.lower, Fraction):
        return (str(Exact(own.lower)),) * 2
    high = least_bound(slope, region)
    low = least_bound(-slope, region) if high is not None else None
    return None if high is None or low is None else (_negated(low), high)


forgotten(_enclosed.cache_clear)
