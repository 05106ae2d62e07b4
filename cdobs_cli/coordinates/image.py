"""Where the coordinates of a typed domain, box or disturbance lie: boxes and cuts that hold the image, proved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TypeGuard

from cdobs_cli.bounds.bounded import TRIAL, least_bound
from cdobs_cli.bounds.region import Region
from cdobs_cli.coordinates.lie import lie_derivative
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.expression import Expression, Number, Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.rational import simplify
from cdobs_cli.plant import Box, CoordinateMap, Domain, Interval, TypedDynamics

# Images are supersets in any case: a hundredth of their width is close enough.
COARSE = 0.01
Sides = Mapping[str, Interval]


def _ends(function: Expression, region: Region) -> tuple[Exact | None, Exact | None]:
    """Proved ends of a function over a region."""
    low, high = (least_bound(side, region, COARSE, TRIAL) for side in (-function, function))
    return None if low is None else -Exact(low), None if high is None else Exact(high)


def image_domain(change: CoordinateMap, region: Region) -> Domain:
    """A box that holds the image, and the sums and differences of two coordinates where they cut it."""
    box: dict[str, Interval] = {}
    for name, one in zip(change.names, change.map, strict=True):
        low, high = _ends(one, region)
        if low is not None or high is not None:
            box[name] = Interval(low, high)
    pairs = [(i, j, side) for i in range(len(change.names)) for j in range(i) for side in (1, -1)]
    found = (_cuts(change, region, box, *pair) for pair in (pairs if len(change.names) <= 3 else ()))
    return Domain(box, tuple(cut for cuts in found for cut in cuts))


def _cuts(change: CoordinateMap, region: Region, box: Sides, i: int, j: int, side: int) -> list[Expression]:
    """Ends of z_i + side z_j that are tighter than those of the box."""
    a, b = (change.names[k] for k in (i, j))
    known = [end for name in (a, b) if name in box for end in (box[name].lower, box[name].upper) if end is not None]
    if len(known) < 4:
        return []
    low, high = _ends(simplify(change.map[i] + Number(side) * change.map[j]), region)
    combined = Variable(a) + Variable(b) if side > 0 else Variable(a) - Variable(b)
    opposite = -Variable(a) - Variable(b) if side > 0 else Variable(b) - Variable(a)
    first_low, first_high, *second = map(float, known)
    near, far = second if side > 0 else second[::-1]
    room = 0.02 * (first_high - first_low + second[1] - second[0])
    cuts = []
    if low is not None and float(low) > first_low + side * near + room:
        cuts.append(combined - low.expression)
    if high is not None and float(high) < first_high + side * far - room:
        cuts.append(opposite + high.expression)
    return cuts


def _is_finite(end: Exact | None) -> TypeGuard[Exact]:
    return end is not None and isfinite(float(end))


def image_box(map: Sequence[Expression], region: Region, path: tuple[str, ...]) -> Box:
    ends = [_ends(one, region) for one in map]
    low, high = (tuple(filter(_is_finite, side)) for side in zip(*ends, strict=True))
    if len(low) < len(ends) or len(high) < len(ends):
        what = "its image in the coordinates has no bound"
        raise SpecError((Problem(path, what, hint="give a domain, or a tighter one"),))
    return Box(low, high)


def image_of_disturbance(typed: TypedDynamics, change: CoordinateMap, region: Region) -> Box | None:
    """A box that holds (dT/dx) d."""
    if typed.disturbance is None:
        return None
    d = tuple(f"d.{i}" for i in range(len(typed.states)))
    held = region.beside(d, typed.disturbance)
    pushed = [lie_derivative(one, typed.states, [Variable(name) for name in d]) for one in change.map]
    return image_box(pushed, held, ("plant", "disturbance"))
