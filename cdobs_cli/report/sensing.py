"""What is assumed of each sensor, in words; and the gains of samples that differ in what is read."""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.delays import ASSUMED_OF_LATE
from cdobs_cli.plant import Plant
from cdobs_cli.report.blocks import Block, Bullets, Grid, Paragraph
from cdobs_cli.report.model import Report
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Gains, Sensor

_GAINS: dict[Gains, str] = {
    "by_phase": "Each sample of the common pattern has a gain of its own.",
    "by_sensor": "Each set of sensors that is read together has a gain of its own.",
    "one": "All samples have one gain in common, of which each uses the columns of what is read.",
}


def assumed(report: Report) -> tuple[Block, ...]:
    """Of each sensor when it is read, what is lost and late, and its noise; of the law designed for."""
    law, unit, plant = report.design.sampling, report.labels.time, report.plant
    told = "What every claim takes for granted of the sensors:"
    if not law.has_sensors:
        every = tuple(range(plant.p))
        what = f"{_outputs(every)}: read {'' if plant.p == 1 else 'together '}{law.text(unit)}{_from_start(law)}"
        words = f"{what}; {_losses(law)}{_used(plant, every, unit)}; {_noise(plant, every)}"
        return (Paragraph(told), Bullets((_sentence(words),)), *_late(plant))
    items = []
    for sensor in law.sensors:
        what = f"{sensor.name} ({_outputs(sensor.outputs)}): {_when(sensor, law, unit)}"
        used = _used(plant, sensor.outputs, unit)
        items.append(_sentence(f"{what}; {_losses_of(sensor)}, {used}; {_noise(plant, sensor.outputs)}"))
    return (Paragraph(told), Bullets(tuple(items)), Paragraph(_pattern(law, unit)), *_late(plant))


def _when(sensor: Sensor, law: SamplingLaw, unit: str) -> str:
    if sensor.step is None:
        apart = f"{law.time(sensor.least or sensor.every)} to {law.time(sensor.every)} {unit} after the time before"
        return f"read again and again, {apart}, the first so long after 0, at instants that are known"
    if sensor.is_free:
        return f"read at multiples of {law.time(sensor.step)} {unit}, exactly then"
    period, first = (str(law.time(share)) for share in (sensor.every, sensor.offset))
    return f"read every {period} {unit}, first at {first} {unit}, exactly then"


def _losses_of(sensor: Sensor) -> str:
    return f"at most {sensor.lost} of its samples in a row are lost" if sensor.lost else "no sample is lost"


def _used(plant: Plant, outputs: Sequence[int], unit: str) -> str:
    """When a sample is known."""
    late = next((one for one in plant.delays if one.is_late and set(outputs) <= set(one.outputs)), None)
    return "each is used when it is taken" if late is None else f"each arrives {late.words(unit)}, never later"


def _late(plant: Plant) -> tuple[Block, ...]:
    return (Paragraph(ASSUMED_OF_LATE),) if plant.delays else ()


def _pattern(law: SamplingLaw, unit: str) -> str:
    if law.is_multirate:
        return f"The pattern of all samples repeats every {law.hyperperiod} {unit}. {_GAINS[law.gains]}"
    if law.gains != "by_phase":
        return _GAINS[law.gains]
    if any(sensor.is_free for sensor in law.sensors):
        return "The observer takes the gain by which sensor is read, and by how long ago the others were."
    if any(sensor.lost for sensor in law.sensors):
        return "The observer takes the gain by what arrives, and by what was lost before."
    return _GAINS["by_sensor"]


def _outputs(numbers: Sequence[int]) -> str:
    return ", ".join(f"y{k + 1}" for k in numbers)


def _sentence(text: str) -> str:
    return f"{text}."


def _from_start(law: SamplingLaw) -> str:
    if law.is_updated:
        return ""
    return ", first at 0, at instants that are known" if law.kind == "aperiodic" else ", first at 0, exactly then"


def _losses(law: SamplingLaw) -> str:
    """The law's own words say what is lost."""
    return "" if law.is_lossy or law.is_random else "no sample is lost, "


def _noise(plant: Plant, outputs: Sequence[int]) -> str:
    if plant.covariance is not None:
        R = plant.covariance
        parts = ", ".join(f"{R[k, k]} of v{k + 1}" for k in outputs)
        return f"white noise of mean 0, independent from sample to sample, of the variance {parts}"
    if plant.noise is not None:
        ends = plant.noise
        parts = ", ".join(f"v{k + 1} in [{ends.lower[k]}, {ends.upper[k]}]" for k in outputs)
        return f"noise that may be anything within {parts} at each sample"
    return "no noise"


def _time_of(law: SamplingLaw, number: int) -> str:
    """When this reading comes."""
    if law.is_multirate:
        return str(law.time(law.phases[number].time))
    edge = law.graph.into(number)
    low, high = str(law.time(edge.low)), str(law.time(edge.high))
    return low if low == high else f"{low} to {high}"


def gains_table(report: Report) -> Grid:
    """Of each sample that has gains of its own when it comes, what is read, and the columns of the gains."""
    law, states = report.design.sampling, report.plant.states
    rows = []
    for gain in report.design.gain.values():
        columns = iter(range(gain.shape[1]))
        for number, reading in enumerate(law.readings):
            time = _time_of(law, number)
            for sensor in reading.sensors:
                for k in sensor.outputs:
                    column = next(columns)
                    values = (str(gain[i, column]) for i in range(len(states)))
                    rows.append((time, f"{sensor.name} (y{k + 1})", *values))
    letter = next(iter(report.design.gain))
    since = "time in the pattern (s)" if law.is_multirate else "time since the sample before (s)"
    head = (report.labels.axis(since), "read", *(f"{letter} of {name}" for name in states))
    caption = "Each row is the column of the gain for what is read then, in the decimals that are run and proved."
    return Grid(head, tuple(rows), "Gains", caption)
