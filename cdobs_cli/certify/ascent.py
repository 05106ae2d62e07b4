"""Searches that follow a margin and its derivatives, in place of proofs of one guess after another: to where it ends
along one number, and to the gain for which it ends furthest.

What is looked for is the largest v with m(x, v) >= 0, m the margin of the best certificate that a program finds. Its
end v*(x) has, where m is smooth,

    v*(x) = v - m / m_v to first order near the end,    dv*/dx = -m_x / m_v.

Nothing is proved here: what a search returns is rounded and handed to a proof.
Source: NocedalWright2006, chapters 4 and 6 (a quasi-Newton ascent within a trust region)
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, inf, isfinite, log
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ROUNDS = 24
_SPAN = 1e3
_NEAR = 0.1  # how far from the end the first-order estimate of it is taken
_FIRST, _LARGEST, _SMALLEST = 0.2, 1.0, 1e-3  # radius of the trust region, in parts of the scale
_STANDING = 1e-7  # of the room: a step that is none
_GOOD, _POOR = 0.7, 0.1  # parts of the promised rise


@dataclass(frozen=True)
class Height:
    """m and its derivatives by x (k,) and by v."""

    margin: float
    by_point: Array
    by_value: float

    @property
    def rest(self) -> float:
        """How far v is from the end, to first order; infinite where m does not fall."""
        return -self.margin / self.by_value if self.by_value < 0 else inf

    def in_logarithm(self, v: float) -> Height:
        """The same with ln v in the place of v."""
        return Height(self.margin, self.by_point, self.by_value * v)

    @property
    def gradient(self) -> Array:
        """Of the end by x."""
        slope: Array = -self.by_point / self.by_value
        return slope


def end(
    margin: Callable[[float], Height | None], start: float, width: float, step: float, least: float = 0.0
) -> float | None:
    """A v >= 0 with m(v) > 0 within about the relative width of where m ends; None where there is none down to `least`.

    By Newton's steps, none longer than `step` v, until there is one v with m > 0 and one without; then by the cubic
    through the two and their derivatives. Ends are looked for a quarter of the width inside."""
    inside: tuple[float, Height] | None = None
    outside: tuple[float, Height | None] | None = None
    v, side, again = start, False, False
    for _ in range(_ROUNDS):
        here = margin(v)
        again = side == (here is not None and here.margin > 0)
        side = here is not None and here.margin > 0
        if here is not None and here.margin > 0:
            inside = (v, here)
            if here.rest <= width * v:
                break
        else:
            outside = (v, here)
            if v <= least:
                return None
        if inside is not None and outside is not None:
            low, high = inside[0], outside[0]
            if high - low <= width * high:
                break
            aim = _between(*inside, *outside) - width / 4 * high
            if again:  # flat on one side and steep on the other, the cubic creeps
                aim = (aim + (high if side else low)) / 2
            v = min(max(aim, low + (high - low) / 50), high - (high - low) / 50)
        else:
            rest = -inf if here is None else here.rest if isfinite(here.rest) else here.margin * inf
            longest = step * v if v > 0 else inf
            v = max(v + min(max(rest, -longest / (1 + step)), longest), least) * (1 - width / 4)
            v = max(v, least)
            if not isfinite(v):
                return None
    return None if inside is None else inside[0]


def _between(low: float, inside: Height, high: float, outside: Height | None) -> float:
    """Where the cubic through m and its derivatives at both ends is 0, the middle where one is not known; at least
    where the tangent at the outer end is."""
    if outside is None or outside.margin == 0:
        return (low + high) / 2
    h = high - low
    a, b, c, d = inside.margin, inside.by_value * h, outside.margin, outside.by_value * h
    cubic = np.array([2 * a + b - 2 * c + d, -3 * a - 2 * b + 3 * c - d, b, a])
    roots = np.roots(cubic)
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-9 and 0 < root.real < 1]
    met = low + h * (min(real) if real else a / (a - c))
    # Inside the margin may be flat and end steeply: then the tangent from outside tells more.
    return max(met, high + outside.rest) if outside.by_value < 0 else met


@dataclass
class Ascent:
    """The x of the largest end, from a gain or another; what is known of its curvature serves the next, finer run.

    Ends are compared by their logarithms.

    Attributes:
        height: m at (x, v); None where there is no answer.
        scale: sizes of the entries of x that count as alike, shape (k,).
        width: relative rises below it are not looked for.
        steps: programs that may be solved.
        goal: an end that is enough.
    """

    height: Callable[[Array, float], Height | None]
    scale: Array
    width: float
    steps: int
    goal: float = inf
    inverse: Array | None = None

    def run(self, x: Array, v: float) -> tuple[Array, float] | None:
        """x and about its end, from an x with an end near v; None where no end is met."""
        met = self._near_end(x, v)
        if met is None:
            return None
        here, top = met
        H = np.diag(self.scale**2) if self.inverse is None else self.inverse
        radius = _FIRST
        while self.steps > 0 and radius > _SMALLEST and top < log(self.goal):
            step = H @ here.gradient
            length = float(np.linalg.norm(step / self.scale))
            if not length > 0:
                break
            if self.inverse is None or length > radius:
                step, length = step * (radius / length), radius
            rise = float(here.gradient @ step)
            if rise < self.width:
                break
            guess = top + min(rise, _NEAR) / 2
            there = self._at(x + step, guess)
            if there is None or not abs(there.rest) <= _NEAR:
                radius = length / 3
                continue
            reached = guess + there.rest
            H = _updated(H, step, here.gradient - there.gradient, first=self.inverse is None)
            self.inverse = H
            if reached - top > _GOOD * rise:
                radius = min(max(radius, 2 * length), _LARGEST)
            elif reached - top < _POOR * rise:
                radius = length / 3
            if reached > top:
                x, here, top = x + step, there, reached
        return x, exp(top)

    def _at(self, x: Array, value: float) -> Height | None:
        """The height at the logarithm of v, differentiated by it; None where it does not fall."""
        self.steps -= 1
        here = self.height(x, exp(value))
        if here is None or not here.by_value < 0 or not isfinite(here.margin):
            return None
        return here.in_logarithm(exp(value))

    def _near_end(self, x: Array, v: float) -> tuple[Height, float] | None:
        """The height near the end, and the end as it tells."""
        met: dict[float, Height | None] = {}

        def asked(value: float) -> Height | None:
            self.steps -= 1
            met[value] = self.height(x, value)
            return met[value]

        if end(asked, v, _NEAR / 4, 1.0, v / _SPAN) is None:
            return None
        # Well inside the margin may be flat: of both sides what tells the nearest end.
        heights = {value: here.in_logarithm(value) for value, here in met.items() if here is not None}
        near = min(heights, key=lambda value: abs(heights[value].rest))
        here = heights[near]
        return (here, log(near) + here.rest) if abs(here.rest) <= _NEAR else None


def _updated(H: Array, s: Array, q: Array, *, first: bool) -> Array:
    """The inverse of -d2v*/dx2 after a step s along which the gradient fell by q: positive definite, H q = s. Source:
    NocedalWright2006, (6.17) and (6.20)."""
    curvature = float(s @ q)
    if not curvature > 1e-10 * float(np.linalg.norm(s) * np.linalg.norm(q)):
        return H
    if first:
        H = H * (curvature / float(q @ H @ q))
    left = np.eye(len(s)) - np.outer(s, q) / curvature
    updated: Array = left @ H @ left.T + np.outer(s, s) / curvature
    return updated


def highest(
    rise: Callable[[Array], tuple[float, Array]], room: Array, first: float, steps: int = 30, width: float = 1e-13
) -> tuple[float, Array]:
    """The largest value met from 0 on, and where, of a function that gives its value and its slope (k,).

    Quasi-Newton steps (BFGS), cut at the walls of the room (k, 2); where there is no value, -inf, steps are cut too.
    (SciPy's minimisers take longer to load than most of these climbs take.)

    Args:
        first: length of the first step's largest entry.
        width: a rise that is none.
    """
    x = np.zeros(len(room))
    best, slope = rise(x)
    steepest = float(np.abs(slope).max())
    if not (isfinite(best) and steepest > 0):
        return best, x
    H = np.eye(len(room)) * (first / steepest)
    while steps > 0:
        held = ((x <= room[:, 0]) & (slope < 0)) | ((x >= room[:, 1]) & (slope > 0))  # by a wall
        aim = np.where(held, 0.0, (H * ~held) @ np.where(held, 0.0, slope))
        step = np.clip(x + aim, room[:, 0], room[:, 1]) - x
        value, after = rise(x + step)
        steps -= 1
        while steps > 0 and not value > best and np.abs(step).max() > _STANDING * np.ptp(room):
            step, steps = step / 4, steps - 1
            value, after = rise(x + step)
        if not value > best:
            break
        change, gained = slope - after, value - best
        x, best, slope = x + step, value, after
        if gained < width:
            break
        H = _updated(H, step, change, first=False)
    return best, x
