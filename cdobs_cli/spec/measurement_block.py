"""The block `measurement`: what is measured, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber, Rows
from cdobs_cli.sampling import MOST_LOST, SamplingLaw
from cdobs_cli.sensors import Gains
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.boxes import MAX_STATES, ordered, shape_problem
from cdobs_cli.spec.noise_block import NoiseBlock, noise_problems
from cdobs_cli.spec.plant_block import PlantBlock
from cdobs_cli.spec.sensors_block import (
    SensorsField,
    one_law,
    schedule,
    sends_on_change,
    sensor_problems,
    shortest_period,
    stacked_noise,
    stacked_outputs,
    stacked_rows,
    thresholds,
)


class Periodic(Block):
    """A measurement every `period`."""

    period: PositiveNumber


class Aperiodic(Block):
    """Measurements at least `min_period` and at most `max_period` apart."""

    min_period: NonNegativeNumber | None = None
    max_period: PositiveNumber

    @property
    def shortest(self) -> Exact:
        """`min_period`, 0 where it is not given."""
        return EXACT_ZERO if self.min_period is None else self.min_period


class Updated(Block):
    """The observer chooses its sampling instants."""

    updated: Literal[True]


def _law(value: Any) -> str:
    keys = set(value) if isinstance(value, dict) else set()
    if isinstance(value, Updated) or "updated" in keys:
        return "updated period"
    varies = isinstance(value, Aperiodic) or keys & {"min_period", "max_period"}
    return "varying period" if varies else "constant period"


SamplingField = Annotated[
    Annotated[Periodic, Tag("constant period")]
    | Annotated[Aperiodic, Tag("varying period")]
    | Annotated[Updated, Tag("updated period")],
    Discriminator(_law),
    BeforeValidator(one_law),
]


class LostBlock(Block):
    """Which samples of a constant period may be lost: so many in a row at most, or each with a probability."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["at_most"]}, {"required": ["probability"]}]})
    at_most: Annotated[
        Annotated[int, Field(strict=True, ge=0, le=MOST_LOST)] | None, Field(description="Lost in a row, at most.")
    ] = None
    probability: Annotated[
        NonNegativeNumber | None, Field(description="Of each sample to be lost, independently; below 1.")
    ] = None


class MeasurementBlock(Block):
    """y_k = C x(t_k) + v_k, and when; or the same of each sensor."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["sampling"]}, {"required": ["sensors"]}]})
    C: Rows | None = None
    sampling: SamplingField | None = None
    noise: NoiseBlock | None = None
    lost: LostBlock | None = None
    sensors: Annotated[
        SensorsField | None,
        Field(description="Instead of C, sampling and noise: sensors by name, with periods of their own."),
    ] = None
    gains: Annotated[
        Gains | None,
        Field(description="Of sensors: a gain for each sample of their common pattern, for each set of sensors that is "
              "read together, or one, of which a sample uses the columns of what is read."),
    ] = None  # fmt: skip

    @property
    def has_law(self) -> bool:
        """Whether it says when samples come."""
        return self.sampling is not None or self.sensors is not None


def measurement_problems(
    measurement: MeasurementBlock, wrong_fields: set[str], plant: PlantBlock | None, states: tuple[str, ...] | None
) -> Iterator[Problem]:
    """C against the number of states, noise against the number of outputs, periods in order; sensors one by one."""
    if measurement.sensors is not None or "sensors" in wrong_fields:
        dynamics = None if plant is None else plant.dynamics is not None
        yield from _beside_sensors(measurement, plant)
        yield from sensor_problems(measurement.sensors or {}, wrong_fields, states, dynamics)
        if measurement.gains is not None and sends_on_change(measurement.sensors or {}):
            what, hint = "goes with sensors that have periods", "each sensor that sends on change has its own gain"
            yield Problem(("measurement", "gains"), what, hint=hint)
        return
    if measurement.gains is not None:
        yield Problem(("measurement", "gains"), "goes with `sensors`, which are not given")
    if measurement.sampling is None and "sampling" not in wrong_fields:
        yield Problem(("measurement", "sampling"), "is required")
    if states is not None and measurement.C is not None:
        p, width = measurement.C.shape
        if width != len(states):
            yield from shape_problem(("measurement", "C"), (p, width), (p, len(states)), "a column for each state")
        if p > MAX_STATES:
            yield Problem(("measurement", "C"), f"at most {MAX_STATES} rows are taken", str(p))
    outputs = None if measurement.C is None else measurement.C.shape[0]
    if plant is not None and plant.output is not None:
        if outputs is not None and outputs != len(plant.output):
            what = "one row for each entry of plant.output is expected"
            yield Problem(("measurement", "C"), what, f"{outputs} rows", f"{len(plant.output)}")
        outputs = len(plant.output)
    elif measurement.C is None and "C" not in wrong_fields and plant is not None and plant.dynamics is None:
        yield Problem(("measurement", "C"), "is required")
    if measurement.noise is not None:
        yield from noise_problems(measurement.noise, ("measurement", "noise"), outputs)
    law = measurement.sampling
    if isinstance(law, Aperiodic) and not ordered(law.shortest, law.max_period):
        at, what = ("measurement", "sampling", "min_period"), "min_period is above max_period"
        yield Problem(at, what, str(law.shortest), f"at most {law.max_period}")
    if measurement.lost is not None:
        yield from _loss_problems(measurement.lost, wrong_fields)
    if measurement.lost is not None and law is not None and not isinstance(law, Periodic):
        what, hint = (
            "losses are counted in samples of a constant period",
            "else let max_period be the longest gap",
        )
        yield Problem(("measurement", "lost"), what, None, "with sampling: {period: ..}", hint)


def _beside_sensors(measurement: MeasurementBlock, plant: PlantBlock | None) -> Iterator[Problem]:
    """What each sensor has for itself."""
    for name in ("C", "sampling", "noise", "lost"):
        if getattr(measurement, name) is not None:
            taken = "period, offset" if name == "sampling" else name
            hint = "lost samples of sensors are not taken yet" if name == "lost" else f"give it to each sensor: {taken}"
            yield Problem(("measurement", name), "does not go with `sensors`", hint=hint)
    if plant is not None and plant.output is not None:
        yield Problem(("plant", "output"), "does not go with `sensors`", hint="give it to each sensor: output: [..]")


def together(plant: PlantBlock, measurement: MeasurementBlock) -> tuple[PlantBlock, MeasurementBlock]:
    """Sensors without problems as one output: plant and measurement with what all of them measure, and its noise."""
    sensors = measurement.sensors
    if sensors is None:
        return plant, measurement
    if plant.dynamics is not None:
        plant = plant.model_copy(update={"output": stacked_outputs(sensors, plant.states or ())})
    C = None if plant.dynamics is not None else stacked_rows(sensors)
    return plant, measurement.model_copy(update={"C": C, "noise": stacked_noise(sensors)})


def _loss_problems(lost: LostBlock, wrong_fields: set[str]) -> Iterator[Problem]:
    at = ("measurement", "lost")
    typed = [name for name in ("at_most", "probability") if getattr(lost, name) is not None]
    if len(typed) != 1 and "lost" not in wrong_fields:
        yield Problem(
            at, "one kind of loss is expected", " and ".join(typed) or None, "{at_most: 3} or {probability: 0.1}"
        )
    if lost.probability is not None and (lost.probability - Exact(1)).sign() != -1:
        yield Problem((*at, "probability"), "a probability below 1 is expected", str(lost.probability), "0 to 1, not 1")


def sampling_law(measurement: MeasurementBlock) -> SamplingLaw:
    """The noun of `measurement.sampling`, or of `sensors`; equal ends are a constant period."""
    if measurement.sensors is not None:
        sensors = measurement.sensors
        if sends_on_change(sensors):
            return thresholds(sensors)
        return SamplingLaw.multirate(shortest_period(sensors), schedule(sensors), measurement.gains or "by_phase")
    law = measurement.sampling
    if isinstance(law, Periodic):
        lost = measurement.lost
        if lost is not None and lost.probability is not None:
            return SamplingLaw.randomly(law.period, lost.probability)
        return SamplingLaw.periodic(law.period, (lost.at_most or 0) if lost else 0)
    if isinstance(law, Aperiodic):
        equal = (law.max_period - law.shortest).sign() == 0
        return SamplingLaw.periodic(law.max_period) if equal else SamplingLaw("aperiodic", law.shortest, law.max_period)
    return SamplingLaw("updated")
