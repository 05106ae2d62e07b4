"""Characteristics given by points: the line through them, as a sum of kinks that everything else already knows."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

from cdobs_cli.exact.expression import ZERO, Expression, ExpressionError, Number, call

MAX_POINTS = 32
USAGE = "write table(x, [[x0, y0], [x1, y1], ..]): the line through 2 to 32 points, constant beyond them"


def table(x: Expression, points: Sequence[tuple[Fraction, Fraction]]) -> Expression:
    """The line through the points (x_i, y_i), constant beyond the ends.

        f(x) = y_0 + sum_i (s_i - s_(i-1)) max(x - x_i, 0)

    with s_i the slope behind x_i, 0 before the first point and behind the last.

    Raises:
        ExpressionError: too few or too many points, or x_i that do not rise.
    """
    if not 2 <= len(points) <= MAX_POINTS:
        raise ExpressionError(f"a table has 2 to {MAX_POINTS} points, this one {len(points)}")
    if any(right <= left for (left, _), (right, _) in pairwise(points)):
        raise ExpressionError("the points of a table are in rising order of x, each x once")
    behind = [(upper - lower) / (right - left) for (left, lower), (right, upper) in pairwise(points)]
    changes = [after - before for before, after in pairwise([Fraction(0), *behind, Fraction(0)])]
    kinks = (
        Number(change) * call("max", x - Number(at), ZERO)
        for (at, _), change in zip(points, changes, strict=True)
        if change
    )
    return sum(kinks, Number(points[0][1]))
