"""Are two expressions the same function? Identity by canonical form, difference by a point."""

from __future__ import annotations

from cdobs_cli.bounds.points import high_points
from cdobs_cli.bounds.ranges import Point
from cdobs_cli.bounds.region import Region, point_balls
from cdobs_cli.certificate import Status
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.rational import is_zero, simplify
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Comparison:
    """proved: the same; refuted: they differ at `point` of the region."""

    status: Status
    point: Point | None = None


def compared(a: Expression, b: Expression, region: Region) -> Comparison:
    """Whether a = b over the region."""
    difference = a - b
    if is_zero(difference):
        return Comparison("proved")
    short = simplify(difference)
    for side in (short, -short):
        for point in high_points(side, region):
            ball = difference.ball(point_balls(point))
            if (ball > 0 or ball < 0) and region.holds(point):
                return Comparison("refuted", point)
    return Comparison("undecided")
