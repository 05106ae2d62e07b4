"""Does the plant stay in the domain on which the slopes are proved?

A side is closed where the field points strictly inwards all over it, at least at some speed. Where the field may be
tangent, Nagumo's condition needs solutions to be unique near the side, on both of its sides: there the field must be
Lipschitz (x' = -sqrt(max(-x, 0)) is tangent at 0 and still leaves [0, 1]).
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import product

from cdobs_cli.bounds.bounded import TRIAL, bounded
from cdobs_cli.bounds.definedness import defined, is_total
from cdobs_cli.bounds.points import high_points
from cdobs_cli.bounds.ranges import Point
from cdobs_cli.bounds.region import Region, point_balls, point_witness
from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.exact.rational import simplify
from cdobs_cli.plant import Interval, Plant
from cdobs_cli.records import dataclass

SOURCE = "Nagumo's condition on a convex set"
# How far beyond the domain the field is looked at, in parts of each state's range (of 1 where it has no two ends).
_BEYOND = (Fraction(1, 64), Fraction(1, 4096))


@dataclass(frozen=True)
class Face:
    """A side of the domain: its name, the region it is, the speed at which solutions leave through it, and the
    coordinate that was eliminated (its value on the face), if one was; whether a white disturbance moves across it."""

    name: str
    region: Region
    outward: Expression
    solved: tuple[str, Expression] | None = None
    is_shaken: bool = False


def faces(plant: Plant) -> Iterator[Face]:
    """Every finite side of the domain, with the outward speed  n(x)' (A x + phi + B u + d)."""
    region = Region.of(plant)
    if plant.disturbance is not None:
        region = region.beside([f"d.{i}" for i in range(plant.n)], plant.disturbance)
    # A white disturbance has no bound: it is looked at side by side.
    field = plant.right_hand_side(disturbed=plant.disturbance is not None)
    f = dict(zip(plant.states, field, strict=True))
    for name, interval in plant.domain.box.items():
        for end, outward in ((interval.lower, -f[name]), (interval.upper, f[name])):
            if end is not None:
                side = Region.made({**region.ends, name: Interval(end, end)}, region.names, region.where)
                yield Face(f"{name} = {end}", side, outward, is_shaken=_is_shaken(plant, Variable(name)))
    for k, w in enumerate(plant.domain.where):
        outward = sum((-w.derivative(name) * f[name] for name in plant.states), ZERO)
        name = next(name for name in plant.states if simplify(w.derivative(name)) != ZERO)
        solved = simplify(-w.substitute({name: ZERO}) / w.derivative(name))
        ends = dict(region.ends)
        limits = _limits(ends.pop(name, None), Variable(name))
        others = (*(v for j, v in enumerate(region.where) if j != k), *limits)
        where = (simplify(v.substitute({name: solved})) for v in others)
        names = tuple(other for other in region.names if other != name)
        side = Region.made(ends, names, tuple(v for v in where if not isinstance(v, Number)))
        yield Face(f"{w} = 0", side, outward.substitute({name: solved}), (name, solved), _is_shaken(plant, w))


def _is_shaken(plant: Plant, w: Expression) -> bool:
    """Whether a white disturbance moves an affine w of the states: g' Q g > 0 for its gradient g."""
    if plant.intensity is None:
        return False
    g = [Exact(simplify(w.derivative(name))) for name in plant.states]
    pairs = product(range(plant.n), repeat=2)
    return sum((g[i] * plant.intensity[i, j] * g[j] for i, j in pairs), EXACT_ZERO).sign() != 0


def _limits(interval: Interval | None, variable: Expression) -> Iterator[Expression]:
    """What is >= 0 in the interval."""
    if interval is not None and interval.lower is not None:
        yield variable - interval.lower.expression
    if interval is not None and interval.upper is not None:
        yield interval.upper.expression - variable


def domain_invariant(plant: Plant) -> Claim:
    """No solution of the plant leaves the domain: on each of its sides the outward speed is below 0, or at most 0
    where the field is Lipschitz around the domain.

    An assumption: slopes proved over the domain say something of solutions that stay there. Refuted with a point of a
    side through which the solution leaves at once.
    """
    open_sides: list[str] = []
    tangent: list[str] = []
    shaken: list[str] = []
    for face in faces(plant):
        found = _leaving(face)
        if found is not None:
            leaves = f"solutions leave through {face.name}"
            return _claim(plant, "refuted", leaves, point_witness(found, side=face.name))
        if face.is_shaken:
            shaken.append(face.name)
            continue
        speed = bounded(face.outward, face.region, EXACT_ZERO, TRIAL)
        if speed.status != "proved":
            open_sides.append(face.name)
        elif not speed.value < 0:
            tangent.append(face.name)
    if shaken:
        through = ", ".join(shaken)
        return _claim(plant, "undecided", f"the white disturbance moves it through {through} sooner or later")
    if open_sides:
        return _claim(plant, "undecided", f"the side {', '.join(open_sides)} is open")
    if tangent and not _is_lipschitz_around(plant):
        reason = f"the field is tangent at {', '.join(tangent)}, and no Lipschitz bound was found around the domain"
        return _claim(plant, "undecided", reason)
    return _claim(plant, "proved", None)


def _is_lipschitz_around(plant: Plant) -> bool:
    """Whether the field has locally bounded slopes on some neighbourhood of the domain: it and its derivatives, as
    typed, are proved to be defined there (at kinks the Clarke gradient is)."""
    f = plant.right_hand_side()
    judged = dict.fromkeys([*f, *(one.derivative(name) for one in f for name in plant.states)])
    smooth = [one for one in judged if not is_total(one)]
    for part in _BEYOND if smooth else ():
        region = Region.of(plant.widened({name: _room(plant, name) * part for name in plant.states}))
        if all(defined(one, region).status == "proved" for one in smooth):
            return True
    return not smooth


def _room(plant: Plant, name: str) -> Fraction:
    """The width of a state's range; 1 where it has no two rational ends."""
    interval = plant.domain.box.get(name, Interval(None, None))
    ends = [end.rational if end is not None else None for end in (interval.lower, interval.upper)]
    if ends[0] is None or ends[1] is None or ends[0] == ends[1]:
        return Fraction(1)
    return ends[1] - ends[0]


def _leaving(face: Face) -> Point | None:
    for point in high_points(face.outward, face.region):
        if face.outward.ball(point_balls(point)) > 0 and face.region.holds(point):
            if face.solved is None:
                return point
            name, value = face.solved
            exact = value.substitute({other: Number(at) for other, at in point.items()})
            if isinstance(simplify(exact), Number):
                return {**point, name: simplify(exact).value}  # type: ignore[attr-defined]
    return None


def _claim(plant: Plant, status: Status, reason: str | None, witness: Witness | None = None) -> Claim:
    text = f"the plant stays in {plant.domain.text} once it is there, where the slopes are proved"
    return Claim(
        "domain_invariant", "assumption", status, text if reason is None else f"{text}: {reason}", SOURCE,
        method="branch and bound on every side", witness=witness,
    )  # fmt: skip
