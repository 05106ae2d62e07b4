"""c(x_hat, u) of Assumption 1: typed and proved, derived from phi over the domain, or constant.

    |phi_j(x_hat, u) - phi_j(x, u)| <= c(x_hat, u) sum_(i <= j) |x_hat_i - x_i|       (triangular)
    |phi_n(x_hat, u) - phi_n(x, u)| <= c(x_hat, u) |x_hat - x|                          (last row)

The difference is a sum over i of a secant slope times x_hat_i - x_i: coordinates before i are those of x,
those after i of x_hat. x and the saturated x_hat are in the box of the domain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

from flint import arb

from cdobs_cli.bounds.bounded import TRIAL, bounded, least_bound
from cdobs_cli.bounds.ranges import range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.certificate import Claim, Status
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, upper_text
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.rational import simplify
from cdobs_cli.families.updated_sampling.separated import modulus_bound, separated
from cdobs_cli.plant import Interval, Plant

HAT = "hat."
BETWEEN = "between."
_ROUGH = 0.01
SOURCE = "Andrieu2014, Assumption 1, (3)"
Origin = Literal["typed", "derived", "constant"]


@dataclass(frozen=True)
class Rate:
    """c over the plant's states (which stand for the estimate) and inputs; c <= largest is proved (None: unbounded)."""

    c: Expression
    largest: Exact | None
    origin: Origin

    def document(self) -> dict[str, str | None]:
        return {"c": str(self.c), "largest": None if self.largest is None else str(self.largest), "origin": self.origin}


def read_rate(document: Mapping[str, str | None], plant: Plant) -> Rate:
    """What `Rate.document` wrote. Raises: ExpressionError, KeyError."""
    names = frozenset((*plant.states, *(source.name for source in plant.inputs)))
    largest = document["largest"]
    origin: Origin = "typed" if document["origin"] == "typed" else "derived" if document["origin"] == "derived" else "constant"
    return Rate(parse(str(document["c"]), names), None if largest is None else Exact(largest), origin)


def met_entries(plant: Plant) -> tuple[tuple[int, int], ...]:
    """The slopes that the estimate can meet: with affine limits the cut estimate need not keep them, so a slope that
    is 0 within the limits counts where it is not 0 everywhere."""
    entries, n = plant.slopes.entries, plant.n
    if not plant.domain.where:
        return entries
    return tuple(
        (i, j) for i in range(n) for j, name in enumerate(plant.states) if (i, j) in entries or plant.phi[i].derivative(name) != ZERO
    )


def magnitudes(plant: Plant) -> dict[tuple[int, int], Fraction] | None:
    """Bounds of |d phi_i / d x_j|: the declared slopes; anew over the whole box where the domain has affine
    limits besides, since the saturated estimate need not meet those (None where no bound is found)."""
    values = {}
    for i, j in met_entries(plant):
        ends = (plant.slopes.lower[i, j], plant.slopes.upper[i, j])
        sides: list[str | None] = [str(abs(end.rational)) if end.rational is not None else upper_text(abs(end.ball())) for end in ends]
        if plant.domain.where:
            slope = simplify(plant.phi[i].derivative(plant.states[j]))
            sides = [least_bound(side, _region(plant, ""), _ROUGH, TRIAL) for side in (slope, -slope)]
        found = [Fraction(side) for side in sides if side is not None]
        if len(found) < 2:
            return None
        values[i, j] = max(*found, Fraction(0))
    return values


def constant_rate(variant: str, values: Mapping[tuple[int, int], Fraction]) -> Rate:
    """Gamma: the largest slope (triangular), the norm of the last row (last row)."""
    largest = Exact(max(values.values(), default=Fraction(0)))
    if variant == "last_row" and len(values) > 1:
        largest = Exact(upper_text(fraction_ball(sum((value * value for value in values.values()), Fraction(0))).sqrt()))
    return Rate(largest.expression, largest, "constant")


def _ends(plant: Plant, *prefixes: str) -> dict[str, Interval]:
    ends = {source.name: source.range for source in plant.inputs if source.range is not None}
    for prefix in prefixes:
        ends |= {prefix + name: interval for name, interval in plant.domain.box.items()}
    return ends


def _region(plant: Plant, *prefixes: str, where: bool = False) -> Region:
    names = tuple(prefix + name for prefix in prefixes for name in plant.states) + tuple(source.name for source in plant.inputs)
    return Region.made(_ends(plant, *prefixes), names, plant.domain.where if where else ())


def secant(plant: Plant, j: int, i: int) -> Expression:
    """The slope of phi_j between x_i and x_hat_i, over names x, hat.x, and between.x where the point in between
    stays unknown."""
    env: dict[str, Expression] = {name: Variable(HAT + name) for name in plant.states[i + 1 :]}
    name = plant.states[i]
    slope = simplify(plant.phi[j].derivative(name))
    if name not in slope.variables:
        return slope.substitute(env)
    phi = plant.phi[j].substitute(env)
    hat = Variable(HAT + name)
    quotient = simplify((phi.substitute({name: hat}) - phi) / (hat - Variable(name)))
    if not _is_singular(quotient, plant):
        return quotient
    return slope.substitute({**env, name: Variable(BETWEEN + name)})


def _is_singular(quotient: Expression, plant: Plant) -> bool:
    """Whether the quotient has no value where x_i = x_hat_i: the difference did not cancel."""
    point = {}
    for inside in quotient.variables:
        bare = inside.removeprefix(HAT)
        interval = _ends(plant, "").get(bare)
        low, high = (None, None) if interval is None else (interval.lower, interval.upper)
        value = Fraction(7, 10) if low is None or high is None else Fraction(float(low) * 0.6 + float(high) * 0.4)
        if interval is not None and (low is None) != (high is None):
            value = Fraction(float(low)) + 1 if low is not None else Fraction(float(high or Exact(0))) - 1
        point[inside] = arb(float(value))
    return not quotient.ball(point).is_finite()


def derive_rate(plant: Plant, variant: str) -> Rate:
    """c from the secants of phi: each is bounded over x for every x_hat and u, by `separated.modulus_bound`.

    The constant takes the place of an entry that does not come apart; never above the constant of the slopes.
    """
    values = magnitudes(plant)
    if values is None:
        return Rate(ZERO, None, "constant")
    constant = constant_rate(variant, values)
    known = frozenset((*(HAT + name for name in plant.states), *(source.name for source in plant.inputs)))
    region = _region(plant, "", BETWEEN, where=True)

    def ends(a: Expression) -> tuple[Exact, Exact] | None:
        if isinstance(a, Number):
            return Exact(a.value), Exact(a.value)
        own = range_of(a, region.box)
        if isinstance(own.lower, Fraction) and isinstance(own.upper, Fraction) and not a.variables & set(region.ends):
            return Exact(own.lower), Exact(own.upper)
        part = Region.made({k: v for k, v in region.ends.items() if k in a.variables}, tuple(sorted(a.variables)), _within(region, a))
        high, low = (least_bound(side, part, _ROUGH, TRIAL) for side in (a, -a))
        return None if high is None or low is None else (-Exact(low), Exact(high))

    bounds: list[Expression] = []
    for i, j in met_entries(plant):
        terms = separated(secant(plant, i, j), known)
        bound = None if terms is None else modulus_bound(terms, ends)
        bounds.append(Number(values[i, j]) if bound is None else bound)
    if not any(bound.variables for bound in bounds):
        return constant
    c = bounds[0]
    if variant == "triangular":
        for bound in bounds[1:]:
            c = call("max", c, bound)
    elif len(bounds) > 1:
        total: Expression = ZERO
        for bound in bounds:
            total = total + bound * bound
        c = call("sqrt", total)
    plain = c.substitute({HAT + name: Variable(name) for name in plant.states})
    if not _is_smaller(plant, plain, constant):
        return constant
    return _with_largest(plant, call("min", plain, constant.c), "derived", constant.largest)


def _is_smaller(plant: Plant, c: Expression, constant: Rate) -> bool:
    """Whether c is worth its length: at most 0.9 of the constant on average over points of the domain."""
    ends = _ends(plant, "")
    ratios = []
    for k in range(1, 65):
        # A low-discrepancy sequence: the golden ratio's powers, one a name.
        point = {}
        for position, name in enumerate(sorted(c.variables)):
            interval = ends.get(name)
            low = -1.0 if interval is None or interval.lower is None else float(interval.lower)
            high = low + 2.0 if interval is None or interval.upper is None else float(interval.upper)
            point[name] = arb(low + (high - low) * ((k * 0.6180339887498949 ** (position + 1)) % 1))
        ratios.append(min(1.0, abs(float(c.ball(point).mid())) / max(float(constant.largest or Exact(1)), 1e-300)))
    return sum(ratios) / len(ratios) <= 0.9


def _within(region: Region, a: Expression) -> tuple[Expression, ...]:
    return tuple(w for w in region.where if w.variables <= a.variables)


def _with_largest(plant: Plant, c: Expression, origin: Origin, known: Exact | None) -> Rate:
    found = least_bound(c, _region(plant, ""), 0.01, TRIAL)
    largest = known if found is None else Exact(found)
    if known is not None and largest is not None and float(known) < float(largest):
        largest = known
    return Rate(c, largest, origin)


def typed_rate(plant: Plant, c: Expression) -> Rate:
    """The typed c with a proved bound over the domain."""
    return _with_largest(plant, c, "typed", None)


def rate_claim(plant: Plant, rate: Rate, variant: str) -> Claim:
    """Assumption 1 for this c: by construction where it was derived here, by branch and bound where it was typed."""
    over = _region(plant, "").text() or "all x and u"
    statement = f"c(x_hat, u) = {rate.c} bounds the slopes of phi as Assumption 1 asks, for {over}"
    if rate.origin != "typed":
        status: Status = "proved" if _is_proved(plant, rate, variant) else "undecided"
        method = "declared slopes" if rate.origin == "constant" else "secants separated in x and (x_hat, u)"
        return Claim("c", "premise", status, statement, SOURCE, method=method)
    region = _region(plant, "", HAT, BETWEEN, where=True)
    c = rate.c.substitute({name: Variable(HAT + name) for name in plant.states})
    secants = [secant(plant, i, j) for i, j in met_entries(plant)]
    if variant == "last_row" and len(secants) > 1:
        total: Expression = ZERO
        for one in secants:
            total = total + one * one
        sides = [total - c * c, -c]
    else:
        # With no secant at all c must still not be negative: L would fall.
        sides = [side for one in secants for side in (one - c, -one - c)] or [-c]
    for side in sides:
        if not _is_nonpositive(simplify(side), region):
            return Claim("c", "premise", "undecided", f"{statement}: open where {simplify(side)} <= 0 is needed", SOURCE)
    return Claim("c", "premise", "proved", statement, SOURCE, method="branch and bound on secants")


def _is_nonpositive(side: Expression, region: Region) -> bool:
    upper = range_of(side, region.box).upper
    if upper <= 0:
        return True
    part = Region.made({k: v for k, v in region.ends.items() if k in side.variables}, tuple(sorted(side.variables)), _within(region, side))
    return bounded(side, part, Exact(0), TRIAL).status == "proved"


def _is_proved(plant: Plant, rate: Rate, variant: str) -> bool:
    """Whether a constant c is above the slopes, or a derived one what this plant gives."""
    if rate.origin == "derived":
        expected = derive_rate(plant, variant)
        return str(expected.c) == str(rate.c) and expected.largest == rate.largest
    if rate.largest is None or rate.c != rate.largest.expression:
        return False
    if variant == "triangular" and plant.domain.where:
        region = _region(plant, "")
        slopes = [simplify(plant.phi[i].derivative(plant.states[j])) for i, j in met_entries(plant)]
        return all(_is_nonpositive(side - rate.c, region) for slope in slopes for side in (slope, -slope))
    values = magnitudes(plant)
    needed, stored = (None if values is None else constant_rate(variant, values).largest), rate.largest.rational
    return needed is not None and needed.rational is not None and stored is not None and needed.rational <= stored


def largest_is_proved(plant: Plant, rate: Rate, variant: str, premise: Claim) -> bool:
    """Whether c <= largest over the domain and the input ranges, anew: by range where c was typed, to the letter
    what the plant gives where it was derived or constant. `premise`: what `rate_claim` said."""
    if rate.largest is None:
        return False
    if rate.origin == "typed":
        return _is_nonpositive(simplify(rate.c - rate.largest.expression), _region(plant, ""))
    if rate.origin == "derived":
        return premise.status == "proved"
    values = magnitudes(plant)
    return values is not None and rate.c == rate.largest.expression and constant_rate(variant, values).largest == rate.largest
