"""The sampled-data observer with an output predictor between the samples; no proof is made of it.

    x_hat' = f(x_hat, u) + L (w - h(x_hat)),   w' = dh/dx(x_hat) f(x_hat, u),   w(t_k) = y_k.

Its theorem holds for periods that are short enough, which it bounds by constants of a Lyapunov function that is given.

Source: Karafyllis2009
"""

from __future__ import annotations

from cdobs_cli.arrays import Array
from cdobs_cli.baselines.poles import placed
from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant, weighted

PREFIX = "predicted."


def predictor_gain(A: Array, C: Array, rate: float) -> ExactMatrix:
    """L (n, 1) with all eigenvalues of A - L C at -rate, by Ackermann's formula. A (n, n), C (1, n).

    Raises: ValueError where the pair is not observable.
    """
    return ExactMatrix.from_floats(placed(A, C, -rate), 12)


def output_predictor(plant: Plant, L: ExactMatrix) -> Observer:
    """The observer with the gain L (n, p); its states are x_hat and w, its estimate `x_hat`.

    Raises: ValueError where an output reads an input, whose rate is not known.
    """
    hat = tuple(PREFIX + name for name in plant.states)
    held = tuple(f"{PREFIX}w.{k}" for k in range(plant.p))
    f, h = plant.right_hand_side(PREFIX), plant.outputs(PREFIX)
    inputs = {one.name for one in plant.inputs}
    if any(row.variables & inputs for row in h):
        raise ValueError("an output reads an input, whose rate is not known")
    left = [Variable(name) - row for name, row in zip(held, h, strict=True)]
    flow = [sum(weighted(L, i, left), one) for i, one in enumerate(f)]
    rates = [_along(row, hat, f) for row in h]
    start = tuple(Variable(f"initial.{name}") for name in plant.states)
    h_start = tuple(row.substitute(dict(zip(hat, start, strict=True))) for row in h)
    x_hat = tuple(Variable(name) for name in hat)
    jump = (*x_hat, *(Variable(f"y.{k}") for k in range(plant.p)))
    return Observer((*hat, *held), (*start, *h_start), (*flow, *rates), jump, {"x_hat": x_hat})


def _along(row: Expression, names: tuple[str, ...], field: tuple[Expression, ...]) -> Expression:
    """The derivative of an expression along a vector field."""
    first, *rest = (row.derivative(name) * one for name, one in zip(names, field, strict=True))
    return sum(rest, first)
