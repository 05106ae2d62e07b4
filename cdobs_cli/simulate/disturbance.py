"""d(t) where the plant declares a disturbance and no signal is typed: a value that is held, and drawn anew.

bounded: uniform in its box, drawn at every sample;   white: N(0, Q/h), drawn at every sub-step of length h.

A white d has no values, only increments: over a sub-step its integral is N(0, Q h), and so is that of the held value.
A sub-step adds to the state of a linear plant the covariance

    G Q G'/h,  G = int_0^h exp(A s) ds = h exp(A h/2) (I + O(h^2));  exact: int_0^h exp(A s) Q exp(A' s) ds (Van Loan),

and both are h exp(A h/2) Q exp(A' h/2) + O(h^3). Sub-steps end where samples are taken: the sampled state has the exact
covariance up to a part of order (|A| h)^2.
"""

from __future__ import annotations

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.simulate.signals import Draws, Signals, factor

PARTS = 8  # sub-steps of the longest period
_CHOSEN = 2000  # of the horizon, where the observer chooses its samples
ROUNDING = 1e-9


class Disturbance:
    """What is held of d in every run, and until when.

    values (n, R), none where a signal is typed or nothing is declared; until (R,): when a white one is drawn anew.
    """

    def __init__(self, signals: Signals, draws: Draws, runs: int, longest: float) -> None:
        """longest: of the sub-steps of a white disturbance."""
        self.draws, self.longest = draws, longest
        self.box = signals.disturbance_box
        self.white = None if signals.intensity is None else factor(signals.intensity)
        self.values = np.zeros((len(signals.held), runs))
        self.until = np.full(runs, np.inf)
        # Of the white one, by run: sub-steps drawn so far, those left until the next sample, and their length.
        self._drawn, self._left = (np.zeros(runs, dtype=np.int64) for _ in range(2))
        self._h, self._end = np.zeros(runs), np.full(runs, np.inf)

    def before(self, runs: Integers) -> Array:
        """What stands for d just before t_0, shape (n, len(runs)): a bounded one is that of the first interval."""
        return self._bounded(runs, 0) if self.box is not None else np.zeros((len(self.values), len(runs)))

    def at_sample(self, runs: Integers, index: int, t: Array, after: Array) -> None:
        """From sample number `index` of the given runs, at t, to the next one at `after` (inf: not known)."""
        if self.box is not None:
            self.values[:, runs] = self._bounded(runs, index)
        if self.white is not None:
            known = np.isfinite(after)
            parts = np.maximum(1, np.ceil(np.where(known, after - t, 0.0) / self.longest - ROUNDING))
            self._left[runs] = np.where(known, parts, np.iinfo(np.int64).max)
            self._h[runs] = np.where(known, (after - t) / parts, self.longest)
            self._end[runs] = after
            self._draw(runs, t)

    def at_sub_step(self, runs: Integers, t: Array) -> None:
        """The next sub-step of the given runs, from t."""
        self._draw(runs, t)

    def _bounded(self, runs: Integers, index: int) -> Array:
        assert self.box is not None
        lower, upper = self.box
        shares = [self.draws.at("disturbance", "uniform", i, runs, index) for i in range(len(lower))]
        d: Array = lower + (upper - lower) * np.array(shares)
        return d

    def _draw(self, runs: Integers, t: Array) -> None:
        assert self.white is not None
        h, total = self._h[runs], np.zeros((len(self.values), len(runs)))
        # Column by column: a product of matrices would round by the number of runs.
        for i in np.flatnonzero(self.white.any(axis=0)):
            total += self.white[:, [i]] * self.draws.at("disturbance", "normal", int(i), runs, self._drawn[runs])
        self.values[:, runs] = total / np.sqrt(h)
        self._drawn[runs] += 1
        self._left[runs] -= 1
        self.until[runs] = np.where(self._left[runs] > 0, t + h, self._end[runs])


def longest_sub_step(longest_period: float | None, horizon: float, max_steps: int) -> float:
    """An eighth of the longest period (None: the observer chooses), or more where a run has too many samples."""
    parts = _CHOSEN if longest_period is None else PARTS * horizon / longest_period
    return horizon / max(1.0, min(parts, max_steps / 2))
