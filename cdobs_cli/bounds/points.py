"""Points of a region where an expression is large: candidates in floats, for proofs in balls."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import reduce
from math import inf

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.bounds.ranges import Point, Range, value_at
from cdobs_cli.bounds.region import Region
from cdobs_cli.exact.budget import spend
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression

_FIRST = 2048
_ROUNDS = 12


def high_points(expression: Expression, region: Region) -> Iterator[dict[str, Fraction]]:
    """Rational points of the region with large values of `expression`, the most promising form first.

    Corners, scattered points of all magnitudes where an end is infinite, and a contracting random search
    round the best one. Deterministic. Yields the best point in short and in full decimals; nothing where no
    point of the region was met.
    """
    names = region.names
    if not names:
        yield {}
        return
    function = compile_floats((expression, *region.where), names, arrays=True)
    random = np.random.default_rng(20)

    def judged(points: Array) -> Array:
        with np.errstate(all="ignore"):
            columns = (np.asarray(column, dtype=float) for column in function(*points.T))
            value, *limits = (np.broadcast_to(column, points.shape[:1]) for column in columns)
        inside = reduce(np.logical_and, (limit >= -1e-15 for limit in limits), np.isfinite(value))
        return np.where(inside, value, -inf)

    ends = np.array([(float(one.lower), float(one.upper)) for one in region.box.values()])
    low, high = ends.T
    points = _scattered(region, random, _FIRST)
    points = np.vstack([points, _pushed_inside(points[: _FIRST // 4], region, low, high)])
    values = judged(points)
    for r in range(_ROUNDS):
        order = np.argsort(values)[::-1][:16]
        points, values = points[order], values[order]
        if not np.isfinite(values[0]):
            return
        spread = np.where(np.isfinite(high - low), high - low, 1 + np.abs(points[0])) * 0.4 ** (r + 1)
        steps = random.standard_normal((16, 12, len(names))) * spread * (random.random((16, 12, len(names))) < 0.6)
        moved = np.clip((points[:, None, :] + steps).reshape(-1, len(names)), low, high)
        points, values = np.vstack([points, moved]), np.concatenate([values, judged(moved)])
    for best in points[np.argsort(values)[::-1][:3]]:
        for digits in (3, 6, 12):
            yield {name: _near(value, digits, region, name) for name, value in zip(names, best, strict=True)}
        yield {name: Fraction(float(value)) for name, value in zip(names, best, strict=True)}


def _pushed_inside(points: Array, region: Region, low: Array, high: Array) -> Array:
    """Points moved onto the limits that they violate, in turn: met where a region is a small part of its box."""
    if not region.where:
        return points[:0]
    rates = [w.derivative(name) for w in region.where for name in region.names]
    slopes = compile_floats(rates, region.names, arrays=True)
    spend(3000 * len(region.where))
    limits = [compile_floats((w,), region.names, arrays=True) for w in region.where]
    with np.errstate(all="ignore"):
        normals = np.array([float(value) for value in slopes(*points[0])]).reshape(len(region.where), len(region.names))
        for _ in range(40):
            for k, normal in enumerate(normals):
                violation = np.minimum(0.0, np.broadcast_to(limits[k](*points.T)[0], points.shape[:1]))
                step = violation[:, None] * normal / max(float(normal @ normal), 1e-300)
                points = np.clip(points - 1.01 * step, low, high)
    return points[np.all(np.isfinite(points), axis=1)]


def _near(value: float, digits: int, region: Region, name: str) -> Fraction:
    ends = region.box[name]
    for end in (ends.lower, ends.upper):
        if isinstance(end, Fraction) and abs(float(end) - value) <= 10.0**-digits * max(1e-3, abs(value)):
            return end
    return Fraction(f"{value:.{digits}g}")


def _scattered(region: Region, random: np.random.Generator, count: int) -> Array:
    columns = []
    for ends in region.box.values():
        if ends.is_finite:
            low, high = float(ends.lower), float(ends.upper)
            column = random.uniform(low, high, count)
            near = random.random(count) < 0.5
            # A power law towards either end meets the steep places next to a pole outside the region.
            part = random.random(count) ** 6 * (high - low)
            column = np.where(near, np.where(random.random(count) < 0.5, low + part, high - part), column)
            column = np.where(random.random(count) < 0.25, random.choice([low, high, (low + high) / 2], count), column)
        else:
            size = 10 ** random.uniform(-3, 6, count) * (random.random(count) > 0.05)
            size = np.where(random.random(count) < 0.5, random.uniform(0, 10, count), size)
            if np.isfinite(float(ends.lower)):
                column = float(ends.lower) + size
            elif np.isfinite(float(ends.upper)):
                column = float(ends.upper) - size
            else:
                column = size * random.choice([-1.0, 1.0], count)
        columns.append(column)
    return np.array(columns).reshape(len(region.box), count).T


def largest_met(function: Expression, region: Region, points: Iterable[Point]) -> tuple[Range, Point] | None:
    """The largest value met at those of the points that are in the region, and its point."""
    each = {tuple(point.items()): point for point in points}.values()  # many candidates are the same corner
    values = [(value_at(function, point), point) for point in each if region.holds(point)]
    known = (one for one in values if isinstance(one[0].lower, Fraction))
    return max(known, key=lambda one: one[0].lower, default=None)
