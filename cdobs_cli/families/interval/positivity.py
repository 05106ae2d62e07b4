"""The exact limit of the sampling period up to which the bounds enclose the state, proved in balls.

    E(s) = exp(M s) + Gamma(s) N1,    Gamma(s) = integral_0^s exp(M r) dr

The bounds hold for every sampling with T_k <= Tbar and every initial box of z exactly if E(s) >= 0 on
[0, Tbar]. Column j of E is the solution of x' = M x + N1_j, x(0) = unit vector j. All couplings except
the diagonal of N1 are not negative, so no entry other than x_j can be the first to change sign: only the
diagonal entries E_jj with N1_jj < 0 have to be looked at.
"""

from __future__ import annotations

from fractions import Fraction
from functools import reduce

import numpy as np
from flint import arb

from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import arb_fraction
from cdobs_cli.records import dataclass

TOLERANCE = Fraction(1, 2 * 10**7)
_STEPS = 400
_LARGEST_EXPONENT = 200  # of exp(|M| s): the search for a sign change ends there


@dataclass(frozen=True)
class PositivityLimit:
    """E >= 0 on [0, proved] (None: for ever), and E_jj(refuted) < 0 (None: no such s was found); `column` is
    j, counted from 0."""

    proved: Fraction | None
    refuted: Fraction | None
    column: int | None = None

    def holds_until(self, T: arb) -> bool:
        """Whether E >= 0 on [0, T] is proved."""
        return self.proved is None or bool(fraction_ball(self.proved) >= T)

    def fails_before(self, T: arb) -> bool:
        """Whether E has a negative entry somewhere on [0, T], proved."""
        return self.refuted is not None and bool(fraction_ball(self.refuted) <= T)


def scalar_limit(m: arb, q: arb) -> arb | None:
    """The last s with exp(m s) - q (exp(m s) - 1)/m >= 0, for q > 0; None where there is none (q <= m).

        ln(q / (q - m)) / m,    1/q for m = 0

    A lower bound for every coupled system, the limit itself for a scalar one.
    """
    if q <= m:
        return None
    if m.contains(0):
        # (1 - exp(-r)) / r <= 1 for r = m s >= 0, and m s < 0 only helps where m = 0 is not exact.
        return 1 / q if m.is_zero() else arb(1) / (q + abs(m))
    return (q / (q - m)).log() / m if q > m else arb(0)


def positivity_limit(M: Matrix, N1: Matrix, effort: int = 1) -> PositivityLimit:
    """Bracket of the largest Tbar with E >= 0 on [0, Tbar], to 5e-8 relative where a sign change is met.

    Args:
        M: Metzler, N1: nonnegative off its diagonal; shapes (2n, 2n).
    Source: Efimov2016, Theorem 1
    Deviates: necessary and sufficient, in place of the sufficient q0 <= e q1 < q0 + 1/Tbar; q0 <= e q1 is not
        needed for positivity.
    """
    limits = [_column_limit(M, N1, j, effort) for j in range(M.shape[0]) if not arb(N1[j, j]) >= 0]
    proved = min((limit.proved for limit in limits if limit.proved is not None), default=None)
    refuted = [limit for limit in limits if limit.refuted is not None]
    first = min(refuted, key=lambda limit: limit.refuted or 0, default=PositivityLimit(None, None))
    return PositivityLimit(proved, first.refuted, first.column)


@dataclass(frozen=True)
class _Column:
    """x' = M x + N1_j as one flow matrix of (x, 1), from (unit vector j, 1)."""

    flow: Matrix
    start: Matrix
    j: int
    reached: tuple[int, ...]
    norm: arb

    @staticmethod
    def of(M: Matrix, N1: Matrix, j: int) -> _Column:
        size = M.shape[0]
        flow = block([[M, N1[:, j]], [Matrix.zeros(1, size), Matrix.zeros(1, 1)]])
        start = Matrix.from_rows([[int(i == j)] for i in range(size)] + [[1]])
        norm = reduce(arb.max, (sum((abs(value) for value in row), arb(0)) for row in flow.balls().tolist()))
        return _Column(flow, start, j, _related(M, N1, j), norm.upper())

    def at(self, s: Fraction) -> Matrix:
        """(x(s), 1)."""
        return self.flow.exp(fraction_ball(s)) @ self.start

    def over(self, low: Fraction, high: Fraction) -> Matrix:
        """(x, 1) on the whole of [low, high]."""
        middle, radius = (low + high) / 2, fraction_ball((high - low) / 2)
        return self.flow.exp(arb(0, radius.upper())) @ self.at(middle)

    def entry(self, s: Fraction) -> arb:
        """E_jj(s)."""
        return arb(self.at(s)[self.j, 0])

    def is_positive_on(self, low: Fraction, high: Fraction) -> bool:
        """Whether E_jj > 0 on [low, high] is proved: by its enclosure, or by its slope and its two ends."""
        states = self.over(low, high)
        if arb(states[self.j, 0]) > 0:
            return True
        slope = arb((self.flow @ states)[self.j, 0])
        return bool(slope < 0 or slope > 0) and bool(self.entry(low) > 0) and bool(self.entry(high) > 0)

    def grows_for_ever(self, s: Fraction) -> bool:
        """Whether x' >= 0 at s, with x >= 0 so far, is proved for all entries that matter: then x' stays
        >= 0 (x'' = M x', M Metzler), and E_jj with it."""
        slope = self.flow @ self.at(s)
        return all(arb(slope[i, 0]) > 0 for i in self.reached)


def _related(M: Matrix, N1: Matrix, j: int) -> tuple[int, ...]:
    """Entries that column j reaches (others stay 0) and that reach entry j (others do not matter)."""
    size = M.shape[0]
    fed = np.array([[i == k or not arb(M[i, k]).is_zero() for k in range(size)] for i in range(size)])
    reached = np.linalg.matrix_power(fed.astype(float), size) > 0
    start = [i for i in range(size) if i == j or not arb(N1[i, j]).is_zero()]
    return tuple(i for i in range(size) if reached[i, start].any() and reached[j, i])


def _column_limit(M: Matrix, N1: Matrix, j: int, effort: int) -> PositivityLimit:
    safe = scalar_limit(arb(M[j, j]), -arb(N1[j, j]))
    if safe is None:
        return PositivityLimit(None, None)
    column = _Column.of(M, N1, j)
    low = arb_fraction(safe.lower()) if safe.is_finite() and safe > 0 else Fraction(0)
    # Below `low` the scalar comparison holds with >=; at `low` itself the balls may only say "near zero".
    low = low * (1 - Fraction(1, 2**40))
    step = low / 4 if low > 0 else arb_fraction((1 / (column.norm * 4)).lower())
    high: Fraction | None = None
    for _ in range(_STEPS * 2**effort):
        if high is not None and high - low <= TOLERANCE * low:
            break
        if step <= low * Fraction(1, 2**60):
            break
        target = low + step if high is None else min(low + step, (low + high) / 2)
        if column.norm * fraction_ball(target) > _LARGEST_EXPONENT:
            break
        if column.is_positive_on(low, target):
            low = _short(target, low)
            if high is None and column.grows_for_ever(low):
                return PositivityLimit(None, None)
            step = step * Fraction(3, 2)
        elif column.entry(target) < 0:
            high = target
            step = (high - low) / 2
        else:
            step = step / 2
    if high is None:
        return PositivityLimit(low, None)
    return PositivityLimit(low, high, j)


def _short(value: Fraction, above: Fraction) -> Fraction:
    """A dyadic with few bits just below `value`, if it is `above`."""
    rounded = Fraction(int(value * 2**80), 2**80)
    return rounded if above < rounded else value
