"""The convex region over which a nonlinearity is judged: states in their domain, inputs in their ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf

from cdobs_cli.bounds.ranges import LINE, Range, range_of
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.plant import Interval, Plant


@dataclass(frozen=True)
class Region:
    """{z : lower <= z <= upper, w(z) >= 0 for every w of `where`}: convex, since each w is affine.

    `box` holds the exact ends, or dyadic ends just outside irrational ones: a superset, which is sound for
    proofs; `holds` asks the true ends, which is sound for refutations. `relaxed`: the region stands for another
    one, in other variables or without some limits, and its points say nothing.
    """

    box: Mapping[str, Range]
    ends: Mapping[str, Interval]
    where: tuple[Expression, ...] = ()
    relaxed: bool = False

    @staticmethod
    def of(plant: Plant) -> Region:
        """All states and inputs of a plant; without a range a name has the whole line."""
        ends = dict(plant.domain.box)
        ends |= {source.name: source.range for source in plant.inputs if source.range is not None}
        return Region.made(ends, plant.states + tuple(source.name for source in plant.inputs), plant.domain.where)

    @staticmethod
    def made(ends: Mapping[str, Interval], names: tuple[str, ...], where: tuple[Expression, ...]) -> Region:
        """A region over `names`, unbounded where no ends are given."""
        return Region({name: _range(ends[name]) if name in ends else LINE for name in names}, dict(ends), where)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.box)

    @property
    def unbounded(self) -> tuple[str, ...]:
        """Names without two finite ends."""
        return tuple(name for name, ends in self.box.items() if not ends.is_finite)

    def over(self, expression: Expression) -> Region:
        """What the region says of the variables of an expression alone: their ends, and the limits on only these."""
        names = expression.variables
        ends = {name: interval for name, interval in self.ends.items() if name in names}
        return Region.made(ends, tuple(sorted(names)), tuple(w for w in self.where if w.variables <= names))

    def holds(self, point: Mapping[str, Fraction]) -> bool:
        """Whether a rational point is proved to lie in the region."""
        for name, interval in self.ends.items():
            if interval.lower is not None and not _at_most(interval.lower, point[name]):
                return False
            if interval.upper is not None and not _at_most(-interval.upper, -point[name]):
                return False
        values = {name: fraction_ball(value) for name, value in point.items()}
        exact = {name: Range.point(value) for name, value in point.items()}
        return all(w.ball(values) >= 0 or range_of(w, exact).lower >= 0 for w in self.where)

    def text(self) -> str:
        """The region in a sentence's words."""
        parts = [f"{name} in {interval}" for name, interval in self.ends.items()]
        parts += [f"{w} >= 0" for w in self.where]
        free = [name for name in self.box if name not in self.ends]
        if free:
            parts.append(f"{', '.join(free)} in R")
        return ", ".join(parts)


def _range(interval: Interval) -> Range:
    def end(value: Exact | None, side: int) -> Fraction | float:
        if value is None:
            return side * inf
        if value.rational is not None:
            return value.rational
        ball = Range.of_ball(value.ball())
        return ball.lower if side < 0 else ball.upper

    return Range(end(interval.lower, -1), end(interval.upper, 1))


def _at_most(low: Exact, value: Fraction) -> bool:
    return low.rational <= value if low.rational is not None else bool(low.ball() <= fraction_ball(value))


def point_text(point: Mapping[str, Fraction]) -> dict[str, str]:
    """A point as exact decimals or fractions."""
    return {name: fraction_text(value) for name, value in point.items()}
