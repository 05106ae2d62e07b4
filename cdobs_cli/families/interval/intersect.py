"""Bounds intersected with the measurement at samples: rows of z that the output sees, z_i = G_i C x.

    z_lower,i+ = max(z_lower,i, G_i y - ..),    z_upper,i+ = min(z_upper,i, G_i y - ..)

The jump only shrinks errors that stay nonnegative, and the error flow is monotone while E(s) >= 0: the bounds
still enclose the state, and they are never wider than without the intersection.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from flint import arb

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.interval.held import growth, interval, is_at_least_0
from cdobs_cli.families.interval.parts import absolute, column, entries, highest, lower_of, positive_part
from cdobs_cli.families.interval.theorems import Coordinates, width_flow

_PIECES = 64
_ROUNDS = 12


def measured_rows(C: Matrix, S: Matrix) -> dict[int, Matrix]:
    """Rows i of S with S_i = G_i C exactly, and their G_i, shape (1, p). Rows of balls are not recognised
    unless they are rows of C."""
    found = ((i, _row_of_output(C, S[i, :]) or _combination(S[i, :], C)) for i in range(S.shape[0]))
    return {i: G for i, G in found if G is not None}


def _row_of_output(C: Matrix, row: Matrix) -> Matrix | None:
    """G with G C = row, for a multiple of one row of C."""
    p = C.shape[0]
    for k in range(p):
        factor = _multiple(row, C[k, :])
        if factor is not None:
            return Matrix.from_rows([[factor if j == k else 0 for j in range(p)]])
    return None


def _multiple(row: Matrix, output: Matrix) -> Any | None:
    """g with row = g output, exactly: where the output row has one nonzero entry, or both are rational."""
    support = [j for j in range(output.shape[1]) if not arb(output[0, j]).is_zero()]
    if not support or any(not arb(row[0, j]).is_zero() for j in range(row.shape[1]) if j not in support):
        return None
    factor = row[0, support[0]] / output[0, support[0]]
    exact = all(row[0, j] == factor * output[0, j] for j in support[1:])
    return factor if exact and not arb(factor).contains(0) else None


def _combination(row: Matrix, C: Matrix) -> Matrix | None:
    """G with G C = row, for rational data and C of full row rank."""
    if not (row.is_rational and C.is_rational):
        return None
    gram = C @ C.T
    try:
        G = gram.solve(C @ row.T).T
    except ZeroDivisionError:
        return None
    rest = G @ C - row
    return G if all(value == 0 for value in rest.tolist()[0]) else None


def intersected_width(
    z: Coordinates, rows: dict[int, Matrix], w: Matrix, c: Matrix, noise: Matrix, high: Fraction
) -> Matrix:  # fmt: skip
    """An upper bound of the final width of z when rows of z are intersected at samples, at all times.

    Starts from a valid bound w (the final width without intersection) and improves it in turn: measured rows
    restart from r_i = |G_i| (v_upper - v_lower) at samples and grow for at most one period; the other rows,
    driven by those, settle where -(P + N) restricted to them says. Every step is a valid bound, so any number
    of them is.

    Args:
        w, c: bound of the width and width of delta, shape (n, 1). high: the largest sampling period.
    """
    n = w.shape[0]
    flow, held = width_flow(z.Q0), width_flow(z.Q1)
    others = [i for i in range(n) if i not in rows]
    restart = column(_cut_to(rows, i, noise, w) for i in range(n))
    maps = [_width_maps(flow, held, high * k / _PIECES, high * (k + 1) / _PIECES) for k in range(_PIECES)]
    bound = highest([w])
    for _ in range(_ROUNDS):
        start = lower_of(bound, restart)
        peak = highest(E @ start + integral @ c for E, integral in maps)
        better = lower_of(bound, column(peak[i, 0] if i in rows else bound[i, 0] for i in range(n)))
        settled = _settled(flow, held, c, start, better, others) if others else None
        if settled is not None:
            rest = dict(zip(others, entries(settled), strict=True))
            better = lower_of(better, column(rest.get(i, better[i, 0]) for i in range(n)))
        is_done = all(new >= old * arb("0.999999") for new, old in zip(entries(better), entries(bound), strict=True))
        bound = better
        if is_done:
            break
    return bound


def _cut_to(rows: dict[int, Matrix], i: int, noise: Matrix, w: Matrix) -> Any:
    """What a sample leaves of row i: |G_i| (v_upper - v_lower), or all of it."""
    return (absolute(rows[i]) @ noise)[0, 0] if i in rows else w[i, 0]


def _settled(flow: Matrix, held: Matrix, c: Matrix, start: Matrix, better: Matrix, others: list[int]) -> Matrix | None:
    """Where rows not measured settle for good: 0 = (P + N)_oo w_o + what drives them. None unless (P + N)_oo is
    certainly Hurwitz (its negative inverse nonnegative)."""
    measured = column(0 if i in others else better[i, 0] for i in range(flow.shape[0]))
    drive = (c + flow @ measured + positive_part(held) @ start)[others, :]
    try:
        inverse = (-flow[others, others]).inverse()
    except ZeroDivisionError:
        return None
    return inverse @ drive if is_at_least_0(inverse) else None


def _width_maps(flow: Matrix, held: Matrix, low: Fraction, high: Fraction) -> tuple[Matrix, Matrix]:
    """E_w(s) = I + Gamma(s) (G + H) and Gamma(s), for s in [low, high], enclosed."""
    identity, s = Matrix.identity(flow.shape[0]), interval(low, high)
    integral = growth(flow, identity, s) * s
    return identity + integral @ (flow + held), integral
