"""A gain as it is typed: one matrix, or of sensors with periods of their own by what is read, or sample by sample; of
sensors that send on change by sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Plant
from cdobs_cli.sensors import Reading, Sensor

AT = ("observer", "gain", "K")
Typed = ExactMatrix | Mapping[str, ExactMatrix] | tuple[ExactMatrix, ...]
Columns = list[tuple[Exact, ...]]


def side_by_side(K: Typed) -> ExactMatrix:
    """The gains of all samples as one matrix; one matrix as it is. Those by sensors are first told apart by sample."""
    if isinstance(K, ExactMatrix):
        return K
    if isinstance(K, Mapping):
        raise TypeError("a gain by sensors belongs to a plant that has them: see `by_sample`")
    return _joined([column for one in K for column in _columns(one)])


def by_sample(K: Typed, plant: Plant) -> tuple[ExactMatrix, ...]:
    """The gain of each reading, (n, outputs read then), once `gain_problems` found nothing."""
    readings = plant.sampling.readings
    if isinstance(K, tuple):
        return K
    if isinstance(K, ExactMatrix):
        whole = _columns(K)
        return tuple(_joined([whole[k] for k in reading.outputs]) for reading in readings)
    return tuple(_of_reading(K, reading) for reading in readings)


def of_thresholds(K: Typed, plant: Plant) -> ExactMatrix:
    """The gains of sensors that send on change side by side, once `gain_problems` found nothing."""
    if isinstance(K, Mapping):
        return _joined([column for one in plant.sampling.thresholds for column in _columns(K[one.name])])
    return side_by_side(K)


def _of_reading(K: Mapping[str, ExactMatrix], reading: Reading) -> ExactMatrix:
    """The matrix of the set that is read, else the columns of its sensors."""
    key = _key_of(K, reading)
    if key is None:
        return _joined([column for sensor in reading.sensors for column in _columns(K[sensor.name])])
    named = {sensor.name: sensor for sensor in reading.sensors}
    columns, place = _columns(K[key]), dict[int, tuple[Exact, ...]]()
    for name in key.split("+"):  # in the order that is typed
        for k in named[name.strip()].outputs:
            place[k] = columns[len(place)]
    return _joined([place[k] for k in reading.outputs])


def _key_of(K: Mapping[str, ExactMatrix], reading: Reading) -> str | None:
    names = sorted(sensor.name for sensor in reading.sensors)
    return next((key for key in K if sorted(_names(key)) == names), None)


def _names(key: str) -> list[str]:
    return [name.strip() for name in key.split("+")]


def _columns(K: ExactMatrix) -> Columns:
    return list(zip(*K.rows, strict=True))


def _joined(columns: Columns) -> ExactMatrix:
    return ExactMatrix(list(zip(*columns, strict=True)))


def gain_problems(K: Typed, plant: Plant) -> Iterator[Problem]:
    """Shapes, and that every sample has its gain."""
    law, n = plant.sampling, plant.n
    if isinstance(K, ExactMatrix):
        if K.shape != (n, plant.p):
            what = "K has one row per state and one column per output"
            yield _misshapen(AT, what, K, n, plant.p)
    elif law.is_on_change and isinstance(K, Mapping):
        yield from _problems_by_thresholds(K, plant)
    elif not law.has_sensors:
        what = "gains of their own belong to sensors with periods of their own"
        yield Problem(AT, what, allowed=f"one matrix, {n} x {plant.p}", hint="or write measurement.sensors")
    elif isinstance(K, Mapping):
        yield from _problems_by_sensors(K, plant)
    else:
        yield from _problems_by_sample(K, plant)


def _problems_by_thresholds(K: Mapping[str, ExactMatrix], plant: Plant) -> Iterator[Problem]:
    names = [one.name for one in plant.sampling.thresholds]
    for key, matrix in K.items():
        if key not in names:
            what = "each sensor sends for itself: the name of one is expected"
            yield Problem((*AT, key), what, key, ", ".join(names))
        elif matrix.shape != (plant.n, 1):
            yield _misshapen((*AT, key), f"one row per state and one column, of {key}", matrix, plant.n, 1)
    missing = [name for name in names if name not in K]
    if missing:
        yield Problem(AT, "no gain for a sensor that sends", ", ".join(K) or None, ", ".join(missing))


def _problems_by_sample(K: tuple[ExactMatrix, ...], plant: Plant) -> Iterator[Problem]:
    readings = plant.sampling.readings
    read = ", ".join(reading.name for reading in readings)
    if len(K) != len(readings):
        what = f"a gain for each sample of the common pattern is expected, which reads {read} in turn"
        yield Problem(AT, what, f"{len(K)} gains", f"{len(readings)} gains")
        return
    for q, (one, reading) in enumerate(zip(K, readings, strict=True)):
        if one.shape != (plant.n, len(reading.outputs)):
            what = f"one row per state and one column per output of {reading.name}, which sample {q + 1} reads"
            yield _misshapen((*AT, q), what, one, plant.n, len(reading.outputs))


def _problems_by_sensors(K: Mapping[str, ExactMatrix], plant: Plant) -> Iterator[Problem]:
    readings = plant.sampling.readings
    sensors = {sensor.name: sensor for sensor in plant.sampling.sensors}
    read = list(dict.fromkeys(reading.name for reading in readings))
    for key, matrix in K.items():
        yield from _problems_of_key(key, matrix, sensors, plant)
    for name in read:
        reading = next(one for one in readings if one.name == name)
        missing = [sensor.name for sensor in reading.sensors if sensor.name not in K]
        if missing and _key_of(K, reading) is None:
            what = f"no gain for the samples that read {name}"
            yield Problem(AT, what, ", ".join(K) or None, f"{name}, or each of its sensors")
    alone = [key for key in K if set(_names(key)) <= sensors.keys() and not _is_used(key, readings)]
    for key in alone:
        what, allowed = "is no set of sensors that a sample reads", ", ".join(read)
        yield Problem((*AT, key), what, key, allowed)


def _is_used(key: str, readings: tuple[Reading, ...]) -> bool:
    names = _names(key)
    return len(names) == 1 or any(sorted(names) == sorted(one.name for one in reading.sensors) for reading in readings)


def _problems_of_key(key: str, matrix: ExactMatrix, sensors: Mapping[str, Sensor], plant: Plant) -> Iterator[Problem]:
    unknown = [name for name in _names(key) if name not in sensors]
    if unknown or len(set(_names(key))) < len(_names(key)):
        what = "names of different sensors are expected, joined by +"
        yield Problem((*AT, key), what, key, ", ".join(sensors))
        return
    outputs = sum(len(sensors[name].outputs) for name in _names(key))
    if matrix.shape != (plant.n, outputs):
        what = f"one row per state and one column per output of {key}"
        yield _misshapen((*AT, key), what, matrix, plant.n, outputs)


def _misshapen(at: tuple[str | int, ...], what: str, K: ExactMatrix, n: int, p: int) -> Problem:
    rows, columns = K.shape
    return Problem(at, what, got=f"{rows} x {columns}", allowed=f"{n} x {p}")
