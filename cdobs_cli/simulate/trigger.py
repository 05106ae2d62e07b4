"""The next sample of an observer that chooses it: the first time its trigger reaches 0 from below.

Called with numpy's warnings off: an undefined trigger is no root.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.simulate.dormand_prince import interpolate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Trigger = Callable[[Array, Array, Array], Array]

_LOOKS = (0.25, 0.5, 0.75, 1.0)  # where a step is looked at for a crossing
_FINE = 1e-8  # of a step, on the interpolant; `polished` then works on the flow itself
_ITERATIONS = 150


def first_root(trigger: Trigger, coefficients: Array, y: Array, t: Any, h: Any, held: Array) -> Array:
    """The first theta in (0, 1] with trigger >= 0 at t + theta h, by dense output; 2 where there is none.

    coefficients (7, n, R), y (n, R), t and h (R,) or numbers, held (c, R); returns (R,). Between a look
    below 0 and the next at or above it the root is bracketed by regula falsi (Illinois).
    """
    runs = y.shape[1]

    def value(theta: Array) -> Array:
        return trigger(t + theta * h, interpolate(coefficients, y, theta), held)

    low, high = np.zeros(runs), np.full(runs, 2.0)
    below, above = value(low), np.full(runs, np.nan)
    for theta in _LOOKS:
        open_ = high > 1.0
        if not open_.any():
            break
        now = value(np.full(runs, theta))
        crossed, under = open_ & (now >= 0), open_ & ~(now >= 0)
        high[crossed], above[crossed] = theta, now[crossed]
        low[under], below[under] = theta, now[under]
    found = high <= 1.0
    if not found.any():
        return high
    root, least, done, last_up = high.copy(), np.abs(above), ~found, np.full(runs, -1)
    a, b, f_a, f_b = low, high.copy(), below.copy(), above.copy()
    for iteration in range(_ITERATIONS):
        guess = b - f_b * (b - a) / (f_b - f_a)
        # A bisection now and then keeps the bracket shrinking whatever the trigger's shape.
        guess = np.where((guess > a) & (guess < b) & (iteration % 5 != 4), guess, (a + b) / 2)
        f = value(np.where(done, 1.0, guess))
        better = ~done & (np.abs(f) <= least)
        done = done | (b - a <= _FINE) | (f == 0) | (better & (np.abs(guess - root) <= _FINE))
        root, least = np.where(better, guess, root), np.where(better, np.abs(f), least)
        if done.all():
            break
        up = f >= 0
        # An end that stays twice counts half (Illinois).
        f_a = np.where(up, np.where(last_up == 1, f_a / 2, f_a), f)
        f_b = np.where(up, f, np.where(last_up == 0, f_b / 2, f_b))
        a, b, last_up = np.where(up, a, guess), np.where(up, guess, b), up.astype(int)
    return root


def polished(
    trigger: Trigger,
    part: Callable[[Array], Array],
    coefficients: Array,
    y: Array,
    t: Array,
    h: Array,
    theta: Array,
    held: Array,
) -> tuple[Array, Array]:
    """The length of the step that ends at the root, and the state there, from full steps instead of dense output.

    `part(s)` is the state after one step of length s (R,). Two Newton corrections with the interpolant's
    slope; a correction beyond the interpolant's accuracy (a root that only touches) is not taken.
    """
    back = np.maximum(theta - 1e-4, 0.0)
    rise = trigger(t + theta * h, interpolate(coefficients, y, theta), held) - trigger(
        t + back * h, interpolate(coefficients, y, back), held
    )
    slope = rise / ((theta - back) * h)
    s = theta * h
    state = part(s)
    for _ in range(2):
        change = -trigger(t + s, state, held) / slope
        s = np.where(np.abs(change) <= 1e-6 * h, s + change, s)
        state = part(s)
    return s, state
