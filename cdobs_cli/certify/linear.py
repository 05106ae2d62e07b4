"""Linear error systems sampled periodically: the constant periods at which rho(J exp(A T)) < 1.

Stability may be lost and regained as the period grows, so what is known is a list of intervals. Floats find
the ends; each interval, a little smaller, is proved for every period in it by balls of periods.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import HybridInclusion

_POINTS = 1500
_CELLS = 4000
_INSIDE = (Fraction(1, 10**6), Fraction(1, 10**4), Fraction(1, 100))


@dataclass(frozen=True)
class StableInterval:
    """Every constant period in [low, high] is proved to let the error converge."""

    low: Exact
    high: Exact


def is_linear(inclusion: HybridInclusion) -> bool:
    """No uncertain slope, one constant period."""
    return not inclusion.quantities and inclusion.sampling.is_periodic


def stable_intervals(inclusion: HybridInclusion, shortest: float, longest: float) -> list[StableInterval]:
    """The proved intervals of constant periods in [shortest, longest], shortest periods first.

    Intervals narrower than a step of the grid may be missed: the list is what is proved, not all there is.
    """
    import numpy as np

    from cdobs_cli.certify.floats import exponentials, spectral_radii

    maps = inclusion.floats
    if not is_linear(inclusion) or not 0 < shortest < longest or not np.all(np.isfinite(maps.base)):
        return []

    def stable(T: float) -> bool:
        with np.errstate(all="ignore"):
            return float(spectral_radii(maps.jump @ exponentials(maps.base[None] * T))[0]) < 1

    grid = np.unique(np.concatenate([np.linspace(shortest, longest, _POINTS), np.geomspace(shortest, longest, 300)]))
    with np.errstate(all="ignore"):
        radii = np.array([spectral_radii(maps.jump @ exponentials(maps.base[None] * T))[0] for T in grid])
    inside = radii < 1
    found = []
    k = 0
    while k < len(grid):
        if not inside[k]:
            k += 1
            continue
        last = k
        while last + 1 < len(grid) and inside[last + 1]:
            last += 1
        low = _edge(stable, float(grid[k]), float(grid[k - 1])) if k else float(grid[k])
        high = _edge(stable, float(grid[last]), float(grid[last + 1])) if last + 1 < len(grid) else float(grid[last])
        interval = _prove(inclusion, low, high)
        if interval is not None:
            found.append(interval)
        k = last + 1
    return found


def _edge(stable: Callable[[float], bool], inside: float, outside: float) -> float:
    for _ in range(50):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if stable(middle) else (inside, middle)
    return inside


def _prove(inclusion: HybridInclusion, low: float, high: float) -> StableInterval | None:
    for margin in _INSIDE:
        a = Exact(decimal_text(Fraction(low) * (1 + margin), 9))
        b = Exact(decimal_text(Fraction(high) * (1 - margin), 9))
        if (
            a.rational is not None
            and b.rational is not None
            and a.rational <= b.rational
            and _covers(inclusion, a.rational, b.rational)
        ):
            return StableInterval(a, b)
    return None


def _covers(inclusion: HybridInclusion, low: Fraction, high: Fraction) -> bool:
    """rho(J exp(A T)) < 1 for every T in [low, high], by adaptive cells: exp(A T) = exp(A (T - m)) exp(A m)."""
    maps = inclusion.balls
    stack = [(low, high)]
    for _ in range(_CELLS):
        if not stack:
            return True
        a, b = stack.pop()
        middle = (a + b) / 2
        half = fraction_ball((b - a) / 2)
        Phi = maps.base.exp((-half).union(half)) @ maps.base.exp(middle)
        if has_spectral_radius_below(maps.jump @ Phi):
            continue
        if b - a <= Fraction(1, 10**12) * high or not has_spectral_radius_below(maps.jump @ maps.base.exp(middle)):
            return False
        stack += [(a, middle), (middle, b)]
    return False


def interval_of(intervals: list[StableInterval], T: Exact) -> StableInterval | None:
    """The interval that holds T."""
    value = float(T)
    return next((interval for interval in intervals if float(interval.low) <= value <= float(interval.high)), None)
