"""The convex region over which a nonlinearity is judged: states in their domain, inputs in their ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf

from flint import arb

from cdobs_cli.bounds.ranges import LINE, Point, Range, value_at
from cdobs_cli.certificate import Witness
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.plant import Box, Interval, Plant, TypedDynamics
from cdobs_cli.records import dataclass

# All that a region is, to be remembered by: box, ends, limits, whether it is relaxed.
Content = tuple[tuple[tuple[str, Range], ...], tuple[tuple[str, Interval], ...], tuple[Expression, ...], bool]


@dataclass(frozen=True)
class Region:
    """{z : lower <= z <= upper, w(z) >= 0 for every w of `where`}: convex, since each w is affine.

    `box` holds the exact ends, or dyadic ends just outside irrational ones: a superset, which is sound for
    proofs; `holds` asks the true ends, which is sound for refutations. `relaxed`: the region stands for another
    one, in other variables or without some limits, and its points say nothing.
    """

    box: dict[str, Range]
    ends: Mapping[str, Interval]
    where: tuple[Expression, ...] = ()
    relaxed: bool = False

    @staticmethod
    def of(plant: Plant | TypedDynamics) -> Region:
        """All states and inputs of a plant; without a range a name has the whole line."""
        ends = dict(plant.domain.box)
        ends |= {source.name: source.range for source in plant.inputs if source.range is not None}
        return Region.made(ends, plant.states + tuple(source.name for source in plant.inputs), plant.domain.where)

    @staticmethod
    def made(ends: Mapping[str, Interval], names: tuple[str, ...], where: tuple[Expression, ...]) -> Region:
        """A region over `names`, unbounded where no ends are given."""
        return Region({name: _range(ends[name]) if name in ends else LINE for name in names}, dict(ends), where)

    @property
    def content(self) -> Content:
        return tuple(self.box.items()), tuple(self.ends.items()), self.where, self.relaxed

    @staticmethod
    def of_content(content: Content) -> Region:
        box, ends, where, relaxed = content
        return Region(dict(box), dict(ends), where, relaxed)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.box)

    @property
    def unbounded(self) -> tuple[str, ...]:
        """Names without two finite ends."""
        return tuple(name for name, ends in self.box.items() if not ends.is_finite)

    def beside(self, names: Sequence[str], box: Box) -> Region:
        """The region with more variables, in a box."""
        ends = {name: Interval(low, high) for name, low, high in zip(names, box.lower, box.upper, strict=True)}
        return Region.made({**self.ends, **ends}, (*self.names, *names), self.where)

    def over(self, expression: Expression) -> Region:
        """What the region says of the variables of an expression alone: their ends, and the limits on only these."""
        names = expression.variables
        ends = {name: interval for name, interval in self.ends.items() if name in names}
        return Region.made(ends, tuple(sorted(names)), tuple(w for w in self.where if w.variables <= names))

    def holds(self, point: Point) -> bool:
        """Whether a rational point is proved to lie in the region."""
        for name, interval in self.ends.items():
            at = Exact(point[name])
            if interval.lower is not None and not interval.lower.is_at_most(at):
                return False
            if interval.upper is not None and not at.is_at_most(interval.upper):
                return False
        return all(w.ball(point_balls(point)) >= 0 or value_at(w, point).lower >= 0 for w in self.where)

    def text(self) -> str:
        """The region in a sentence's words."""
        parts = [f"{name} in {interval}" for name, interval in self.ends.items()]
        parts += [f"{w} >= 0" for w in self.where]
        free = [name for name in self.box if name not in self.ends]
        if free:
            parts.append(f"{', '.join(free)} in R")
        return ", ".join(parts)


def _range(interval: Interval) -> Range:
    low, high = (None if end is None else _held(end) for end in (interval.lower, interval.upper))
    return Range(-inf if low is None else low.lower, inf if high is None else high.upper)


def _held(value: Exact) -> Range:
    return Range.of_ball(value.ball()) if value.rational is None else Range.point(value.rational)


def point_balls(point: Point) -> dict[str, arb]:
    """The point for `Expression.ball`."""
    return {name: fraction_ball(value) for name, value in point.items()}


def point_witness(point: Point | None, **more: str) -> Witness | None:
    """A point of the plant's domain as a witness, in exact decimals or fractions."""
    if point is None:
        return None
    return Witness("point", "plant", data={"point": {name: fraction_text(at) for name, at in point.items()}, **more})
