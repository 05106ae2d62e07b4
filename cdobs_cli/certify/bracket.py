"""The two ends of a period bracket: the largest period proved, the smallest refuted above it.

Only proofs move an end. Nothing is assumed monotone: a proof at T speaks for T (or for the law up to T),
and what lies between two tested periods stays open.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TypeVar

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.falsify import refute
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import HybridInclusion

T_ = TypeVar("T_")

_DIGITS = 9
_GROWTH = (1.3, 1.15, 1.07, 1.03)  # by effort: the step of the scan for a first refutation
_WIDTH = 4e-6  # relative width down to which the first refutation is pressed
_SPAN = 1e4  # how far above the start the scan looks


def smallest_refuted(at: Callable[[Exact], HybridInclusion], proved: Exact | None, effort: int) -> tuple[Exact, Witness] | None:
    """The smallest period found above `proved` with a proved refutation, and its witness.

    Scans upwards in steps, then bisects between the last period that survived and the first that did not.

    Args:
        at: the inclusion with its sampling law at a given period (or largest period).
        proved: where to start; None starts far below the fastest time constant of the error flow.
        effort: 0..3, finer steps and a stronger search at each period.
    """
    start = float(proved) if proved is not None else _fast_time(at)
    if not 0 < start < 1e12:
        return None
    growth = _GROWTH[max(0, min(effort, 3))]
    low, high, witness = start, start, None
    while witness is None:
        low, high = high, high * growth
        if high > start * _SPAN:
            return None
        T = short_period(high)
        witness = refute(at(T), effort)
    best = (T, witness)
    while high - low > _WIDTH * high:
        middle = (low + high) / 2
        T = short_period(middle)
        found = refute(at(T), effort) if float(T) > start else None
        if found is None:
            low = middle
        else:
            high, best = middle, (T, found)
    return best


def largest_proved(prove: Callable[[Exact], T_ | None], low: Exact, high: Exact, tolerance: Fraction) -> tuple[Exact, T_] | None:
    """The largest period found in [low, high] with a proof, and the proof; None where `low` has none.

    Bisects on proofs to the relative width `tolerance`; points are short decimals (ends are kept as given).
    """
    at_high = prove(high)
    if at_high is not None:
        return high, at_high
    at_low = prove(low)
    if at_low is None:
        return None
    best = (low, at_low)
    below, above = float(low), float(high)
    while above - below > float(tolerance) * above:
        middle = (below * above) ** 0.5 if below > 0 and above > 4 * below else (below + above) / 2
        T = short_period(middle)
        found = prove(T)
        if found is None:
            above = middle
        else:
            below, best = middle, (T, found)
    return best


def short_period(T: float) -> Exact:
    """A period as a short decimal."""
    return Exact(decimal_text(T, _DIGITS))


def _fast_time(at: Callable[[Exact], HybridInclusion]) -> float:
    """A thousandth of the fastest time constant of the flow at the corners."""
    import numpy as np

    maps = at(Exact(1)).floats
    spread = np.abs(maps.base)
    for left, right, low, high in zip(maps.left, maps.right, maps.lower, maps.upper, strict=True):
        spread = spread + np.abs(left @ right) * max(abs(low), abs(high))
    size = float(np.linalg.norm(spread, 2)) if np.all(np.isfinite(spread)) else 0.0
    return 1e-3 / size if size > 0 else 1e-3
