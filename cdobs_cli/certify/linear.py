"""Linear error systems sampled periodically: the constant periods at which rho(J exp(A T)) < 1.

Stability may be lost and regained as the period grows, so what is known is a list of intervals. Floats find
the ends; each interval, a little smaller, is proved for every period in it by balls of periods.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.certify.cover import covered
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import HybridInclusion

_POINTS = 1500
_CELLS, _FEW = 4000, 400
_NARROWEST = Fraction(1, 10**12)
_CLOSE = (Fraction(1, 10**6), Fraction(1, 10**4), Fraction(1, 100))
_LOOSE = (Fraction(1, 10**4), Fraction(1, 100))


@dataclass(frozen=True)
class StableInterval:
    """Every constant period in [low, high] is proved to let the error converge."""

    low: Exact
    high: Exact


def is_linear(inclusion: HybridInclusion) -> bool:
    """No uncertain slope, of the flow or of the outputs, one constant period."""
    return not (inclusion.quantities or inclusion.outputs) and inclusion.sampling.is_periodic


def stable_intervals(inclusion: HybridInclusion, shortest: float, longest: float) -> list[StableInterval]:
    """The proved intervals of constant periods in [shortest, longest], a little inside their ends, shortest first.

    Intervals narrower than a step of the grid may be missed: the list is what is proved, not all there is.
    """
    proofs = (_prove(inclusion, low, high, _LOOSE, _FEW) for low, high in _candidates(inclusion, shortest, longest))
    return [interval for interval in proofs if interval is not None]


def stable_interval(inclusion: HybridInclusion, T: float, shortest: float, longest: float) -> StableInterval | None:
    """The proved interval that holds T, close to its ends; the shortest one where T is in none."""
    candidates = _candidates(inclusion, shortest, longest)
    for low, high in sorted(candidates, key=lambda ends: not ends[0] <= T <= ends[1]):
        interval = _prove(inclusion, low, high, _CLOSE, _CELLS)
        if interval is not None:
            return interval
    return None


def _candidates(inclusion: HybridInclusion, shortest: float, longest: float) -> list[tuple[float, float]]:
    """Intervals of periods at which the spectral radius is below 1, in floats."""
    maps = inclusion.floats
    if not is_linear(inclusion) or not 0 < shortest < longest or not np.all(np.isfinite(maps.base)):
        return []

    def stable(T: float) -> bool:
        with np.errstate(all="ignore"):
            return float(spectral_radii(maps.jump @ exponentials(maps.base[None] * T))[0]) < 1

    grid = np.unique(np.concatenate([np.linspace(shortest, longest, _POINTS), np.geomspace(shortest, longest, 300)]))
    inside = np.array([stable(T) for T in grid])
    first = np.flatnonzero(inside & ~np.concatenate([[False], inside[:-1]]))
    last = np.flatnonzero(inside & ~np.concatenate([inside[1:], [False]]))
    return [
        (
            _edge(stable, float(grid[i]), float(grid[i - 1])) if i else float(grid[i]),
            _edge(stable, float(grid[k]), float(grid[k + 1])) if k + 1 < len(grid) else float(grid[k]),
        )
        for i, k in zip(first, last, strict=True)
    ]


def _edge(stable: Callable[[float], bool], inside: float, outside: float) -> float:
    for _ in range(50):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if stable(middle) else (inside, middle)
    return inside


def _prove(
    inclusion: HybridInclusion, low: float, high: float, margins: Sequence[Fraction], cells: int
) -> StableInterval | None:
    for margin in margins:
        a, b = (Fraction(decimal_text(end, 9)) for end in (Fraction(low) * (1 + margin), Fraction(high) * (1 - margin)))
        if a <= b and covered(_falls(inclusion), a, b, pieces=cells, narrowest=_NARROWEST):
            return StableInterval(Exact(a), Exact(b))
    return None


def _falls(inclusion: HybridInclusion) -> Callable[[Fraction, Fraction], bool]:
    """Whether rho(J exp(A T)) < 1 for every T in [a, b]: exp(A T) = exp(A (T - m)) exp(A m), m the middle."""
    maps = inclusion.balls

    def falls(a: Fraction, b: Fraction) -> bool:
        half = fraction_ball((b - a) / 2)
        Phi = maps.base.exp((-half).union(half)) @ maps.base.exp((a + b) / 2)
        return has_spectral_radius_below(maps.jump @ Phi)

    return falls
