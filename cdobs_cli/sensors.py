"""Sensors with periods of their own: which of them are read when, as phases that repeat where they are in step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import gcd, lcm
from typing import Any, Literal

from cdobs_cli.records import dataclass

MAX_PHASES = 64  # samples of a hyperperiod
MAX_SENSORS = 16
MAX_LOST = 20  # samples in a row
Gains = Literal["by_phase", "by_sensor", "one"]
GAINS: tuple[Gains, ...] = ("by_phase", "by_sensor", "one")


@dataclass(frozen=True)
class Sensor:
    """Measures the outputs of these numbers at the times (offset + k every) T, k = 0, 1, .., with T the shortest period
    of all sensors: 0 <= offset < every; of these samples at most `lost` in a row are lost. Or, where `least` is given,
    again and again between least T and every T after the time before, and first so long after the time 0; with `lost`
    only at multiples of least T, of which so many in a row may be lost: every = (lost + 1) least."""

    name: str
    outputs: tuple[int, ...]
    every: Fraction
    offset: Fraction = Fraction(0)
    lost: int = 0
    least: Fraction | None = None

    @property
    def is_free(self) -> bool:
        """Whether it keeps no step."""
        return self.least is not None

    @property
    def longest(self) -> Fraction:
        """Between two samples that arrive, in T."""
        return self.every if self.is_free else self.every * (self.lost + 1)

    @property
    def step(self) -> Fraction | None:
        """Of which the times of all its samples are multiples (beside its offset), in T; None where they are not."""
        if self.least is None:
            return self.every
        return self.least if self.lost or self.least == self.every else None


@dataclass(frozen=True)
class Reading:
    """Sensors that are read at one sample, all at once."""

    sensors: tuple[Sensor, ...]

    @property
    def outputs(self) -> tuple[int, ...]:
        """Numbers of the outputs that are read, sensor by sensor."""
        return tuple(k for sensor in self.sensors for k in sensor.outputs)

    @property
    def name(self) -> str:
        """The sensors that are read: `camera+gyro`."""
        return "+".join(sensor.name for sensor in self.sensors)


@dataclass(frozen=True)
class Phase(Reading):
    """One sample of the hyperperiod: at `time` T after its beginning these sensors are read, and `gap` T later the next
    ones."""

    time: Fraction
    gap: Fraction


def hyperperiod(sensors: Sequence[Sensor]) -> Fraction:
    """After how many T the sensors are read as before: the least common multiple of their periods."""
    periods = [sensor.every for sensor in sensors]
    return Fraction(lcm(*(one.numerator for one in periods)), gcd(*(one.denominator for one in periods)))


def is_bounded(sensors: Sequence[Sensor]) -> bool:
    """Whether a hyperperiod has few enough samples: quick, whatever the periods."""
    H = hyperperiod(sensors)
    return all(H / sensor.every <= MAX_PHASES for sensor in sensors) and len(_instants(sensors)) <= MAX_PHASES


def _instants(sensors: Sequence[Sensor]) -> list[Fraction]:
    H = hyperperiod(sensors)
    counts = ((sensor, int(H / sensor.every)) for sensor in sensors)
    return sorted({sensor.offset + k * sensor.every for sensor, count in counts for k in range(count)})


def phases(sensors: Sequence[Sensor]) -> tuple[Phase, ...]:
    """The samples of one hyperperiod, from its beginning on."""
    times = _instants(sensors)
    ends = [*times[1:], hyperperiod(sensors) + times[0]]
    return tuple(
        Phase(tuple(one for one in sensors if is_read(one, time)), time, end - time)
        for time, end in zip(times, ends, strict=True)
    )


def is_read(sensor: Sensor, time: Fraction) -> bool:
    """Whether a sensor in step is read at this time, lost or not."""
    return (time - sensor.offset) % sensor.every == 0


def groups(of: Sequence[Reading], gains: Gains) -> tuple[int, ...]:
    """Of each sample the number of its gain: equal numbers where one gain (or columns of one) serves."""
    if gains == "by_phase":
        return tuple(range(len(of)))
    if gains == "one":
        return (0,) * len(of)
    names = list(dict.fromkeys(one.name for one in of))
    return tuple(names.index(one.name) for one in of)


def document(sensors: Sequence[Sensor]) -> list[dict[str, Any]]:
    """Periods and offsets as parts of the shortest period."""
    return list(map(_entry, sensors))


def _entry(one: Sensor) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": one.name, "outputs": list(one.outputs), "every": str(one.every)}
    if one.least is not None:
        entry |= {"least": str(one.least)}
    else:
        entry |= {"offset": str(one.offset)}
    return entry | ({"lost": one.lost} if one.lost else {})


def from_document(entries: Any) -> tuple[Sensor, ...]:
    """Raises: TypeError, ValueError, KeyError on anything `document` did not write."""
    if not isinstance(entries, list) or not 1 <= len(entries) <= MAX_SENSORS:
        raise ValueError("not a list of sensors")
    sensors = tuple(map(_sensor, entries))
    outputs = [k for sensor in sensors for k in sensor.outputs]
    names = {sensor.name for sensor in sensors}
    if sorted(outputs) != list(range(len(outputs))) or len(names) < len(sensors):
        raise ValueError("outputs and names that are not one sensor's each")
    if len({one.is_free for one in sensors}) > 1 or min(one.every for one in sensors) != 1:
        raise ValueError("periods that no sensors have")
    if not sensors[0].is_free and (min(one.offset for one in sensors) != 0):
        raise ValueError("periods that no sensors have")
    return sensors


def _sensor(entry: Any) -> Sensor:
    if not isinstance(entry, Mapping):
        raise ValueError("not a sensor")
    further = entry.keys() - {"name", "outputs", "every"}
    if further not in ({"least"}, {"least", "lost"}, {"offset"}, {"offset", "lost"}):
        raise ValueError("not a sensor")
    name, outputs, lost = entry["name"], entry["outputs"], entry.get("lost", 0)
    if not isinstance(name, str) or not isinstance(outputs, list) or not outputs:
        raise ValueError("not a sensor")
    if any(type(k) is not int or k < 0 for k in outputs) or type(lost) is not int:
        raise ValueError("outputs and losses are told by their numbers")
    every, offset = _fraction(entry["every"]), _fraction(entry.get("offset", "0"))
    least = _fraction(entry["least"]) if "least" in entry else None
    if every < 1 or not 0 <= offset < every or not ("lost" not in entry or 0 < lost <= MAX_LOST):
        raise ValueError("periods that no sensor has")
    if least is not None and not (0 < least <= every and (not lost or every == least * (lost + 1))):
        raise ValueError("periods that no sensor has")
    return Sensor(name, tuple(outputs), every, offset, lost, least)


def _fraction(text: Any) -> Fraction:
    if not isinstance(text, str) or len(text) > 400:
        raise ValueError("not a number")
    return Fraction(text)
