"""The continuous-discrete extended Kalman filter as equations.

    x_hat' = f(x_hat, u),  P' = F P + P F' + Q,  F = df/dx at x_hat;
    at a sample, output by output (of L^-1 y, with R = L D L', L with ones on its diagonal), from delta = 0:
    s = H P H' + D_k,  g = P H'/s,  delta+ = delta + g (y - h(x_hat, u) - H delta),
    P+ = (I - g H) P (I - g H)' + D_k g g';    after the last one  x_hat+ = x_hat + delta.

H = dh/dx stands at the estimate before the sample for all outputs, so that the updates one after the other are the
joint one, G = P H' (H P H' + R)^-1. P+ is Joseph's form: it stays positive where R is small beside H P H'.

Source: Jazwinski1970, Chapter 8
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import product
from math import floor, inf, log10

from cdobs_cli.exact.expression import ONE, ZERO, Expression, Number, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

PREFIX = "ekf."
MAX_OUTPUTS = 4
Rows = list[list[Expression]]


def extended_kalman_filter(
    plant: Plant, Q: ExactMatrix, R: ExactMatrix, P_0: ExactMatrix, reads: Sequence[Sequence[int]] = ()
) -> Observer:
    """The filter under d white of intensity Q (n, n) and v of covariance R (p, p) > 0, from P(0) = P_0 (n, n).

    reads: the outputs that one sample after the other reads, where that is not all of them at each.

    Its states: `ekf.<state>`, and the upper triangle of P, `cov.i.j` being P_ij/(s_i s_j) with s_i the power of ten
    next to the deviation in P_0.

    Raises: ValueError for more than four outputs, a matrix of another shape, an R that is not positive definite.
    """
    n, p = plant.n, plant.p
    if p > MAX_OUTPUTS:
        raise ValueError(f"this filter takes up to {MAX_OUTPUTS} outputs, not {p}")
    if (Q.shape, R.shape, P_0.shape) != ((n, n), (p, p), (n, n)):
        raise ValueError("Q and P_0 have a row and a column for each state, R for each output")
    s = [_scale(P_0[i, i]) for i in range(n)]
    hat = tuple(PREFIX + name for name in plant.states)
    f, h = plant.right_hand_side(PREFIX), plant.outputs(PREFIX)
    F = [[row.derivative(name) * Number(s[j] / s[i]) for j, name in enumerate(hat)] for i, row in enumerate(f)]
    H = [[row.derivative(name) * Number(s[j]) for j, name in enumerate(hat)] for row in h]
    P: Rows = [[Variable(_entry(min(i, j), max(i, j))) for j in range(n)] for i in range(n)]
    upper = [(i, j) for i in range(n) for j in range(i, n)]

    def scaled(M: ExactMatrix, i: int, j: int) -> Expression:
        return M[i, j].expression * Number(1 / (s[i] * s[j]))

    rates = [_dot(F[i], P[j]) + _dot(F[j], P[i]) + scaled(Q, i, j) for i, j in upper]

    def corrected(read: Sequence[int]) -> tuple[Expression, ...]:
        L, D = _decorrelated(ExactMatrix([[R[k, m] for m in read] for k in read]))
        innovations = [[Variable(f"y.{k}") - h[k]] for k in read]
        delta, after = _updated(P, _solved(L, innovations), _solved(L, [H[k] for k in read]), D)
        states = (Variable(name) + Number(s[i]) * delta[i] for i, name in enumerate(hat))
        return (*states, *(after[i][j] for i, j in upper))

    known = {tuple(read): corrected(read) for read in reads or [range(p)]}
    jumps = tuple(known[tuple(read)] for read in reads)
    return Observer(
        states=(*hat, *(_entry(i, j) for i, j in upper)),
        start=(*(Variable(f"initial.{name}") for name in plant.states), *(scaled(P_0, i, j) for i, j in upper)),
        flow=(*f, *rates),
        jump=next(iter(known.values())), jumps=jumps,
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
    )  # fmt: skip


def _updated(P: Rows, z: Rows, H: Rows, D: Sequence[Expression]) -> tuple[list[Expression], Rows]:
    """delta and P after one scalar measurement after the other."""
    n = len(P)
    delta: list[Expression] = [ZERO] * n
    for k, row in enumerate(H):
        PH = [_dot(P[i], row) for i in range(n)]
        g = [one / (_dot(row, PH) + D[k]) for one in PH]
        left = z[k][0] - _dot(row, delta)
        delta = [one + gain * left for one, gain in zip(delta, g, strict=True)]
        M = [[(ONE if i == j else ZERO) - g[i] * row[j] for j in range(n)] for i in range(n)]
        MP = [[_dot(M[i], [P[j][m] for j in range(n)]) for m in range(n)] for i in range(n)]
        half = [[_dot(MP[i], M[j]) + D[k] * g[i] * g[j] for j in range(i + 1)] for i in range(n)]
        P = [[half[max(i, j)][min(i, j)] for j in range(n)] for i in range(n)]
    return delta, P


def _decorrelated(R: ExactMatrix) -> tuple[Rows, list[Expression]]:
    """L and D with R = L D L', L lower triangular with ones on its diagonal.

    Raises: ValueError where a pivot is not certainly positive.
    """
    p = R.shape[0]
    left = [[R[i, j].expression for j in range(p)] for i in range(p)]
    L: Rows = [[Number(int(i == j)) for j in range(p)] for i in range(p)]
    D: list[Expression] = []
    for k in range(p):
        if Exact(left[k][k]).sign() != 1:
            raise ValueError("R is not positive definite: a combination of the outputs has no noise")
        D.append(left[k][k])
        for i in range(k + 1, p):
            L[i][k] = left[i][k] / left[k][k]
        for i, j in product(range(k + 1, p), repeat=2):
            left[i][j] = left[i][j] - L[i][k] * left[k][j]
    return L, D


def _solved(L: Rows, M: Rows) -> Rows:
    """L^-1 M, by substitution."""
    rows: Rows = []
    for k, row in enumerate(M):
        rows.append([entry - _dot(L[k][:k], [done[j] for done in rows]) for j, entry in enumerate(row)])
    return rows


def _scale(variance: Exact) -> Fraction:
    """The power of ten next to a deviation; 1 where there is none."""
    value = float(variance)
    return Fraction(10) ** floor(log10(value) / 2 + 0.5) if 0 < value < inf else Fraction(1)


def _dot(a: Sequence[Expression], b: Sequence[Expression]) -> Expression:
    return sum((one * other for one, other in zip(a, b, strict=True)), ZERO)


def _entry(i: int, j: int) -> str:
    return f"cov.{i}.{j}"
