"""c(x_hat, u) of Assumption 1: typed and proved, derived from phi over the domain, or constant.

    |phi_j(x_hat, u) - phi_j(x, u)| <= c(x_hat, u) sum_(i <= j) |x_hat_i - x_i|       (triangular)
    |phi_n(x_hat, u) - phi_n(x, u)| <= c(x_hat, u) |x_hat - x|                          (last row)

The difference is a sum over i of a secant slope times x_hat_i - x_i: coordinates before i are those of x,
those after i of x_hat. x and the saturated x_hat are in the box of the domain.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from typing import TYPE_CHECKING, Literal

from flint import arb

from cdobs_cli.bounds.bounded import TRIAL, bounded, least_bound
from cdobs_cli.bounds.ranges import range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.certificate import Claim
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, upper_text
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.rational import simplify
from cdobs_cli.families.updated_sampling.separated import modulus_bound, separated
from cdobs_cli.plant import Interval, Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

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


def rate_of(family: UpdatedSampling, plant: Plant) -> Rate:
    """c(x_hat, u): typed, or derived from phi over the domain."""
    return derive_rate(plant, family.variant) if family.c is None else typed_rate(plant, family.c)


def stored_rate(family: UpdatedSampling, plant: Plant, design: Design) -> Rate:
    """The c of a stored design, which `Rate.document` wrote; a typed c is that of the spec.

    Raises: KeyError, ValueError, ExpressionError where there is none.
    """
    document = design.details["rate"]
    c = parse(str(document["c"]), frozenset((*plant.states, *(source.name for source in plant.inputs))))
    origin: Origin = document["origin"] if document["origin"] in ("typed", "derived") else "constant"
    if (family.c is not None) != (origin == "typed") or (family.c is not None and family.c != c):
        raise ValueError("its c(x_hat, u) is not that of the spec")
    return Rate(c, None if document["largest"] is None else Exact(document["largest"]), origin)


def met_entries(plant: Plant) -> tuple[tuple[int, int], ...]:
    """The slopes that the estimate can meet: with affine limits the cut estimate need not keep them, so a slope that
    is 0 within the limits counts where it is not 0 everywhere."""
    entries, n = plant.slopes.entries, plant.n
    if not plant.domain.where:
        return entries
    everywhere = ((i, j) for i in range(n) for j in range(n))
    return tuple((i, j) for i, j in everywhere if (i, j) in entries or plant.phi[i].derivative(plant.states[j]) != ZERO)


def magnitudes(plant: Plant) -> dict[tuple[int, int], Fraction] | None:
    """Bounds of |d phi_i / d x_j|: the declared slopes; anew over the whole box where the domain has affine
    limits besides, since the saturated estimate need not meet those (None where no bound is found)."""
    values = {}
    for i, j in met_entries(plant):
        if plant.domain.where:
            slope = simplify(plant.phi[i].derivative(plant.states[j]))
            sides = [least_bound(side, _region(plant, ""), _ROUGH, TRIAL) for side in (slope, -slope)]
        else:
            ends = (plant.slopes.lower[i, j], plant.slopes.upper[i, j])
            sides = [upper_text(abs(end.ball())) if end.rational is None else str(abs(end.rational)) for end in ends]
        found = [Fraction(side) for side in sides if side is not None]
        if len(found) < 2:
            return None
        values[i, j] = max(*found, Fraction(0))
    return values


def constant_rate(variant: str, values: Mapping[tuple[int, int], Fraction]) -> Rate:
    """Gamma: the largest slope (triangular), the norm of the last row (last row)."""
    largest = Exact(max(values.values(), default=Fraction(0)))
    if variant == "last_row" and len(values) > 1:
        squares = sum((value * value for value in values.values()), Fraction(0))
        largest = Exact(upper_text(fraction_ball(squares).sqrt()))
    return Rate(largest.expression, largest, "constant")


def _region(plant: Plant, *prefixes: str, where: bool = False) -> Region:
    inputs = tuple(source.name for source in plant.inputs)
    ends = {source.name: source.range for source in plant.inputs if source.range is not None}
    ends |= {prefix + name: interval for prefix in prefixes for name, interval in plant.domain.box.items()}
    names = tuple(prefix + name for prefix in prefixes for name in plant.states)
    return Region.made(ends, names + inputs, plant.domain.where if where else ())


def secant(plant: Plant, j: int, i: int) -> Expression:
    """The slope of phi_j between x_i and x_hat_i, over names x, hat.x, and between.x where the point in between
    stays unknown."""
    env: dict[str, Expression] = {name: Variable(HAT + name) for name in plant.states[i + 1 :]}
    name = plant.states[i]
    slope = simplify(plant.phi[j].derivative(name))
    if name not in slope.variables:
        return slope.substitute(env)
    phi, hat = plant.phi[j].substitute(env), Variable(HAT + name)
    quotient = simplify((phi.substitute({name: hat}) - phi) / (hat - Variable(name)))
    if not _is_singular(quotient, plant):
        return quotient
    return slope.substitute({**env, name: Variable(BETWEEN + name)})


def _is_singular(quotient: Expression, plant: Plant) -> bool:
    """Whether the quotient has no value where x_i = x_hat_i: the difference did not cancel."""
    bare = {name: name.removeprefix(HAT) for name in quotient.variables}
    point = _sampled(plant, set(bare.values()), 1)
    return not quotient.ball({name: point[own] for name, own in bare.items()}).is_finite()


def _sampled(plant: Plant, names: Collection[str], k: int) -> dict[str, arb]:
    """Point k >= 1 of a sequence that fills the domain evenly: the golden ratio's powers, one a name."""
    ends, point = _region(plant, "").ends, {}
    for position, name in enumerate(sorted(names)):
        interval = ends.get(name, Interval(None, None))
        low, high = (None if end is None else float(end) for end in (interval.lower, interval.upper))
        start = low if low is not None else -1.0 if high is None else high - 2.0
        width = 2.0 if low is None or high is None else high - low
        point[name] = arb(start + width * ((k * 0.6180339887498949 ** (position + 1)) % 1))
    return point


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
        high, low = (least_bound(side, region.over(a), _ROUGH, TRIAL) for side in (a, -a))
        return None if high is None or low is None else (-Exact(low), Exact(high))

    bounds: list[Expression] = []
    for i, j in met_entries(plant):
        terms = separated(secant(plant, i, j), known)
        bound = None if terms is None else modulus_bound(terms, ends)
        bounds.append(Number(values[i, j]) if bound is None else bound)
    if not any(bound.variables for bound in bounds):
        return constant
    largest = variant == "triangular" or len(bounds) == 1
    c = reduce(lambda a, b: call("max", a, b), bounds) if largest else call("sqrt", _squares(bounds))
    plain = c.substitute({HAT + name: Variable(name) for name in plant.states})
    if not _is_smaller(plant, plain, constant):
        return constant
    return _with_largest(plant, call("min", plain, constant.c), "derived", constant.largest)


def _squares(terms: Iterable[Expression]) -> Expression:
    return sum((one * one for one in terms), ZERO)


def _is_smaller(plant: Plant, c: Expression, constant: Rate) -> bool:
    """Whether c is worth its length: at most 0.9 of the constant on average over points of the domain."""
    most = max(float(constant.largest or Exact(1)), 1e-300)
    values = (c.ball(_sampled(plant, c.variables, k)) for k in range(1, 65))
    ratios = [min(1.0, abs(float(value.mid())) / most) for value in values]
    return sum(ratios) / len(ratios) <= 0.9


def _with_largest(plant: Plant, c: Expression, origin: Origin, known: Exact | None) -> Rate:
    found = least_bound(c, _region(plant, ""), _ROUGH, TRIAL)
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
        holds = _is_derived(plant, rate, variant) if rate.origin == "derived" else _is_constant(plant, rate, variant)
        method = "declared slopes" if rate.origin == "constant" else "secants separated in x and (x_hat, u)"
        return Claim("c", "premise", "proved" if holds else "undecided", statement, SOURCE, method=method)
    region = _region(plant, "", HAT, BETWEEN, where=True)
    c = rate.c.substitute({name: Variable(HAT + name) for name in plant.states})
    for side in _typed_sides(c, [secant(plant, i, j) for i, j in met_entries(plant)], variant):
        if not _is_nonpositive(side, region):
            return Claim("c", "premise", "undecided", f"{statement}: open where {side} <= 0 is needed", SOURCE)
    return Claim("c", "premise", "proved", statement, SOURCE, method="branch and bound on secants")


def _typed_sides(c: Expression, secants: Sequence[Expression], variant: str) -> Iterable[Expression]:
    """What must not be positive for a typed c. With no secant at all c must still not be negative: L would fall."""
    if variant == "last_row" and len(secants) > 1:
        return map(simplify, (_squares(secants) - c * c, -c))
    return map(simplify, [side for one in secants for side in (one - c, -one - c)] or [-c])


def _is_nonpositive(side: Expression, region: Region) -> bool:
    if range_of(side, region.box).upper <= 0:
        return True
    return bounded(side, region.over(side), EXACT_ZERO, TRIAL).status == "proved"


def _is_derived(plant: Plant, rate: Rate, variant: str) -> bool:
    """Whether a derived c is what this plant gives."""
    expected = derive_rate(plant, variant)
    return str(expected.c) == str(rate.c) and expected.largest == rate.largest


def _is_constant(plant: Plant, rate: Rate, variant: str) -> bool:
    """Whether a constant c is above the slopes."""
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
    return values is not None and constant_rate(variant, values) == Rate(rate.c, rate.largest, "constant")
