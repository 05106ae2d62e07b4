"""Linear loops whose sampled error is planar: a polygon that every sample maps into itself, whatever the period.

z+ = M(s) z with z of two entries (`sampled_error`). Let H be a convex polygon, symmetric to 0, with vertices +-v_i and
sides n_j . x = +-1: g(x) = max_j |n_j . x| is a norm. If

    |n_j . exp(sigma s) M(s) v_i| < 1    for every s in [T_min, T_max], all i and j,

then g(z+) < exp(-sigma s) g(z) at every sample, as M(s) x is a combination of the M(s) v_i, and the error decays at
rate sigma. A polygon with enough corners serves every linear loop that is stable under the law, where forms of low
degree (`common_quadratic`) may not. In Bernstein coefficients b_k of the left hand side over a piece of the law it
is |b_k| < 1. From T_min = 0 the coefficient b_0 of the first piece is n_j . M(0) v_i, a rational, and |b_0| <= 1
suffices there: then g(z+) <= (1 - epsilon s) g(z).
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from cdobs_cli.certify.cover import covered, law_ends
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.linear import is_linear_loop
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.common_quadratic import sampled_loop
from cdobs_cli.certify.sampled_error import SampledError
from cdobs_cli.certify.taylor import ORDER, bernstein_weights, exponential
from cdobs_cli.certify.texts import rate_of, rational
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 9
_MOST = 240  # vertices of half a polygon
_PERIODS = (16, 24, 32, 48)  # of the search, by effort
_DIRECTIONS = (40, 60, 90, 120)
_STRICT = (4e-3, 2e-3, 1e-3, 5e-4)  # how much the search asks for beyond what is to be proved
_ROUNDS, _EVERY = 1500, 10
_FINE = 8  # times as many periods for the last look


@dataclass(frozen=True)
class Polygon(Method):
    """sigma; vertices: [x, y] of half the polygon, counter-clockwise."""

    sigma: str
    vertices: list[list[str]]

    name: ClassVar[str] = "polygon"
    rung: ClassVar[str] = "clock"
    source: ClassVar[str] = "polygon of sampled errors that every sample maps into itself"
    how: ClassVar[str] = "Bernstein coefficients in balls"
    statement: ClassVar[str] = "Each sample maps a polygon of errors into itself"

    @classmethod
    def applies(cls, question: Question) -> bool:
        """No uncertain slope, an interval of periods."""
        return is_linear_loop(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """Planar sampled errors only."""
        error = sampled_loop(question)
        if error is None or error.size != 2 or error.kept == 2:
            return None
        low, high = float(question.law.T_min), float(question.law.T_max)
        with np.errstate(all="ignore"):
            try:
                half = _invariant(error, low, high, float(question.rate), question.level)
            except np.linalg.LinAlgError:  # the hull collapsed to a line
                return None
        if half is None:
            return None
        vertices = [[decimal_text(float(value), _DIGITS) for value in point] for point in half]
        polygon = cls(question.law, fraction_text(question.rate), vertices)
        return polygon if polygon.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        sigma, error = rate_of(self.sigma), sampled_loop(question)
        if error is None or error.size != 2 or not 2 <= len(self.vertices) <= _MOST:
            return NOTHING
        half = [(rational(x), rational(y)) for x, y in self.vertices]
        sides = _sides(half)
        if sides is None:
            return NOTHING
        V, N = Matrix.from_rows(half).T, Matrix.from_rows(sides)
        F = error.F + Matrix.identity(error.F.shape[0]) * sigma
        corners = error.X @ V

        def inside(a: Fraction, b: Fraction) -> bool:
            coefficients = exponential(error.Y, F, corners, a, b)
            if coefficients is None:
                return False
            first = 1 if a == 0 and error.kept is not None else 0
            for weights in bernstein_weights(ORDER)[first:]:
                point = coefficients[0] * weights[0]
                for weight, coefficient in zip(weights[1:], coefficients[1:], strict=False):
                    point = point + coefficient * weight
                if not all(abs(value) < 1 for row in (N @ point).tolist() for value in row):
                    return False
            return True

        if error.kept is not None and not all(-1 <= v <= 1 for row in (N @ error.Y @ corners).tolist() for v in row):
            return NOTHING
        return Proof.of(covered(inside, *law_ends(self.law)), sigma)


def _sides(half: list[tuple[Fraction, Fraction]]) -> list[tuple[Fraction, Fraction]] | None:
    """n_j with n_j . v_j = n_j . v_(j+1) = 1 (v_(m+1) = -v_1); None unless the polygon is convex round 0."""
    around = [*half, *((-x, -y) for x, y in half)]
    count = len(around)
    sides = []
    for k in range(count):
        (x, y), (x2, y2), (x3, y3) = around[k], around[(k + 1) % count], around[(k + 2) % count]
        area = x * y2 - y * x2
        turn = (x2 - x) * (y3 - y2) - (y2 - y) * (x3 - x2)
        if not area > 0 or not turn > 0:
            return None
        sides.append(((y2 - y) / area, (x - x2) / area))
    # Turning left at each of its corners it could still go round several times: one turn, by half planes.
    if not all(half[0][0] * y - half[0][1] * x > 0 for x, y in half[1:]):
        return None
    return sides[: len(half)]


# The search, in floats: the hull of what the maps make of a small polygon.


def _invariant(error: SampledError, low: float, high: float, sigma: float, level: int) -> Array | None:
    F, X, Y = (matrix.floats for matrix in (error.F, error.X, error.Y))
    count = _PERIODS[level]
    periods = low + (high - low) * (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2

    def maps_at(periods: Array) -> Array:
        at: Array = Y @ exponentials((F + sigma * np.eye(len(F))) * periods[:, None, None]) @ X
        return at

    maps = maps_at(periods)
    if not np.all(np.isfinite(maps)) or not np.all(spectral_radii(maps[1:]) < 1):
        return None
    # From T_min = 0 the loop is asked to shrink in proportion to s.
    from_zero = low == 0
    share = periods / high if from_zero else np.ones(count)
    maps = maps * (1 + _STRICT[level] * share)[:, None, None]
    S = _balance(maps)
    maps = np.linalg.inv(S) @ maps @ S
    fine = np.linspace(low, high, _FINE * count)
    judged = maps_at(fine), (fine / high if from_zero else np.ones(len(fine))) * _STRICT[level] / 4
    angles = np.pi * np.arange(_DIRECTIONS[level]) / _DIRECTIONS[level]
    start = directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = start
    for number in range(1, _ROUNDS + 1):
        images = (maps[:, None] @ points[None, :, :, None]).reshape(-1, 2)
        everything = np.concatenate([start, points, images])
        if not np.all(np.isfinite(everything)) or np.abs(everything).max() > 1e6:
            return None
        # Directions even in the coordinates of the points themselves: a thin hull keeps its corners.
        around = directions @ np.linalg.inv(np.linalg.cholesky(points.T @ points))
        heights = np.abs(around @ everything.T)
        settled = heights.max(axis=1) <= np.abs(around @ points.T).max(axis=1) * (1 + 1e-9)
        points = everything[np.unique(np.argmax(heights, axis=1))]
        if number % _EVERY == 0:
            half = _half(points @ S.T)
            for candidate in (
                [] if half is None else _closed_at_zero(half, judged[0][0]) if from_zero and error.kept == 1 else [half]
            ):
                if _is_mapped_inside(candidate, *judged):
                    return candidate
            if settled.all():
                return None
    return None


def _is_mapped_inside(half: Array, maps: Array, margins: Array) -> bool:
    """Whether each map keeps the polygon inside of itself by its margin, in floats."""
    following = np.concatenate([half[1:], -half[:1]])
    area = half[:, 0] * following[:, 1] - half[:, 1] * following[:, 0]
    sides = np.stack([following[:, 1] - half[:, 1], half[:, 0] - following[:, 0]], axis=1) / area[:, None]
    reach = np.abs(sides @ maps @ half.T).max(axis=(1, 2))
    return bool(np.all(reach <= 1 - margins + 1e-13 * (margins == 0)))


def _closed_at_zero(half: Array, M_0: Array) -> list[Array]:
    """From T_min = 0 with M(0) = diag(1, j): the polygon with what M(0) makes of its corners, and then with the corner
    on the kept axis standing out a little."""
    on_axis = half * np.array([1.0, 0.0])
    # A little too far: rounded, it still holds the image.
    moved = half * np.array([1.0, M_0[1, 1] * (1 + 1e-6)])
    closed = _half(np.concatenate([half, moved, on_axis]))
    if closed is None:
        return []
    reach = _crossing(closed)
    made = [_half(np.concatenate([closed, [[reach * (1 + share), 0.0]]])) for share in (1e-5, 1e-4, 1e-3, 1e-2)]
    return [closed, *(one for one in made if one is not None)]


def _crossing(half: Array) -> float:
    """Where the polygon's boundary meets the first axis."""
    x, y = np.concatenate([half, -half[:1]]).T
    ends = np.flatnonzero((y[:-1] * y[1:] <= 0) & (y[:-1] != y[1:]))
    k = int(ends[0])
    return float(abs(x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k])))


def _balance(maps: Array) -> Array:
    """Coordinates in which the maps are of one size."""
    total = np.eye(2)
    for _ in range(50):
        following = np.eye(2) + np.mean(maps.transpose(0, 2, 1) @ total @ maps, axis=0)
        total = following / np.trace(following) * 2
    if not np.all(np.isfinite(total)) or np.linalg.cond(total) > 1e10:
        return np.eye(2)
    inverse: Array = np.linalg.inv(np.linalg.cholesky(total)).T
    return inverse


def _half(points: Array) -> Array | None:
    """The convex hull of the points and their negatives: its vertices over half a turn, counter-clockwise."""
    both = np.unique(np.round(np.concatenate([points, -points]) / np.abs(points).max(), _DIGITS - 1), axis=0)
    chain: list[Any] = []
    for ordered in (both, both[::-1]):
        part: list[Any] = []
        for point in ordered:
            while len(part) > 1 and _turn(part[-2], part[-1], point) <= 1e-12:
                part.pop()
            part.append(point)
        chain += part[:-1]
    half = np.array(chain[: len(chain) // 2])
    return half if len(chain) % 2 == 0 and 2 <= len(half) <= _MOST else None


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]))
