"""The observer (3) and its error system (8)."""

from __future__ import annotations

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

PREFIX = "hat."


def observer(plant: Plant, design: Design) -> Observer:
    """A copy of the model between samples, corrected by K (y_k - C x_hat) at each of them.

    Source: Dinh2014, (3)
    """
    K = design.gain["K"]
    hat = tuple(PREFIX + name for name in plant.states)
    innovation = [Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs(PREFIX))]
    jump = []
    for i, name in enumerate(hat):
        correction: Expression = ZERO
        for k, residual in enumerate(innovation):
            correction = correction + K[i, k].expression * residual
        jump.append(Variable(name) + correction)
    return Observer(
        states=hat,
        start=tuple(Variable(f"initial.{name}") for name in plant.states),
        flow=plant.right_hand_side(PREFIX),
        jump=tuple(jump),
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
    )
