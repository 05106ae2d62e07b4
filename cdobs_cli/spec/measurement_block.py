"""The block `measurement`: what is measured, and when."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag

from cdobs_cli.delays import Delay
from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber, Rows
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Gains, Sensor
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.boxes import MAX_STATES, ordered, shape_problem
from cdobs_cli.spec.delay_field import DELAY_WORDS, DelayField, Use, delays_problems, listed, overtaking_problem
from cdobs_cli.spec.noise_block import NoiseBlock, noise_problems
from cdobs_cli.spec.plant_block import PlantBlock
from cdobs_cli.spec.reader import DecimalText, flow
from cdobs_cli.spec.sensors_block import (
    LostBlock,
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

    period: PositiveNumber = Field(description="From each measurement to the next.")


class Aperiodic(Block):
    """Measurements at least `min_period` and at most `max_period` apart."""

    min_period: NonNegativeNumber | None = Field(
        default=None, description="The least time between two measurements; 0 where left out."
    )
    max_period: PositiveNumber = Field(description="The longest time between two measurements.")

    @property
    def shortest(self) -> Exact:
        """`min_period`, 0 where it is not given."""
        return EXACT_ZERO if self.min_period is None else self.min_period


class Updated(Block):
    """The observer chooses its sampling instants."""

    updated: Literal[True] = Field(description="The family updated_sampling says how the observer chooses them.")


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


class MeasurementBlock(Block):
    """y_k = C x(t_k) + v_k, and when; or the same of each sensor."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["sampling"]}, {"required": ["sensors"]}]})
    C: Rows | None = Field(
        default=None, description="What is measured, C x: a row for each output, a column for each state."
    )
    sampling: SamplingField | None = Field(
        default=None, description="When measurements are taken: {period}, {min_period, max_period} or {updated: true}."
    )
    noise: NoiseBlock | None = Field(
        default=None,
        description="What is added to each measurement and not known: a box, or of mean 0 and a covariance.",
    )
    lost: LostBlock | None = Field(default=None, description="With a constant period: which samples may be lost.")
    delay: Annotated[DelayField | None, Field(description=DELAY_WORDS)] = None
    delays: Annotated[
        Use | None, Field(description="What is done on arrival: the estimate is computed again from the stamp on.")
    ] = None
    sensors: Annotated[
        SensorsField | None,
        Field(description="Instead of C, sampling and noise: sensors by name, with periods of their own."),
    ] = None
    gains: Annotated[
        Gains | None,
        Field(description="Of sensors, and of samples that may be lost: a gain for each sample of the common pattern, "
              "and each time since the last that arrived; for each set of sensors that is read together; or one, of "
              "which a sample uses the columns of what is read."),
    ] = None  # fmt: skip

    @property
    def has_law(self) -> bool:
        """Whether it says when samples come."""
        return self.sampling is not None or self.sensors is not None

    @property
    def has_delay(self) -> bool:
        """Whether a delay is typed."""
        return self.delay is not None or any(one.delay is not None for one in (self.sensors or {}).values())


def measurement_problems(
    measurement: MeasurementBlock, wrong_fields: set[str], plant: PlantBlock | None, states: tuple[str, ...] | None
) -> Iterator[Problem]:
    """C against the number of states, noise against the number of outputs, periods in order; sensors one by one."""
    if not wrong_fields & {"delay", "sensors"}:
        yield from delays_problems(measurement.delays, measurement.has_delay, ("measurement", "delays"))
    if measurement.sensors is not None or "sensors" in wrong_fields:
        dynamics = None if plant is None else plant.dynamics is not None
        yield from _beside_sensors(measurement, plant)
        yield from sensor_problems(measurement.sensors or {}, wrong_fields, states, dynamics)
        if measurement.gains is not None and sends_on_change(measurement.sensors or {}):
            what, hint = "goes with sensors that have periods", "each sensor that sends on change has its own gain"
            yield Problem(("measurement", "gains"), what, hint=hint)
        return
    if measurement.gains is not None and (measurement.lost is None or not measurement.lost.at_most):
        what = "goes with `sensors`, or with lost samples: {at_most: ..}, which are not given"
        yield Problem(("measurement", "gains"), what)
    if measurement.sampling is None and "sampling" not in wrong_fields:
        yield Problem(("measurement", "sampling"), "is required")
    if states is not None and measurement.C is not None:
        yield from _shape_of_rows(measurement.C, len(states))
    C = without_misshapen(measurement, states).C
    outputs = None if C is None else C.shape[0]
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
    if measurement.delay is not None:
        yield from _delay_problems(measurement.delay, law)
    if measurement.lost is not None:
        yield from _loss_problems(measurement.lost, wrong_fields)
    if measurement.lost is not None and law is not None and not isinstance(law, Periodic):
        what, hint = (
            "losses are counted in samples of a constant period",
            "else let max_period be the longest gap",
        )
        yield Problem(("measurement", "lost"), what, None, "with sampling: {period: ..}", hint)


def _shape_of_rows(C: ExactMatrix, n: int) -> Iterator[Problem]:
    p, width = C.shape
    at = ("measurement", "C")
    if p == n != width:
        shown = flow([[DecimalText(one) for one in row] for row in zip(*C.texts(), strict=True)])
        hint = "a row for each output, a column for each state" + (f": write C: {shown}" if shown else "")
        what = "a matrix of another shape is expected"
        yield Problem(at, what, f"{p} x {width}", f"{width} x {n}", hint)
    elif width != n:
        yield from shape_problem(at, (p, width), (p, n), "a column for each state")
    if p > MAX_STATES:
        yield Problem(at, f"at most {MAX_STATES} rows are taken", str(p))


def without_misshapen(measurement: MeasurementBlock, states: tuple[str, ...] | None) -> MeasurementBlock:
    """The block without a C that does not fit the states: how many outputs there are is then not known."""
    misshapen = states is not None and measurement.C is not None and measurement.C.shape[1] != len(states)
    return measurement.model_copy(update={"C": None}) if misshapen else measurement


def _beside_sensors(measurement: MeasurementBlock, plant: PlantBlock | None) -> Iterator[Problem]:
    """What each sensor has for itself."""
    for name in ("C", "sampling", "noise", "lost", "delay"):
        if getattr(measurement, name) is not None:
            taken = "period, offset" if name == "sampling" else name
            hint = f"give it to each sensor: {taken}"
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


def _delay_problems(delay: tuple[Exact, Exact], law: SamplingField | None) -> Iterator[Problem]:
    at = ("measurement", "delay")
    if isinstance(law, Updated):
        what = "does not go with instants that the observer chooses: it would choose them by a late estimate"
        yield Problem(at, what, hint="write sampling: {period: ..}, or {min_period: .., max_period: ..}")
    elif isinstance(law, Aperiodic):
        yield from overtaking_problem(delay, law.shortest, at)


def late(measurement: MeasurementBlock, outputs: int) -> tuple[Delay, ...]:
    """The nouns of the delays, of a block without problems; none where nothing is late."""
    if measurement.sensors is None:
        return listed([("", outputs)], {"": measurement.delay})
    sensors = measurement.sensors
    return listed([(name, one.rows) for name, one in sensors.items()], {k: one.delay for k, one in sensors.items()})


def sampling_law(measurement: MeasurementBlock, outputs: int | None) -> SamplingLaw:
    """The noun of `measurement.sampling`, or of `sensors`; equal ends are a constant period. outputs: how many there
    are."""
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
        if lost is not None and lost.at_most and measurement.gains == "by_phase":
            one = Sensor("y", tuple(range(outputs or 0)), Fraction(1), lost=lost.at_most)
            return SamplingLaw.multirate(law.period, [one])
        return SamplingLaw.periodic(law.period, (lost.at_most or 0) if lost else 0)
    if isinstance(law, Aperiodic):
        equal = (law.max_period - law.shortest).sign() == 0
        return SamplingLaw.periodic(law.max_period) if equal else SamplingLaw("aperiodic", law.shortest, law.max_period)
    return SamplingLaw("updated")
