"""The observer (3) and its error system (8)."""

from __future__ import annotations

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant
from cdobs_cli.thresholds import Threshold

PREFIX = "hat."


def observer(plant: Plant, design: Design) -> Observer:
    """A copy of the model between samples, corrected by K (y_k - C x_hat) at each of them; where sensors have periods
    of their own by the K of that sample and the outputs that it reads; where sensors send on change each by its own.

    Source: Dinh2014, (3)
    """
    hat, K, law = tuple(PREFIX + name for name in plant.states), design.gain["K"], design.sampling
    own = law.split(K, plant.p) if law.has_sensors else [K]
    reads = [one.outputs for one in law.readings] or [tuple(range(plant.p))]
    if law.is_on_change:
        reads, own = [(one.output,) for one in law.thresholds], [K] * len(law.thresholds)
    jumps = tuple(_jump(plant, hat, *one) for one in zip(own, reads, strict=True))
    return Observer(
        states=hat,
        start=tuple(Variable(f"initial.{name}") for name in plant.states),
        flow=plant.right_hand_side(PREFIX),
        jump=jumps[0],
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
        jumps=jumps if law.has_sensors or law.is_on_change else (),
        compares=tuple(_compared(plant, one) for one in law.thresholds),
        compared_always=not law.is_checked,
    )


def _compared(plant: Plant, one: Threshold) -> Expression:
    """|y - C x_hat| / delta - 1."""
    residual = Variable(f"y.{one.output}") - plant.outputs(PREFIX)[one.output]
    return call("abs", residual) / one.delta.expression - Number(1)


def _jump(plant: Plant, hat: tuple[str, ...], K: ExactMatrix, read: tuple[int, ...]) -> tuple[Expression, ...]:
    """x_hat + K (y_k - C x_hat), of the outputs that are read."""
    rows = plant.outputs(PREFIX)
    innovation = [(k, Variable(f"y.{k}") - rows[k]) for k in sorted(read)]
    jump = []
    for i, name in enumerate(hat):
        correction: Expression = ZERO
        for k, residual in innovation:
            correction = correction + K[i, k].expression * residual
        jump.append(Variable(name) + correction)
    return tuple(jump)
