"""The continuous-discrete extended Kalman filter as equations, one output.

    x_hat' = f(x_hat, u),  P' = F P + P F' + Q,  F = df/dx at x_hat;
    at a sample  G = P C' / (C P C' + R),  x_hat+ = x_hat + G (y - C x_hat),  P+ = P - G C P.

Source: Jazwinski1970, Chapter 8
"""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.exact.expression import ZERO, Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

PREFIX = "hat."


def extended_kalman_filter(plant: Plant, Q: Sequence[Exact], R: Exact, P_0: Sequence[Exact]) -> Observer:
    """The filter with diagonal Q and P(0), n numbers each, and R > 0.

    Raises: ValueError for several outputs.
    """
    if plant.p != 1:
        raise ValueError("this filter takes one output")
    n = plant.n
    hat = tuple(PREFIX + name for name in plant.states)
    f = plant.right_hand_side(PREFIX)
    F = [[row.derivative(name) for name in hat] for row in f]
    P = [[Variable(_entry(min(i, j), max(i, j))) for j in range(n)] for i in range(n)]
    upper = [(i, j) for i in range(n) for j in range(i, n)]
    h = plant.outputs(PREFIX)[0]
    C = [h.derivative(name) for name in hat]
    PC = [sum((P[i][k] * C[k] for k in range(n)), ZERO) for i in range(n)]
    spread = sum((C[i] * PC[i] for i in range(n)), ZERO) + R.expression
    innovation = Variable("y.0") - h
    rates = [sum((F[i][k] * P[k][j] + P[i][k] * F[j][k] for k in range(n)), ZERO) for i, j in upper]
    flow_P = [rate + Q[i].expression if i == j else rate for (i, j), rate in zip(upper, rates, strict=True)]
    return Observer(
        states=(*hat, *(_entry(i, j) for i, j in upper)),
        start=(
            *(Variable(f"initial.{name}") for name in plant.states),
            *(P_0[i].expression if i == j else ZERO for i, j in upper),
        ),
        flow=(*f, *flow_P),
        jump=(
            *(Variable(hat[i]) + PC[i] / spread * innovation for i in range(n)),
            *(P[i][j] - PC[i] * PC[j] / spread for i, j in upper),
        ),
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
    )


def _entry(i: int, j: int) -> str:
    return f"cov.{i}.{j}"
