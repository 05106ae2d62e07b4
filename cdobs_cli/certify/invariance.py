"""Do the states stay in the domain on which the slopes are proved?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.certify.bounded import TRIAL, bounded
from cdobs_cli.certify.points import high_points, point_balls
from cdobs_cli.certify.region import Region, point_text
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable
from cdobs_cli.exact.numbers import EXACT_ZERO
from cdobs_cli.exact.rational import simplify
from cdobs_cli.plant import Interval, Plant

SOURCE = "Nagumo's condition on a convex set"


@dataclass(frozen=True)
class Face:
    """A side of the domain: its name, the region it is, the speed at which solutions leave through it, and the
    coordinate that was eliminated (its value on the face), if one was."""

    name: str
    region: Region
    outward: Expression
    solved: tuple[str, Expression] | None = None


def faces(plant: Plant) -> Iterator[Face]:
    """Every finite side of the domain, with the outward speed  n(x)' (A x + phi + B u + d)."""
    region = Region.of(plant)
    if plant.disturbance is not None:
        ends = {
            f"d.{i}": Interval(low, high)
            for i, (low, high) in enumerate(zip(plant.disturbance.lower, plant.disturbance.upper, strict=True))
        }
        region = Region.made({**region.ends, **ends}, (*region.names, *ends), region.where)
    f = dict(zip(plant.states, plant.right_hand_side(disturbed=True), strict=True))
    for name, interval in plant.domain.box.items():
        for end, outward in ((interval.lower, -f[name]), (interval.upper, f[name])):
            if end is not None:
                side = Region.made({**region.ends, name: Interval(end, end)}, region.names, region.where)
                yield Face(f"{name} = {end}", side, outward)
    for k, w in enumerate(plant.domain.where):
        outward = ZERO
        for name in plant.states:
            outward = outward - w.derivative(name) * f[name]
        name = next(name for name in plant.states if simplify(w.derivative(name)) != ZERO)
        solved = simplify(-w.substitute({name: ZERO}) / w.derivative(name))
        others = tuple(v for j, v in enumerate(region.where) if j != k)
        limits = _limits(region.ends.get(name), Variable(name))
        where = tuple(simplify(v.substitute({name: solved})) for v in (*others, *limits))
        rest = {other: ends for other, ends in region.ends.items() if other != name}
        side = Region.made(
            rest, tuple(other for other in region.names if other != name), tuple(v for v in where if not isinstance(v, Number))
        )
        yield Face(f"{w} = 0", side, outward.substitute({name: solved}), (name, solved))


def _limits(interval: Interval | None, variable: Expression) -> tuple[Expression, ...]:
    if interval is None:
        return ()
    low = () if interval.lower is None else (variable - interval.lower.expression,)
    high = () if interval.upper is None else (interval.upper.expression - variable,)
    return low + high


def domain_invariant(plant: Plant) -> Claim:
    """No solution leaves the domain: on each of its sides the outward speed is at most 0.

    Not required: it is the condition under which slopes proved over the domain say something of solutions.
    Refuted with a point of a side through which the solution leaves at once.
    """
    status: Status = "proved"
    open_sides, witness = [], None
    for face in faces(plant):
        found = _leaving(face)
        if found is not None:
            witness = Witness("point", "plant", data={"point": point_text(found), "side": face.name})
            return _claim(plant, "refuted", f"solutions leave through {face.name}", witness)
        if bounded(face.outward, face.region, EXACT_ZERO, TRIAL).status != "proved":
            status = "undecided"
            open_sides.append(face.name)
    return _claim(plant, status, f"the side {', '.join(open_sides)} is open" if open_sides else None, witness)


def _leaving(face: Face) -> Mapping[str, Fraction] | None:
    for point in high_points(face.outward, face.region):
        if face.outward.ball(point_balls(point)) > 0 and face.region.holds(point):
            if face.solved is None:
                return point
            name, value = face.solved
            exact = value.substitute({other: Number(at) for other, at in point.items()})
            if isinstance(simplify(exact), Number):
                return {**point, name: simplify(exact).value}  # type: ignore[attr-defined]
    return None


def _claim(plant: Plant, status: Status, reason: str | None, witness: Witness | None) -> Claim:
    text = f"solutions that start in {Region.of(plant).text()} stay there (the slopes are proved there; the estimate must stay there too)"
    return Claim(
        "domain_invariant", "premise", status, text if reason is None else f"{text}: {reason}", SOURCE,
        method="branch and bound on every side", witness=witness,
    )  # fmt: skip
