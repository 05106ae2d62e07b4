"""The observer of a carried certificate as equations: x_hat, Pi and the integral of r, run together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import reduce
from typing import Any

from cdobs_cli.exact.expression import ONE, ZERO, Expression, Number, Variable, call, power
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.updated_sampling.carried.law import (
    Law,
    Table,
    after_sample,
    determinant,
    riccati,
    solve,
    strengths,
)
from cdobs_cli.families.updated_sampling.carried.slopes import shares
from cdobs_cli.families.updated_sampling.lipschitz import HAT, Rate
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Entry, Plant

CLOCK = "gain.r"
_HALF = Fraction(1, 2)


def observer(plant: Plant, law: Law, rate: Rate, largest: Mapping[Entry, Fraction]) -> Observer:
    """x_hat' = A x_hat + phi(sat x_hat, u) + B u, Pi' by `riccati` with c(sat x_hat, u), and at a sample

        x_hat+ = x_hat + K (y - C x_hat),  K = (Pi + C'Lambda C)^-1 C'Lambda,  Pi+ = Pi + C'Lambda C

    (with `reset` Pi+ = F + C'Lambda C; with `one` Lambda is that of one output alone). Pi(0) = F, and the sample at 0
    is used. The next sample is due when T_min is over and det(Pi - F) has come down to epsilon det F, or the integral
    of r since the last one up to kappa.
    """
    n, hat = plant.n, tuple(HAT + name for name in plant.states)
    inside = plant.clipped(HAT)
    cut = replace(plant, phi=tuple(one.substitute(inside) for one in plant.phi))
    c = rate.c.substitute(inside)
    q = shares(largest, rate, c)
    names = [[entry_name(i, j) for j in range(n)] for i in range(n)]
    upper = [(i, j) for i in range(n) for j in range(i, n)]
    Pi: Table = [[Variable(name) for name in row] for row in names]
    F, C = _table(law.F), _table(plant.C)
    r = _clock(law, q)
    M = _distance(Pi, law)
    chosen = _choice(M, C, law)
    weights = [one.expression * share for one, share in zip(law.Lambda.rows[0], chosen, strict=True)]
    read = after_sample(Pi, C, weights)
    K = solve(read, [[C[k][i] * weights[k] for k in range(plant.p)] for i in range(n)], lambda a, b: a / b)
    kept = after_sample(F, C, weights) if law.reset else read
    innovation = [Variable(f"y.{k}") - one for k, one in enumerate(plant.outputs(HAT))]
    corrected = [
        sum((K[i][k] * innovation[k] for k in range(plant.p)), Variable(hat[i])) for i in range(n)
    ]  # fmt: skip
    flow = riccati(Pi, _table(plant.A), *_strengths(plant, law, largest, q), Number(2) * law.sigma.expression * r)
    margin, seen = _margin(M, law), {names[i][j].removeprefix("gain."): Pi[i][j] for i, j in upper}
    return Observer(
        states=(*hat, *(names[i][j] for i, j in upper), CLOCK),
        start=(*(Variable(f"initial.{name}") for name in plant.states), *(F[i][j] for i, j in upper), ZERO),
        flow=(*cut.right_hand_side(HAT), *(flow[i][j] for i, j in upper), r),
        jump=(*corrected, *(kept[i][j] for i, j in upper), ZERO),
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
        trigger=_trigger(law, margin),
        internals={**seen, "c": c, "margin": margin, **({"read": _number(chosen)} if law.one else {})},
    )  # fmt: skip


def entry_name(i: int, j: int) -> str:
    """Of Pi_ij, counted from 0: `gain.Pi_12`."""
    return f"gain.Pi_{min(i, j) + 1}{max(i, j) + 1}"


def _table(matrix: ExactMatrix) -> Table:
    return [[one.expression for one in row] for row in matrix.rows]


def _clock(law: Law, q: Mapping[Entry, Expression]) -> Expression:
    """r = max(idle, sqrt(max q_ij)); idle where no slope is uncertain."""
    steepest: Expression = ZERO
    for share in q.values():
        steepest = share if steepest == ZERO else call("max", steepest, share)
    return call("max", law.idle.expression, power(steepest, _HALF)) if q else law.idle.expression


def _strengths(
    plant: Plant, law: Law, largest: Mapping[Entry, Fraction], q: Mapping[Entry, Expression]
) -> tuple[list[Any], list[Any]]:
    slower, faster = law.exponents
    split = {entry: law.split[entry].expression for entry in largest}
    cl = {entry: Number(bound) * split[entry] * power(q[entry], slower) for entry, bound in largest.items()}
    c_over_l = {entry: Number(bound) / split[entry] * power(q[entry], faster) for entry, bound in largest.items()}
    return strengths(plant.n, cl, c_over_l, [one.expression for one in law.gamma.rows[0]], ZERO)


def _distance(Pi: Table, law: Law) -> Table:
    """Pi - F."""
    F = _table(law.F)
    return [[Pi[i][j] - F[i][j] for j in range(len(F))] for i in range(len(F))]


def _margin(M: Table, law: Law) -> Expression:
    """The least of det(Pi - F) / det F - epsilon and the smaller leading minors of Pi - F over those of F.

    It is above 0 between T_min and the next sample, and below 0 wherever Pi - F is not definite, for as long as that
    lasts: the determinant alone is above 0 again where two eigenvalues passed 0 together. Before it has come down to
    epsilon no minor has reached 0, so that the minors ask for nothing sooner.
    """
    F = _table(law.F)
    *smaller, last = (determinant(_leading(M, k)) / determinant(_leading(F, k)) for k in range(1, len(F) + 1))
    margin: Expression = last - law.epsilon.expression
    return reduce(lambda a, b: call("min", a, b), smaller, margin)


def _leading(M: Table, k: int) -> Table:
    return [row[:k] for row in M[:k]]


def _choice(M: Table, C: Table, law: Law) -> list[Expression]:
    """1 for an output that is read, else 0. Of `one` that whose reading makes det(Pi - F) largest, the first of equal
    ones: near the floor Pi - F is small in one direction, and what sees most of that is read."""
    weights = [one.expression for one in law.Lambda.rows[0]]
    if not law.one:
        return [ONE] * len(weights)
    scores = [determinant(after_sample(M, [row], [weight])) for row, weight in zip(C, weights, strict=True)]
    return [_is_best(k, scores) for k in range(len(scores))]


def _is_best(k: int, scores: Sequence[Expression]) -> Expression:
    chosen: Expression = ONE
    for j, other in enumerate(scores):
        if j < k:  # more than those before
            chosen = chosen * call("max", ZERO, call("sign", scores[k] - other))
        elif j > k:  # as much as those behind
            chosen = chosen * (ONE - call("max", ZERO, call("sign", other - scores[k])))
    return chosen


def _number(chosen: Sequence[Expression]) -> Expression:
    """Of the output that is read, from 1."""
    return sum((Number(k) * one for k, one in enumerate(chosen, start=1)), ZERO)


def _trigger(law: Law, margin: Expression) -> Expression:
    """min(elapsed - T_min, max(-margin, integral of r - kappa))."""
    due = -margin
    if law.kappa is not None:
        due = call("max", due, Variable(CLOCK) - law.kappa.expression)
    return call("min", Variable("elapsed") - law.T_min.expression, due)
