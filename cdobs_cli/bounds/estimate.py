"""Does the estimate stay where the slopes hold?

The error equation takes slopes on a convex set that holds x and x_hat. That the plant stays in its domain is proved or
assumed (`invariance`); of the estimate it is shown, in one of these ways:

    everywhere     the slopes hold all over R^n;
    margin         they hold on the domain widened by m_j in each state, and |e_j| never passes m_j (`transients`);
                   where the outputs' slopes vary also not before the first correction, which reads h at x_hat(0);
    continuation   the observer continues phi linearly outside the box (`Plant.continued`), which keeps its slopes;
    cut            a family's own observer evaluates phi at the estimate cut to the box, and its theorem allows for it.

Otherwise it is `open`, and nothing is proved of the observer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Literal

from flint import arb

from cdobs_cli.bounds.definedness import defined, is_total
from cdobs_cli.bounds.ranges import Range, range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.bounds.slopes import claimed, decide, varying
from cdobs_cli.certificate import UNDER_NOISE, Claim, Status
from cdobs_cli.design import Confinement
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, upper_text
from cdobs_cli.plant import Box, Domain, Interval, Plant

Saturate = Literal["auto"] | bool
# From a box of x_hat(0) - x(0) to upper ends of |e_j(t)| for all t after the first sample, infinite where unknown.
Transient = Callable[[Box], tuple[arb, ...]]
SOURCE = "cdobs, the estimate and the domain"
# A margin is a little more than the transient that it has to hold.
_ROOM = Fraction(1001, 1000)
# Margins tried where no initial error is typed: parts of the domain's width.
_PARTS = tuple(Fraction(1, 4**k) for k in range(1, 7))


def confine(plant: Plant, saturate: Saturate, transients: Sequence[Transient], start: Box | None) -> Confinement:
    """The way that is taken for this design: everywhere, else (auto) the margin for the typed initial errors, the
    continuation, the margin for a box of initial errors of its own. Loads no solver.

    Args:
        start: the initial errors that the spec types, None where it types none.
    """
    if not plant.domain or holds_everywhere(plant):
        return Confinement("everywhere")
    if saturate is not True and start is not None:
        for errors in (_symmetric(start), start):
            within = _margin_for(plant, transients, errors)
            if within is not None:
                return within
    if saturate is not False and _is_continued(plant):
        return Confinement("continuation")
    return (_margin_of_its_own(plant, transients) if saturate is not True else None) or Confinement("open")


def _is_continued(plant: Plant) -> bool:
    """Whether the continuation keeps the slope class: entries that move by themselves, on the whole box."""
    return not plant.slopes.joint and (not plant.domain.where or _slopes_hold(plant.on_box))


def _symmetric(start: Box) -> Box:
    """The smallest box of errors round 0 that holds these."""
    moduli = [tuple(map(_modulus, ends)) for ends in zip(start.lower, start.upper, strict=True)]
    sizes = [above if (above - below).sign() == 1 else below for below, above in moduli]
    return Box(tuple(-size for size in sizes), tuple(sizes))


def _modulus(value: Exact) -> Exact:
    return -value if value.sign() == -1 else value


def holds_everywhere(plant: Plant) -> bool:
    """Whether phi and h are defined and their slopes hold for every state: by the ranges of the functions alone."""
    region = Region.of(replace(plant, domain=Domain()))
    if any(set(plant.states) & phi.variables and not is_total(phi) for phi in plant.functions):
        return False
    return all(_is_between(range_of(slope, region.box), low, high) for slope, low, high in claimed(plant))


def _is_between(values: Range, low: Exact, high: Exact) -> bool:
    if not values.is_finite:
        return False
    return low.is_at_most(Exact(Fraction(values.lower))) and Exact(Fraction(values.upper)).is_at_most(high)


def _slopes_hold(plant: Plant, *, zeros: bool = False) -> bool:
    """Whether phi and h are defined and their slopes are proved all over the domain: all of them, or those declared to
    be 0 (where the family proves the other ones itself)."""
    region = Region.of(plant)
    if not all(is_total(phi) or defined(phi, region).status == "proved" for phi in plant.functions):
        return False
    judged: Iterable[tuple[Expression, Exact, Exact]] = claimed(plant)
    if zeros:
        judged = ((slope, EXACT_ZERO, EXACT_ZERO) for at, slope in varying(plant) if at not in plant.slopes.entries)
    return all(decide(*one, region).status == "proved" for one in judged)


def _margin_for(plant: Plant, transients: Sequence[Transient], start: Box) -> Confinement | None:
    """A margin that the transient from these initial errors does not pass, with slopes that hold there."""
    before = before_the_first_sample(plant, start)
    for transient in transients:
        bounds = transient(start)
        if all(bound.is_finite() for bound in bounds):
            bounds = tuple(bound.max(first) for bound, first in zip(bounds, before, strict=True))
            roomy = (upper_text(bound * arb(_ROOM.numerator) / _ROOM.denominator, 6) for bound in bounds)
            margin = dict(zip(plant.states, roomy, strict=True))
            if _slopes_hold(_widened(plant, margin)):
                ends = tuple((str(low), str(high)) for low, high in zip(start.lower, start.upper, strict=True))
                return Confinement("margin", margin, ends)
    return None


def before_the_first_sample(plant: Plant, start: Box) -> tuple[arb, ...]:
    """What the margin holds besides the transient, which begins after the first sample: a correction by h(x_hat) takes
    slopes between x(0) and x_hat(0), one by C takes none."""
    if plant.H is None:
        return (arb(0),) * plant.n
    return tuple(map(arb, start.sizes))


def _margin_of_its_own(plant: Plant, transients: Sequence[Transient]) -> Confinement | None:
    """A margin, and a box of initial errors, in parts of the domain's widths, whose transient does not pass it."""
    ends = (plant.domain.box.get(name, Interval(None, None)) for name in plant.states)
    widths = [None if e.lower is None or e.upper is None else float(e.upper) - float(e.lower) for e in ends]
    least = min([width for width in widths if width], default=1.0)
    sizes = [Fraction(f"{width or least:.3g}") for width in widths]
    for part in _PARTS:
        radii = tuple(Exact(size * part) for size in sizes)
        within = _margin_for(plant, transients, Box(tuple(-radius for radius in radii), radii))
        if within is not None:
            return within
    return None


def _widened(plant: Plant, margin: Mapping[str, str]) -> Plant:
    return plant.widened({name: Exact(by) for name, by in margin.items()})


def confinement_claim(plant: Plant, confinement: Confinement, transients: Sequence[Transient]) -> Claim:
    """The premise `estimate`: what is stored of the way is proved anew."""
    status, text = _judge(plant, confinement, transients)
    return Claim("estimate", "premise", status, text, SOURCE, method=confinement.way)


def noisy_confinement_claim(plant: Plant, confinement: Confinement, transients: Sequence[Transient]) -> Claim:
    """`estimate_under_noise`: the same under the declared disturbance and noise, by transients that count them."""
    status, text = _judge(plant, confinement, transients)
    statement = f"under the declared disturbance and noise, {text}"
    return Claim(UNDER_NOISE, "certificate", status, statement, SOURCE, method=confinement.way)


def _judge(plant: Plant, confinement: Confinement, transients: Sequence[Transient]) -> tuple[Status, str]:
    domain = plant.domain.text
    match confinement.way:
        case "everywhere" if holds_everywhere(plant):
            return "proved", "the slopes hold wherever the estimate goes"
        case "continuation" if _is_continued(plant):
            beyond = "outside the box of the domain the observer continues phi linearly"
            return "proved", f"{beyond}, so the slopes hold wherever the estimate goes"
        case "cut" if _slopes_hold(plant.on_box, zeros=True):
            return "proved", "the observer evaluates phi at the estimate cut to the box of the domain"
        case "margin" if _stays_within(plant, confinement, transients):
            within = f"the estimate stays within {confinement.margin_text} of the plant"
            return "proved", f"{within}, and the slopes hold so far beyond {domain}"
    return "undecided", f"it is not proved that the estimate stays in {domain}, where the slopes are"


def _stays_within(plant: Plant, confinement: Confinement, transients: Sequence[Transient]) -> bool:
    """Whether one of the transients from the initial errors of a margin does not pass it, and slopes hold within it."""
    if set(confinement.margin) != set(plant.states) or len(confinement.start) != plant.n:
        return False
    margin = [Exact(confinement.margin[name]).ball() for name in plant.states]
    start = confinement.initial_errors
    if not _is_held(before_the_first_sample(plant, start), margin):
        return False
    kept = (_is_held(transient(start), margin) for transient in transients)
    return any(kept) and _slopes_hold(_widened(plant, confinement.margin))


def _is_held(bounds: Iterable[arb], margin: Iterable[arb]) -> bool:
    return all(bound < m or (bound == 0 and m == 0) for bound, m in zip(bounds, margin, strict=True))
