"""The observer (19), which holds its innovation between samples, and its error system (24)."""

from __future__ import annotations

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Variable
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

HAT = "hat."
INNOVATION = "innovation."


def observer(plant: Plant, design: Design) -> Observer:
    """A copy of the model driven by L times the innovation of the last sample.

        xhatdot = A xhat + phi(xhat, u) + B u + L r,    rdot = 0,    r+ = y(t_k) - C xhat(t_k)

    The estimate does not jump; the held innovation r does.
    Source: Boukal2020, (19)
    """
    L = design.gain["L"]
    hat = tuple(HAT + name for name in plant.states)
    held = tuple(f"{INNOVATION}{k}" for k in range(plant.p))
    flow = []
    for i, row in enumerate(plant.right_hand_side(HAT)):
        for k, name in enumerate(held):
            row = row + L[i, k].expression * Variable(name)
        flow.append(row)
    innovation = tuple(Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs(HAT)))
    return Observer(
        states=hat + held,
        start=tuple(Variable(f"initial.{name}") for name in plant.states) + (ZERO,) * plant.p,
        flow=tuple(flow) + (ZERO,) * plant.p,
        jump=tuple(Variable(name) for name in hat) + innovation,
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
        internals={name: Variable(name) for name in held},
    )
