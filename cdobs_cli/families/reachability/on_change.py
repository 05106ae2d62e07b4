"""Sensors that send on change: what the family takes of them, and why no gain is found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.plant import Plant
from cdobs_cli.thresholds import Threshold

if TYPE_CHECKING:
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.families.reachability import Reachability

_SENSORS = ("measurement", "sensors")


def on_change_problems(family: Reachability, plant: Plant) -> Iterator[Problem]:
    """Objectives about periods, outputs that are not linear, signals that have no bound."""
    if family.objective in ("max_period", "decay_rate"):
        what = "sensors that send on change have no period" if family.objective == "max_period" else (
            "the rate has no end where sensors send on change, and the error grows with it"
        )  # fmt: skip
        hint = "min_error finds the gain of least error, with rate_at_least where a rate is asked for"
        yield Problem(("observer", "objective"), what, family.objective, "given_period or min_error", hint)
    if family.method == "set":
        what, hint = "the set of matrices is built for one period", "leave method out: sensors send on change"
        yield Problem(("observer", "method"), what, "method set", hint=hint)
    if plant.output_quantities:
        k = plant.output_quantities[0].entry[0]
        name = plant.sampling.thresholds[k].name
        what = "a sensor that sends on change measures an output that is linear in the states"
        yield Problem((*_SENSORS, name), what, hint="give the sensor a period, or measure a state")
    for problem in family.only_boxes(
        plant, "messages are sent when an output leaves its prediction, and noise alone does"
    ):
        of_noise = problem.field[0] == "measurement"
        yield replace(problem, field=_SENSORS) if of_noise else problem


def why_none(plant: Plant) -> str:
    """Why no gain was found: mostly thresholds that noise alone passes."""
    for one in plant.sampling.thresholds:
        noise = _noise(plant, one)
        if not float(one.delta) > noise:
            return (
                f"the threshold {one.delta} of {one.name} is not above its noise {noise:.6g}, which then sends "
                f"by itself and for ever; take a threshold above {noise:.6g}, better above {2 * noise:.6g}"
            )
    return "no gain with a proof was found; more effort, smaller slopes or another output may help"


def why_undecided(plant: Plant, K: ExactMatrix) -> str:
    """Why nothing is proved of a gain."""
    corrected = plant.C.floats @ K.floats
    for i, one in enumerate(plant.sampling.thresholds):
        c, delta, noise = float(corrected[i, i]), float(one.delta), _noise(plant, one)
        most = 2 - 2 * noise / delta
        if not 0 < c < most:
            allowed = f"from 0 to {most:.6g}" if most > 0 else "a threshold above the noise"
            return f"a message of {one.name} takes {c:.6g} of the error that it shows, where {allowed} is needed"
    return "no e'Pe was found that no message lets grow and that falls beyond the thresholds"


def _noise(plant: Plant, one: Threshold) -> float:
    return 0.0 if plant.noise is None else float(plant.noise.sizes[one.output])
