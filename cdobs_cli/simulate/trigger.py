"""The next sample of an observer that chooses it: the first time its trigger reaches 0 from below.

Called with numpy's warnings off: an undefined trigger is no root.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.records import dataclass
from cdobs_cli.simulate.dormand_prince import interpolate

Trigger = Callable[[Array, Array, Array], Array]
_LOOKS = (0.25, 0.5, 0.75, 1.0)  # where a step is looked at for a crossing
FINE = 1e-8  # of a step, on the interpolant; `polished` then works on the flow itself
ITERATIONS = 150
FAR = 1e-6  # of a step: a correction beyond it, which is the interpolant's accuracy, is not taken
# A shorter one moves the state along its slope: what that leaves out is its square, 1e-14 of the change over a step.
NEAR = 1e-7


@dataclass(frozen=True)
class Along:
    """A trigger along a step of each run: from t (R,) and y (n, R) over h (R,), by dense output (7, n, R), with what is
    held (c, R)."""

    trigger: Trigger
    coefficients: Array
    y: Array
    t: Array
    h: Array
    held: Array

    def of(self, runs: Integers) -> Along:
        """The same of some of the runs."""
        coefficients, y, held = self.coefficients[:, :, runs], self.y[:, runs], self.held[:, runs]
        return Along(self.trigger, coefficients, y, self.t[runs], self.h[runs], held)

    def value(self, theta: Array) -> Array:
        """At t + theta h."""
        return self.trigger(self.t + theta * self.h, interpolate(self.coefficients, self.y, theta), self.held)

    def first_root(self) -> Array:
        """The first theta in (0, 1] with trigger >= 0, shape (R,); 2 where there is none.

        Between a look below 0 and the next at or above it the root is bracketed by regula falsi (Illinois).
        """
        runs = len(self.t)
        low, high = np.zeros(runs), np.full(runs, 2.0)
        below, above = self.value(low), np.full(runs, np.nan)
        for theta in _LOOKS:
            open_ = high > 1.0
            if not open_.any():
                break
            now = self.value(np.full(runs, theta))
            crossed, under = open_ & (now >= 0), open_ & ~(now >= 0)
            high[crossed], above[crossed] = theta, now[crossed]
            low[under], below[under] = theta, now[under]
        crosses = high <= 1.0
        if not crosses.any():
            return high
        root, least, done, last_up = high.copy(), np.abs(above), ~crosses, np.full(runs, -1)
        a, b, f_a, f_b = low, high.copy(), below.copy(), above.copy()
        for iteration in range(ITERATIONS):
            guess = b - f_b * (b - a) / (f_b - f_a)
            # A bisection now and then keeps the bracket shrinking whatever the trigger's shape.
            guess = np.where((guess > a) & (guess < b) & (iteration % 5 != 4), guess, (a + b) / 2)
            f = self.value(np.where(done, 1.0, guess))
            better = ~done & (np.abs(f) <= least)
            done = done | (b - a <= FINE) | (f == 0) | (better & (np.abs(guess - root) <= FINE))
            root, least = np.where(better, guess, root), np.where(better, np.abs(f), least)
            if done.all():
                break
            up = f >= 0
            # An end that stays twice counts half (Illinois).
            f_a = np.where(up, np.where(last_up == 1, f_a / 2, f_a), f)
            f_b = np.where(up, f, np.where(last_up == 0, f_b / 2, f_b))
            a, b, last_up = np.where(up, a, guess), np.where(up, guess, b), up.astype(int)
        return root

    def polished(self, part: Callable[[Array], tuple[Array, Array]], theta: Array) -> tuple[Array, Array]:
        """The length of the step that ends at the root, and the state there, from full steps, not dense output.

        `part(s)` is the state after one step of length s (R,), and its slope. Two Newton corrections with the
        interpolant's slope; a correction beyond the interpolant's accuracy (a root that only touches) is not taken.
        """
        back = np.maximum(theta - 1e-4, 0.0)
        slope = (self.value(theta) - self.value(back)) / ((theta - back) * self.h)
        s = theta * self.h
        state, k = part(s)
        for _ in range(2):
            change = -self.trigger(self.t + s, state, self.held) / slope
            change = np.where(np.abs(change) <= FAR * self.h, change, 0.0)
            s, near = s + change, np.abs(change) <= NEAR * self.h
            moved = np.where(change == 0.0, state, state + change * k)
            if near.all():
                state = moved
                continue
            state, again = part(s)
            state, k = np.where(near, moved, state), np.where(near, k, again)
        return s, state
