"""Linear error systems sampled periodically: the constant periods at which rho(J exp(A T)) < 1. Of sensors with periods
in proportion, with the gaps g_q T of a hyperperiod, those at which rho(J_0 exp(A g_(Q-1) T) .. J_1 exp(A g_0 T)) < 1.

Stability may be lost and regained as the period grows, so what is known is a list of intervals. Floats find
the ends; each interval, a little smaller, is proved for every period in it by balls of periods.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.certify.cover import covered
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.methods.base import Question

M_ = TypeVar("M_")
_POINTS, _AT_ONCE = 1500, 50
_CELLS, _FEW = 4000, 400
_NARROWEST = Fraction(1, 10**12)
_CLOSE = (Fraction(1, 10**6), Fraction(1, 10**4), Fraction(1, 100))
_BELOW, _BEYOND = 0.99, 20  # of a period: how far about it ends are looked for
_LOOSE = (Fraction(1, 10**4), Fraction(1, 100))


@dataclass(frozen=True)
class StableInterval:
    """Every constant period (of sensors: the shortest) in [low, high] is proved to let the error converge."""

    low: Exact
    high: Exact


def is_linear(inclusion: HybridInclusion) -> bool:
    """No uncertain slope, of the flow or of the outputs, one constant period or those of several sensors."""
    law = inclusion.sampling
    return not (inclusion.quantities or inclusion.outputs) and (law.is_periodic or law.is_multirate)


def is_linear_loop(question: Question) -> bool:
    """No uncertain slope, an interval of periods."""
    varies = question.inclusion.quantities or question.inclusion.outputs
    return not varies and question.law.is_bounded and not question.law.is_periodic


def gap_shares(law: SamplingLaw) -> list[Fraction]:
    """From each sample of a hyperperiod to the next, in periods; 1 where all are alike."""
    return [phase.gap for phase in law.phases] or [Fraction(1)]


def product(flows: Iterable[M_], jumps: Sequence[M_]) -> M_:
    """J_0 Phi_(m-1) .. J_1 Phi_0 of the flows of one sample after the other, the jumps of samples in turn from J_0."""
    total: Any = None
    for k, Phi in enumerate(flows, start=1):
        J: Any = jumps[k % len(jumps)]
        total = J @ Phi if total is None else J @ Phi @ total
    return total  # type: ignore[no-any-return]


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


def stable_ends(inclusion: HybridInclusion, T: float, shortest: float, longest: float) -> Iterator[Exact]:
    """Periods just inside the ends of the intervals that floats find, those of the one that holds T first, of each the
    nearest to its end first: to be proved one by one, where balls of periods are too wide for a whole hyperperiod."""
    candidates = _candidates(inclusion, shortest, longest)
    for _, high in sorted(candidates, key=lambda ends: not ends[0] <= T <= ends[1]):
        yield from (Exact(decimal_text(Fraction(high) * (1 - margin), 9)) for margin in _CLOSE)


def lost_above(inclusion: HybridInclusion, T: float) -> Iterator[Exact]:
    """Periods just above the end of the interval round T, or of the first beyond it, at which floats still see errors
    decay: the nearest to the end first."""
    ends = (high for low, high in _candidates(inclusion, T * _BELOW, T * _BEYOND) if high >= T)
    end = next(ends, T)
    yield from (Exact(decimal_text(Fraction(end) * (1 + margin), 9)) for margin in _CLOSE)


def _candidates(inclusion: HybridInclusion, shortest: float, longest: float) -> list[tuple[float, float]]:
    """Intervals of periods at which the spectral radius is below 1, in floats."""
    if not is_linear(inclusion) or not 0 < shortest < longest:
        return []
    phases, gaps = inclusion.phases_floats, np.array(gap_shares(inclusion.sampling), dtype=float)
    base, jumps = phases[0].base, [maps.jump for maps in phases]
    if not all(np.all(np.isfinite(one)) for one in (base, *jumps)):
        return []
    lengths, which = np.unique(gaps, return_inverse=True)

    def are_stable(T: Array) -> Array:
        with np.errstate(all="ignore"):
            times = (T[:, None] * lengths).ravel()
            Phi = exponentials(base * times[:, None, None]).reshape(len(T), len(lengths), *base.shape)
            return np.asarray(spectral_radii(product((Phi[:, k] for k in which), jumps)) < 1)

    def stable(T: float) -> bool:
        return bool(are_stable(np.array([T]))[0])

    grid = np.unique(np.concatenate([np.linspace(shortest, longest, _POINTS), np.geomspace(shortest, longest, 300)]))
    inside = np.concatenate([are_stable(some) for some in np.array_split(grid, len(grid) // _AT_ONCE + 1)])
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
    phases, gaps = inclusion.phases_balls, gap_shares(inclusion.sampling)
    A, jumps = phases[0].base, [maps.jump for maps in phases]

    def falls(a: Fraction, b: Fraction) -> bool:
        def over(gap: Fraction) -> Matrix:
            half = fraction_ball((b - a) / 2 * gap)
            return A.exp((-half).union(half)) @ A.exp((a + b) / 2 * gap)

        Phi = {gap: over(gap) for gap in set(gaps)}
        return has_spectral_radius_below(product((Phi[gap] for gap in gaps), jumps))

    return falls
