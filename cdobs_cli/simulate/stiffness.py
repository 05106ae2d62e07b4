"""Is a flow stiff: is the explicit method kept from longer steps by stability, not by accuracy?

The last two stages of a step are evaluated at the same time, so their difference sees the fastest rate:

    rho = h |f(t + h, z_12) - f(t + h, z_11)| / |z_12 - z_11|

Steps that accuracy chooses have rho well below 1 at these tolerances, steps that stability chooses stay near the end
of the region of stability, about 6. Source: HairerWanner1996, IV.2.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.simulate.dormand_prince import A

LOOK = 16  # steps between two looks
# Steps left to the next sample, for each run where the horizon can be reached (implicit runs go one after the other,
# explicit ones all at once), and where it cannot: an implicit flow takes about a hundred, each of the time of fifteen.
_LONG, _SHORT = 1000, 20
MAX_RUNS = 200  # of more, each could take too few implicit steps to get further than explicitly
_AT_THE_END = 4.0  # of the region of stability: a step that was just cut is somewhat inside
_MANY, _FEW = 15, 6  # looks that decide, and looks in a row that start the count anew
_LAST = np.array(A[11])


class Stiffness:
    """What was seen of each run so far: looks at a step that stability chose, and looks since at another."""

    def __init__(self, runs: int, together: int, most: int) -> None:
        """together: the runs that share the work; most: steps that a run may take."""
        self.runs, self.most = together, most
        self.bound, self.free = np.zeros(runs, dtype=np.int64), np.zeros(runs, dtype=np.int64)

    def worth_a_look(self, left: Any, rest: Any, h: Any) -> Any:
        """Could an implicit method save anything, at steps h, with `left` to the next sample and `rest` to the horizon
        (floats or arrays)?"""
        saves = (left > _LONG * self.runs * h) | ((left > _SHORT * h) & (rest > self.most * h))
        return saves & (self.runs <= MAX_RUNS)

    def found(self, runs: Integers, h: Array, y: Array, new: Array, slopes: Array, floor: Array) -> Booleans:
        """Which of the runs are stiff, after steps h (R',) from y to new (n, R') with slopes (13, n, R'); states are
        weighed by `floor` (n, R')."""
        bound = ratio(h, y, new, slopes, floor) > _AT_THE_END
        self.bound[runs] += bound
        self.free[runs] = np.where(bound, 0, self.free[runs] + 1)
        self.bound[runs[self.free[runs] >= _FEW]] = 0
        stiff: Booleans = self.bound[runs] >= _MANY
        return stiff


def ratio(h: Array, y: Array, new: Array, slopes: Array, floor: Array) -> Array:
    """rho of the displayed equation, shape (R',); nan where the two stages are the same."""
    stage = y + h * np.tensordot(_LAST, slopes[: len(_LAST)], 1)
    rise, run = (slopes[12] - slopes[11]) / floor, (new - stage) / floor
    rho: Array = h * np.sqrt((rise * rise).sum(axis=0) / (run * run).sum(axis=0))
    return rho
