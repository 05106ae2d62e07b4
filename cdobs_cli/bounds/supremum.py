"""Branch and bound: is f <= c over a convex region? Every leaf is decided in outward arithmetic.

Over a box X with centre m the bound is the least of the range of f, the mean-value form

    f(x) <= f(m) + sum_j sup g_j(X) (X_j - m_j),      g_j = d f / d x_j,

the same with affine limits w(x) >= 0 of the region taken in by multipliers lambda >= 0 (f <= f + lambda w
inside the region, and the slopes of the sum cancel along the limit), and either of them on the face on
which f is largest where it is monotone. Boxes are split where g_j times the width is largest (smear).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from math import inf, isfinite
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.arrays import Array
from cdobs_cli.bounds import boxes
from cdobs_cli.bounds.boxes import Ends, Evaluator, Jet
from cdobs_cli.bounds.ranges import Point, Range, range_of
from cdobs_cli.bounds.region import Region
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.shapes import End
from cdobs_cli.records import dataclass

CHUNK, ROUND = 2048, 100
PATIENCE = 8
_NEAR = 1e-9


@dataclass(frozen=True)
class Bounded:
    """f <= value was proved (inf: nothing). `point` is a point where f seems to exceed c; `box` what is left."""

    status: Literal["proved", "undecided"]
    value: float
    point: Point | None = None
    box: Mapping[str, tuple[float, float]] | None = None


class _Search:
    def __init__(self, forms: Sequence[Expression], region: Region, limit: Exact) -> None:
        self.region, self.limit, self.forms = region, limit, tuple(forms)
        self.evaluators = [Evaluator(form, region.names) for form in forms]
        self.c_low, self.c_high = boxes.outside(limit.ball())
        self.near = self.c_high + _NEAR * (1e-3 + abs(self.c_high))
        self.w = [_Affine(w, region.names) for w in region.where]

    def first(self) -> Ends:
        ends = [(_outside(one.lower)[0], _outside(one.upper)[1]) for one in self.region.box.values()]
        low, high = np.array(ends).reshape(1, -1, 2).transpose(2, 0, 1)
        return low, high

    def run(self, budget: int) -> Bounded:
        low, high = self.first()
        upper, decided = np.array([inf]), -inf
        count, patience = 0, PATIENCE
        while len(low):
            if count >= budget:
                return self.left(low, high, upper, decided)
            order = np.argsort(-upper, kind="stable")
            take, keep = order[:CHUNK], order[CHUNK:]
            X, rest = (low[take], high[take]), (low[keep], high[keep], upper[keep])
            # A round on few boxes costs as much as one on many.
            count += max(len(take), ROUND)
            X = self.contract(X)
            if not len(X[0]):
                low, high, upper = rest
                continue
            step = self.judge(X)
            if step.point is not None:
                return Bounded("undecided", inf, step.point)
            still = step.open
            decided = max(decided, float(np.max(np.where(still, -inf, step.upper), initial=-inf)))
            upper = np.concatenate([step.upper[still], rest[2]])
            new, parents = _split_up((X[0][still], X[1][still]), step.smear[still])
            # Only boxes that touch c are left, and exact ends do not decide them: splitting seldom helps.
            patience -= bool(np.max(upper, initial=-inf) <= self.near)
            if new is None or (patience <= 0 and len(upper)):
                low, high = (np.vstack([X[k][still], rest[k]]) for k in (0, 1))
                return self.left(low, high, upper, decided)
            low, high = (np.vstack([rest[k], new[k]]) for k in (0, 1))
            upper = np.concatenate([rest[2], step.upper[still][parents]])
        return Bounded("proved", min(decided, self.c_high))

    def left(self, low: Array, high: Array, upper: Array, decided: float) -> Bounded:
        # Every box that is not decided counts: the largest of their bounds is a bound of f.
        worst = int(np.argmax(upper))
        box = {name: (float(low[worst, j]), float(high[worst, j])) for j, name in enumerate(self.region.names)}
        return Bounded("undecided", max(decided, float(upper[worst])), None, box)

    def contract(self, X: Ends) -> Ends:
        for w in self.w:
            X = w.contract(X)
        kept = ~np.any(X[0] > X[1], axis=1)
        return X[0][kept], X[1][kept]

    def judge(self, X: Ends) -> _Step:
        low, high = X
        middle = _middle(low, high)
        upper, at_middle = np.full(len(low), inf), np.full(len(low), -inf)
        smear, width = np.zeros_like(low), high - low
        grown, shrunk = np.zeros(low.shape, dtype=bool), np.zeros(low.shape, dtype=bool)
        for jet, value, bound in self.forms_over(X, middle):
            at_middle = np.maximum(at_middle, value[0])
            upper = np.minimum(upper, bound)
            for j in range(low.shape[1]):
                g = jet.gradient.get(j)
                if g is None:
                    # f does not depend on x_j.
                    grown[:, j] = True
                    continue
                grown[:, j] |= g[0] >= 0
                shrunk[:, j] |= g[1] <= 0
                with np.errstate(all="ignore"):
                    size = np.maximum(np.abs(g[0]), np.abs(g[1]))
                    smear[:, j] = np.fmax(smear[:, j], size * width[:, j])
        point = self.exceeding(middle, at_middle)
        still = ~(upper <= self.c_low)
        if point is None and np.any(still):
            face = (np.where(grown, high, low), np.where(shrunk & ~grown, low, high))
            part = np.flatnonzero(still & np.any(grown | shrunk, axis=1))
            if len(part):
                upper[part] = np.minimum(upper[part], self.on_face((face[0][part], face[1][part])))
                still = ~(upper <= self.c_low)
            for k in np.flatnonzero(still & (upper <= self.near))[:64]:
                if self.exactly(face[0][k], face[1][k]):
                    upper[k], still[k] = self.c_high, False
        return _Step(upper, still, smear, point)

    def on_face(self, X: Ends) -> Array:
        return reduce(np.minimum, (bound for _, _, bound in self.forms_over(X, _middle(*X), limits=False)))

    def forms_over(self, X: Ends, middle: Array, *, limits: bool = True) -> Iterator[tuple[Jet, Ends, Array]]:
        """For each form its jet, its value at the middle, and an upper bound over each box."""
        for evaluator in self.evaluators:
            jet, value = evaluator.jet(*X), evaluator.value(middle, middle)
            yield jet, value, np.minimum(jet.value[1], self.mean_value(X, middle, jet, value, self.w if limits else ()))

    def mean_value(self, X: Ends, middle: Array, jet: Jet, value: Ends, limits: Sequence[_Affine]) -> Array:
        """Upper end of the mean-value form."""
        low, high = X
        count, n = low.shape
        zero = (np.zeros(count), np.zeros(count))
        with np.errstate(all="ignore"):
            from_middle = [boxes.add((low[:, j], high[:, j]), (-middle[:, j], -middle[:, j])) for j in range(n)]
            gradient = [jet.gradient.get(j, zero) for j in range(n)]
            best = _form(value, gradient, from_middle)
            for w in limits:
                at_middle = w.value((middle, middle))
                for g, slope in zip(gradient, w.slopes, strict=True):
                    if slope == (0.0, 0.0):
                        continue
                    multiplier = np.maximum(0.0, -(g[0] + g[1]) / (2 * slope[0]))
                    multiplier = np.where(np.isfinite(multiplier), multiplier, 0.0)
                    factor = (multiplier, multiplier)
                    raised = boxes.add(value, boxes.multiply(factor, at_middle))
                    turned = [boxes.add(gradient[i], boxes.multiply(factor, w.slope(i, count))) for i in range(n)]
                    best = np.fmin(best, _form(raised, turned, from_middle))
        return best

    def exceeding(self, middle: Array, at_middle: Array) -> dict[str, Fraction] | None:
        if self.region.relaxed:
            return None
        high = np.flatnonzero(at_middle > self.c_high)
        for k in high[np.argsort(-at_middle[high])][:8]:
            point = {name: Fraction(float(middle[k, j])) for j, name in enumerate(self.region.names)}
            if self.region.holds(point):
                return point
        return None

    def exactly(self, low: Array, high: Array) -> bool:
        """f <= c on a face in exact ends: decides boxes on which c is attained at an end of the region."""
        ranges = {}
        for (name, one), *face in zip(self.region.box.items(), low, high, strict=True):
            exact = ((end, _outside(end)[side]) for end, side in ((one.upper, 1), (one.lower, 0)))
            known = {outward: end for end, outward in exact if isinstance(end, Fraction)}
            values = (float(value) for value in face)
            ranges[name] = Range(*(known.get(at, Fraction(at) if isfinite(at) else at) for at in values))
        upper = (range_of(form, ranges).upper for form in self.forms)
        return any(isinstance(end, Fraction) and Exact(end).is_at_most(self.limit) for end in upper)


@dataclass(frozen=True)
class _Step:
    upper: Array
    open: NDArray[np.bool_]
    smear: Array
    point: dict[str, Fraction] | None


def _outside(end: End) -> tuple[float, float]:
    """The nearest floats outside an end."""
    return boxes.outside(fraction_ball(end)) if isinstance(end, Fraction) else (end, end)


def _form(value: Ends, gradient: Sequence[Ends], from_middle: Sequence[Ends]) -> Array:
    steps = (boxes.multiply(g, step) for g, step in zip(gradient, from_middle, strict=True))
    return reduce(boxes.add, steps, value)[1]


def _middle(low: Array, high: Array) -> Array:
    """A point of each box; the finite end, or 0, where it is unbounded."""
    with np.errstate(all="ignore"):
        middle = np.clip(low / 2 + high / 2, low, high)
    both = np.isinf(low) & np.isinf(high)
    middle = np.where(np.isinf(low) & ~both, high, np.where(np.isinf(high) & ~both, low, middle))
    return np.where(both, 0.0, middle)


def _split_up(X: Ends, smear: Array) -> tuple[Ends | None, NDArray[np.intp]]:
    """Two halves of each box, and of these again while they are few; None where a box is as small as floats allow.
    And the box that each is a part of."""
    parts, parents = _split(X, smear), np.tile(np.arange(len(smear)), 2)
    width = X[1] - X[0]
    while parts is not None and 0 < 2 * len(parents) <= ROUND:
        with np.errstate(all="ignore"):
            share = (parts[1] - parts[0]) / width[parents]
        further = _split(parts, smear[parents] * np.where(np.isnan(share), 1.0, share))
        if further is None:
            break
        parts, parents = further, np.tile(parents, 2)
    return parts, parents


def _split(X: Ends, smear: Array) -> Ends | None:
    """Two halves of each box; None where a box is as small as floats allow."""
    low, high = X
    if not len(low):
        return low, high
    width = high - low
    # An unbounded side first, then infinite slopes by width, then the smear.
    relative = width / (1e-300 + np.max(np.where(np.isfinite(width), width, 0.0), axis=1, keepdims=True))
    score = np.where(np.isnan(smear), 0.0, smear)
    best = np.max(score, axis=1, keepdims=True)
    by_width = np.where((score == 0) & (best > 0), 0.0, relative)
    score = np.where(np.isfinite(best) & (best > 0), score, by_width)
    score = np.where(np.isinf(width) & (smear != 0), inf, score)
    axis = np.argmax(score, axis=1)
    rows = np.arange(len(low))
    a, b = low[rows, axis], high[rows, axis]
    with np.errstate(all="ignore"):
        cut = a / 2 + b / 2
        cut = np.where(np.isinf(a) & np.isinf(b), 0.0, cut)
        cut = np.where(np.isinf(b) & np.isfinite(a), np.maximum(1.0, 4 * a), cut)
        cut = np.where(np.isinf(a) & np.isfinite(b), np.minimum(-1.0, 4 * b), cut)
    if np.any((cut <= a) | (cut >= b)):
        return None
    left_high, right_low = high.copy(), low.copy()
    left_high[rows, axis], right_low[rows, axis] = cut, cut
    return np.vstack([low, right_low]), np.vstack([left_high, high])


class _Affine:
    """w(x) = w_0 + sum_j w_j x_j as outward floats."""

    def __init__(self, w: Expression, names: Sequence[str]) -> None:
        slopes = [w.derivative(name) for name in names]
        if any(slope.variables for slope in slopes):
            raise ValueError(f"{w} is not affine")
        origin = {name: fraction_ball(Fraction(0)) for name in names}
        self.offset = boxes.outside(w.ball(origin))
        self.slopes = [boxes.outside(slope.ball({})) for slope in slopes]

    def slope(self, j: int, count: int) -> Ends:
        return boxes.full(self.slopes[j], count)

    def parts(self, X: Ends) -> list[Ends]:
        count = len(X[0])
        return [
            boxes.full(self.offset, count),
            *(boxes.multiply(self.slope(j, count), (X[0][:, j], X[1][:, j])) for j in range(X[0].shape[1])),
        ]

    def value(self, X: Ends) -> Ends:
        return reduce(boxes.add, self.parts(X))

    def contract(self, X: Ends) -> Ends:
        """The part of each box that w >= 0 leaves (a superset of it, as a box; reversed ends where empty)."""
        low, high = X[0].copy(), X[1].copy()
        with np.errstate(all="ignore"):
            parts = self.parts((low, high))
            empty = self.value((low, high))[1] < 0
            for j in range(low.shape[1]):
                if self.slopes[j] == (0.0, 0.0) or self.slopes[j][0] * self.slopes[j][1] <= 0:
                    continue
                # w_j x_j >= -rest, at best -sup rest.
                most = reduce(boxes.add, (*parts[: j + 1], *parts[j + 2 :]))[1]
                edge = boxes.multiply((-most, -most), boxes.inverse(self.slope(j, len(low))))
                if self.slopes[j][0] > 0:
                    low[:, j] = np.where(np.isfinite(most), np.maximum(low[:, j], edge[0]), low[:, j])
                else:
                    high[:, j] = np.where(np.isfinite(most), np.minimum(high[:, j], edge[1]), high[:, j])
        low[empty], high[empty] = 0.0, -1.0
        return low, high


def supremum(forms: Sequence[Expression], region: Region, limit: Exact, budget: int) -> Bounded:
    """Decide f <= limit over the region, within `budget` boxes.

    Args:
        forms: expressions of the same function f; each box takes the best of them.
    """
    return _Search(forms, region, limit).run(budget)
