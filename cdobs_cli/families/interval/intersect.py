"""Bounds intersected with the measurement at samples: rows of z that the output sees, z_i = G_i C x.

    z_lower,i+ = max(z_lower,i, G_i y - ..),    z_upper,i+ = min(z_upper,i, G_i y - ..)

The jump only shrinks errors that stay nonnegative, and the error flow is monotone while E(s) >= 0: the bounds
still enclose the state, and they are never wider than without the intersection.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from flint import arb

from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.interval.held_loop import growth
from cdobs_cli.families.interval.parts import absolute, metzler_split
from cdobs_cli.families.interval.theorems import Coordinates

_PIECES = 64
_ROUNDS = 12


def measured_rows(C: Matrix, S: Matrix) -> dict[int, Matrix]:
    """Rows i of S with S_i = G_i C exactly, and their G_i, shape (1, p). Rows of balls are not recognised
    unless they are rows of C."""
    p = C.shape[0]
    found: dict[int, Matrix] = {}
    for i in range(S.shape[0]):
        for k in range(p):
            factor = _multiple(S[i, :], C[k, :])
            if factor is not None:
                found[i] = Matrix.from_rows([[factor if j == k else 0 for j in range(p)]])
                break
        else:
            if S.is_rational and C.is_rational:
                combination = _combination(S[i, :], C)
                if combination is not None:
                    found[i] = combination
    return found


def _multiple(row: Matrix, output: Matrix) -> Any | None:
    """g with row = g output where the output row has one nonzero entry, or both are rational multiples."""
    n = output.shape[1]
    support = [j for j in range(n) if not arb(output[0, j]).is_zero()]
    if not support or any(not arb(row[0, j]).is_zero() for j in range(n) if j not in support):
        return None
    pivot = support[0]
    factor = row[0, pivot] / output[0, pivot]
    if len(support) == 1:
        return None if arb(factor).contains(0) else factor
    if not (row.is_rational and output.is_rational) or factor == 0:
        return None
    return factor if all(row[0, j] == factor * output[0, j] for j in support) else None


def _combination(row: Matrix, C: Matrix) -> Matrix | None:
    """G with G C = row, for rational data and C of full row rank."""
    gram = C @ C.T
    try:
        G = gram.solve(C @ row.T).T
    except ZeroDivisionError:
        return None
    rest = G @ C - row
    return G if all(value == 0 for value in rest.tolist()[0]) else None


def intersected_width(z: Coordinates[Matrix], rows: dict[int, Matrix], w: Matrix, c: Matrix, noise: Matrix, high: Fraction) -> Matrix:
    """An upper bound of the final width of z when rows of z are intersected at samples, at all times.

    Starts from a valid bound w (the final width without intersection) and improves it in turn: measured rows
    restart from r_i = |G_i| (v_upper - v_lower) at samples and grow for at most one period; the other rows,
    driven by those, settle where -(P + N) restricted to them says. Every step is a valid bound, so any number
    of them is.

    Args:
        w, c: bound of the width and width of delta, shape (n, 1). high: the largest sampling period.
    """
    n = w.shape[0]
    split = metzler_split(z.Q0)
    flow = split[0] + split[1]
    held_split = metzler_split(z.Q1)
    held = held_split[0] + held_split[1]
    others = [i for i in range(n) if i not in rows]
    bound = [arb(w[i, 0]).upper() for i in range(n)]
    restart = {i: (absolute(G) @ noise)[0, 0] for i, G in rows.items()}
    pieces = [(high * k / _PIECES, high * (k + 1) / _PIECES) for k in range(_PIECES)]
    maps = [_width_maps(flow, held, a, b) for a, b in pieces]
    for _ in range(_ROUNDS):
        start = Matrix.from_rows([[arb.min(bound[i], arb(restart[i])).upper()] if i in rows else [bound[i]] for i in range(n)])
        peak = [arb(0)] * n
        for E, integral in maps:
            value = E @ start + integral @ c
            peak = [arb.max(peak[i], arb(value[i, 0]).upper()) for i in range(n)]
        better = [arb.min(bound[i], peak[i]).upper() if i in rows else bound[i] for i in range(n)]
        if others:
            settled = _settled(flow, held, c, start, better, others)
            if settled is not None:
                for i, value in zip(others, settled, strict=True):
                    better[i] = arb.min(better[i], value).upper()
        if all(bool(new >= old * arb("0.999999")) for new, old in zip(better, bound, strict=True)):
            bound = better
            break
        bound = better
    return Matrix.from_rows([[value] for value in bound])


def _settled(flow: Matrix, held: Matrix, c: Matrix, start: Matrix, better: list[arb], others: list[int]) -> list[arb] | None:
    """Where rows not measured settle for good: 0 = (P + N)_oo w_o + what drives them. None unless (P + N)_oo is
    certainly Hurwitz (its negative inverse nonnegative)."""
    n = flow.shape[0]
    inner = flow[others, others]
    drive = []
    for i in others:
        total = arb(c[i, 0])
        for j in range(n):
            if j not in others:
                total += arb(flow[i, j]) * better[j]
            total += arb.max(arb(held[i, j]), arb(0)) * arb(start[j, 0])
        drive.append([total])
    try:
        inverse = (-inner).inverse()
    except ZeroDivisionError:
        return None
    if not all(arb(value) >= 0 for row in inverse.tolist() for value in row):
        return None
    value = inverse @ Matrix.from_rows(drive)
    return [arb(value[k, 0]).upper() for k in range(len(others))]


def _width_maps(flow: Matrix, held: Matrix, low: Fraction, high: Fraction) -> tuple[Matrix, Matrix]:
    """E_w(s) = I + Gamma(s) (G + H) and Gamma(s), for s in [low, high], enclosed."""
    n = flow.shape[0]
    s = fraction_ball((low + high) / 2) + arb(0, fraction_ball((high - low) / 2).upper())
    integral = growth(flow, Matrix.identity(n), s) * s
    return Matrix.identity(n) + integral @ (flow + held), integral
