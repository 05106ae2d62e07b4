"""The block `measurement`: what is measured, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Tag

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber, Rows
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.boxes import MAX_STATES, ordered, shape_problem
from cdobs_cli.spec.noise_block import NoiseBlock, noise_problems
from cdobs_cli.spec.plant_block import PlantBlock


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
]


class MeasurementBlock(Block):
    """y_k = C x(t_k) + v_k, and when."""

    required: ClassVar[tuple[str, ...]] = ("sampling",)
    C: Rows | None = None
    sampling: SamplingField | None = None
    noise: NoiseBlock | None = None


def measurement_problems(
    measurement: MeasurementBlock, wrong_fields: set[str], plant: PlantBlock | None, states: tuple[str, ...] | None
) -> Iterator[Problem]:
    """C against the number of states, noise against the number of outputs, periods in order."""
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


def sampling_law(measurement: MeasurementBlock) -> SamplingLaw:
    """The noun of `measurement.sampling`; equal ends are a constant period."""
    law = measurement.sampling
    if isinstance(law, Periodic):
        return SamplingLaw.periodic(law.period)
    if isinstance(law, Aperiodic):
        equal = (law.max_period - law.shortest).sign() == 0
        return SamplingLaw.periodic(law.max_period) if equal else SamplingLaw("aperiodic", law.shortest, law.max_period)
    return SamplingLaw("updated")
