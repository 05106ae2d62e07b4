"""Sensors that send on change: what the family takes of them, and why no gain is found."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

_SENSORS = ("measurement", "sensors")


def on_change_problems(family: Reachability, plant: Plant) -> Iterator[Problem]:
    """Objectives about periods, outputs that are not linear, signals that have no bound."""
    if family.objective == "max_period":
        what, allowed = "sensors that send on change have no period", "given_period, min_error or decay_rate"
        hint = "min_error finds the gain of least error, and of fewest messages by larger thresholds"
        yield Problem(("observer", "objective"), what, "max_period", allowed, hint)
    if family.method == "set":
        what, hint = "the set of matrices is built for one period", "leave method out: sensors send on change"
        yield Problem(("observer", "method"), what, "method set", hint=hint)
    if plant.output_quantities:
        k = plant.output_quantities[0].entry[0]
        name = plant.sampling.thresholds[k].name
        what = "a sensor that sends on change measures an output that is linear in the states"
        yield Problem((*_SENSORS, name), what, hint="give the sensor a period, or measure a state")
    yield from family.only_boxes(plant, "a message is sent when the output leaves its prediction, and noise alone does")


def why_none(plant: Plant) -> str:
    """Why no gain was found, or proved: mostly thresholds that noise alone passes."""
    for one in plant.sampling.thresholds:
        noise = 0.0 if plant.noise is None else float(plant.noise.sizes[one.output])
        if not float(one.delta) > 2 * noise:
            return (
                f"the threshold {one.delta} of {one.name} is not above twice its noise {noise:.6g}: a message may then "
                f"make the error larger, and noise alone may send for ever; take a threshold above {2 * noise:.6g}"
            )
    return "no gain with a proof was found; more effort, smaller slopes or another output may help"
