"""The observer (3) and its error system (8)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, Observer, PlantView
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


def error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """edot = (A + V) e with V in the slope box, e+ = (I - K C) e, for e = x_hat - x.

    Source: Dinh2014, (8), (10)
    """
    n = view.A.shape[0]
    unit = [view.unit(i) for i in range(n)]
    identity = unit[0] @ unit[0].T
    for column in unit[1:]:
        identity = identity + column @ column.T
    return ErrorMaps(
        base=view.A,
        left=tuple(unit[i] for i, _ in view.entries),
        right=tuple(unit[j].T for _, j in view.entries),
        lower=view.lower,
        upper=view.upper,
        jump=identity - view.gain["K"] @ view.C,
    )


def inclusion(plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
    """The error system of the plant with gain K under the plant's sampling law."""
    return HybridInclusion(error_maps, plant, gain, plant.sampling, plant.slopes.uncertain)
