"""The refuted end of a period bracket: the smallest period refuted above what is proved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cdobs_cli.certificate import Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.falsify import refute
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridInclusion

_GROWTH = (1.3, 1.15, 1.07, 1.03)  # by effort: the step of the scan for a first refutation
_WIDTH = 4e-6  # relative width down to which the first refutation is pressed


def smallest_refuted(
    at: Callable[[Exact], HybridInclusion], proved: Exact | None, effort: int
) -> tuple[Exact, Witness] | None:
    """The smallest period found above `proved` with a proved refutation, and its witness.

    Args:
        at: the inclusion with its sampling law at a given period (or largest period).
        proved: where to start; None starts far below the fastest time constant of the error flow.
        effort: 0..3, finer steps and a stronger search at each period.
    """
    start = float(proved) if proved is not None else _fast_time(at)
    return search.smallest(lambda T: refute(at(T), effort), start, _GROWTH[max(0, min(effort, 3))], _WIDTH)


def _fast_time(at: Callable[[Exact], HybridInclusion]) -> float:
    """A thousandth of the fastest time constant of the flow at the corners."""
    maps = at(Exact(1)).floats
    spread = np.abs(maps.base)
    for part, low, high in zip(maps.parts, maps.lower, maps.upper, strict=True):
        spread = spread + np.abs(part) * max(abs(low), abs(high))
    size = float(np.linalg.norm(spread, 2)) if np.all(np.isfinite(spread)) else 0.0
    return 1e-3 / size if size > 0 else 1e-3
