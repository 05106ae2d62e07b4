"""Where the coordinates of a typed domain, box or disturbance lie: boxes and cuts that hold the image, proved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite

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
    where: list[Expression] = []
    if len(change.names) <= 3:
        for i, a in enumerate(change.names):
            for j, b in enumerate(change.names[:i]):
                for side in (1, -1):
                    where += _cuts(change, region, box, (a, i), (b, j), side)
    return Domain(box, tuple(where))


def _cuts(
    change: CoordinateMap, region: Region, box: Mapping[str, Interval], a: tuple[str, int], b: tuple[str, int], side: int
) -> list[Expression]:
    """Ends of z_a + side z_b that are tighter than those of the box."""
    first, second = box.get(a[0]), box.get(b[0])
    if first is None or second is None or None in (first.lower, first.upper, second.lower, second.upper):
        return []
    low, high = _ends(simplify(change.map[a[1]] + Number(side) * change.map[b[1]]), region)
    combined = Variable(a[0]) + Variable(b[0]) if side > 0 else Variable(a[0]) - Variable(b[0])
    opposite = -Variable(a[0]) - Variable(b[0]) if side > 0 else Variable(b[0]) - Variable(a[0])
    near, far = (second.lower, second.upper) if side > 0 else (second.upper, second.lower)
    room = 0.02 * (float(first.upper) - float(first.lower) + float(second.upper) - float(second.lower))  # type: ignore[arg-type]
    cuts = []
    if low is not None and float(low) > float(first.lower) + side * float(near) + room:  # type: ignore[arg-type]
        cuts.append(combined - low.expression)
    if high is not None and float(high) < float(first.upper) + side * float(far) - room:  # type: ignore[arg-type]
        cuts.append(opposite + high.expression)
    return cuts


def image_box(map: Sequence[Expression], region: Region, path: tuple[str, ...]) -> Box:
    ends = [_ends(one, region) for one in map]
    if any(low is None or high is None or not isfinite(float(low)) or not isfinite(float(high)) for low, high in ends):
        raise SpecError((Problem(path, "its image in the coordinates has no bound", hint="give a domain, or a tighter one"),))
    return Box(tuple(low for low, _ in ends if low is not None), tuple(high for _, high in ends if high is not None))


def image_of_disturbance(typed: TypedDynamics, change: CoordinateMap, region: Region) -> Box | None:
    """A box that holds (dT/dx) d."""
    if typed.disturbance is None:
        return None
    d = tuple(f"d.{i}" for i in range(len(typed.states)))
    ends = {name: Interval(low, high) for name, low, high in zip(d, typed.disturbance.lower, typed.disturbance.upper, strict=True)}
    held = Region.made({**region.ends, **ends}, (*region.names, *d), region.where)
    pushed = [lie_derivative(one, typed.states, [Variable(name) for name in d]) for one in change.map]
    return image_box(pushed, held, ("plant", "disturbance"))
