"""Chains of integrators: how long the box (31) holds, and the box itself, both in closed form.

    edot_j = e_(j+1),  j < n;    edot_n = sum_j v_j e_j,  v_j in [lo_j, hi_j],  lo_j <= 0 <= hi_j

Let a_n be the last unit vector, N the chain, and w_j = (lo_1, .., lo_j, hi_(j+1), .., hi_n).

Why the box holds. Let g be the last column of a transition matrix Phi_V. The solution f of w_n = lo from a_n
stays >= 0 up to tau_n, and g - f = int Phi_V a_n (v - lo)'f, so g >= f as long as last columns are >= 0:
they are, up to tau_n. Then exp((N + a_n hi')s) is above Phi_V (the difference is an integral of last columns
times (hi - v)'e >= 0); and the solution from a_j with w_j is >= 0 in its components 1..j and <= 0 in the
others up to tau_j, the first zero of its component j, so it is below Phi_V a_j in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb

from cdobs_cli.certify.kernel import is_zero
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

Number: TypeAlias = Fraction | arb
RELATIVE_WIDTH = Fraction(1, 10**15)


@dataclass(frozen=True)
class LastRow:
    """The range of the last row of A + V, enlarged to hold 0 in each entry."""

    lo: tuple[Number, ...]
    hi: tuple[Number, ...]

    @property
    def n(self) -> int:
        return len(self.lo)

    def flow(self, w: Sequence[Number]) -> Matrix:
        """N + a_n w'."""
        n = self.n
        rows: list[list[Any]] = [[int(j == i + 1) for j in range(n)] for i in range(n - 1)]
        return Matrix.from_rows([*rows, list(w)])

    def w(self, j: int) -> tuple[Number, ...]:
        """(lo_1, .., lo_j, hi_(j+1), .., hi_n); j counts from 1."""
        return self.lo[:j] + self.hi[j:]


def last_row(plant: Plant) -> LastRow:
    """The last row of A plus the slopes of phi_n, as intervals that hold 0."""
    n = plant.n
    lo, hi = [], []
    for j in range(n):
        entry = plant.A[n - 1, j]
        lo.append(_clip(entry + plant.slopes.lower[n - 1, j], upper=True))
        hi.append(_clip(entry + plant.slopes.upper[n - 1, j], upper=False))
    return LastRow(tuple(lo), tuple(hi))


def _clip(value: Exact, *, upper: bool) -> Number:
    if value.rational is not None:
        return min(value.rational, Fraction(0)) if upper else max(value.rational, Fraction(0))
    return value.ball().min(arb(0)) if upper else value.ball().max(arb(0))


def box_31(row: LastRow, delta: arb) -> IntervalMatrix:
    """The box that holds every Phi_V(delta), for delta <= delta_star.

        m+ = exp((N + a_n hi') delta),    column j of m- = column j of exp((N + a_n w_j') delta)

    Both ends are attained, so no smaller box exists.

    Source: Dinh2014, Theorem III.2, (31)
    Deviates: the paper sweeps the Clarke gradients of (22), (23) over the unit sphere.
    """
    n = row.n
    high = row.flow(row.hi).exp(delta)
    upper = [[high[i, j] for j in range(n)] for i in range(n)]
    lower = [list(entries) for entries in upper]
    for j in range(n):
        if row.w(j + 1) != row.hi:
            low = row.flow(row.w(j + 1)).exp(delta)
            for i in range(n):
                lower[i][j] = low[i, j]
    return IntervalMatrix.between(lower, upper)


def delta_star(row: LastRow) -> arb:
    """How long the box (31) holds: the least, over j, of the first zeros tau_j of

        psi_j(s) = [exp((N + a_n w_j') s)]_jj,

    which is tau_n where |v_j| <= c_j. Returns an enclosure, +inf where no psi_j has a zero (all of lo_1, ..,
    lo_(n-1) are 0), an enclosure with an infinite upper end where the zero was not isolated.

    Source: Dinh2014, Theorem III.2
    Deviates: exact; the paper prints the sufficient sqrt(3) - 1 for its pendulum, where it is pi/2.
    """
    n = row.n
    least = arb("inf")
    for j in range(n, 0, -1):
        if any(not is_zero(value) for value in row.lo[: min(j, n - 1)]):
            least = least.min(first_zero(row.flow(row.w(j)), j - 1, least))
    return least


def holds_until(row: LastRow, delta: arb) -> bool:
    """Whether delta <= delta_star is proved: every psi_j is positive on [0, delta]."""
    n = row.n
    if not delta.is_finite():
        return False
    end = delta.upper()
    for j in range(n, 0, -1):
        moves = any(not is_zero(value) for value in row.lo[: min(j, n - 1)])
        if moves and not first_zero(row.flow(row.w(j)), j - 1, end) >= end:
            return False
    return True


def first_zero(flow: Matrix, i: int, until: arb) -> arb:
    """The first zero of psi(s) = [exp(flow s)]_ii, enclosed.

    psi(0) = 1, and psi decreases up to its first zero. Steps along [0, ..] on which psi is proved positive,
    then one on which psi' < 0 and psi changes sign, which is halved. Returns `until` once psi is proved
    positive on [0, until].
    """
    last = flow.floats[-1]
    n = len(last)
    scale = max((abs(float(value)) ** (1.0 / (n - k)) for k, value in enumerate(last)), default=0.0)
    if scale == 0.0:
        return until
    step = Fraction(0.25 / scale)
    start = Fraction(0)
    for _ in range(600):
        end = start + step
        reaches = not fraction_ball(end) < until
        piece = fraction_ball(start).union(until if reaches else fraction_ball(end))
        E = flow.exp(piece)
        if E[i, i] > 0:
            if reaches:
                return until
            start, step = end, step * 2
        elif (flow @ E)[i, i] < 0 and flow.exp(fraction_ball(end))[i, i] < 0:
            return _halve(flow, i, start, end)
        else:
            step /= 2
    return fraction_ball(start).union(arb("inf"))


def _halve(flow: Matrix, i: int, start: Fraction, end: Fraction) -> arb:
    while end - start > RELATIVE_WIDTH * end:
        middle = (start + end) / 2
        value = flow.exp(fraction_ball(middle))[i, i]
        if value > 0:
            start = middle
        elif value < 0:
            end = middle
        else:
            break
    return fraction_ball(start).union(fraction_ball(end))
