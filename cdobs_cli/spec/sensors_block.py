"""The block `measurement.sensors`: what each sensor measures and when, and all of them as one output."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo

from cdobs_cli.errors import Problem
from cdobs_cli.exact.expression import ZERO, Expression, ExpressionError, Variable
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix, decimal_text
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber, Rows, formula, sized, wrong
from cdobs_cli.graph import MAX_NODES, graph
from cdobs_cli.plant import weighted
from cdobs_cli.sampling import SamplingLaw, share_of
from cdobs_cli.sensors import MAX_LOST, MAX_PHASES, MAX_SENSORS, Sensor, hyperperiod, is_bounded
from cdobs_cli.spec.block import Block, Name
from cdobs_cli.spec.boxes import MAX_STATES, ordered, shape_problem
from cdobs_cli.spec.delay_field import DELAY_WORDS, DelayField
from cdobs_cli.spec.noise_block import NoiseBlock, noise_problems
from cdobs_cli.spec.reader import DecimalText, FieldPath, flow
from cdobs_cli.thresholds import Threshold

AT: FieldPath = ("measurement", "sensors")
_Outputs = Annotated[tuple[Annotated[Expression, formula("states", "inputs")], ...], sized(1, MAX_STATES)]


class LostBlock(Block):
    """Which samples of a constant period may be lost: so many in a row at most, or each with a probability."""

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["at_most"]}, {"required": ["probability"]}]})
    at_most: Annotated[
        Annotated[int, Field(strict=True, ge=0, le=MAX_LOST)] | None, Field(description="Lost in a row, at most.")
    ] = None
    probability: Annotated[
        NonNegativeNumber | None, Field(description="Of each sample to be lost, independently; below 1.")
    ] = None


class SensorBlock(Block):
    """What one sensor measures, every `period` from `offset` on, or at least `min_period` and at most `max_period`
    apart; or, with `send_on_delta`, when it is far from its prediction."""

    C: Annotated[Rows | None, Field(description="Its rows: it measures C x.")] = None
    output: Annotated[
        _Outputs | None, Field(description="With `dynamics`: what it measures, functions of states and inputs.")
    ] = None
    period: Annotated[PositiveNumber | None, Field(description="From one of its samples to the next.")] = None
    offset: Annotated[
        NonNegativeNumber | None, Field(description="When it is read first, below its period; 0 where left out.")
    ] = None
    min_period: Annotated[
        PositiveNumber | None, Field(description="Instead of a period: the least time between two of its samples.")
    ] = None
    max_period: Annotated[
        PositiveNumber | None, Field(description="And the longest; the sensor then keeps no step with others.")
    ] = None
    lost: Annotated[LostBlock | None, Field(description="How many of its samples may be lost in a row: at_most.")] = (
        None
    )
    noise: Annotated[
        NoiseBlock | None,
        Field(
            description="Of its outputs; none where left out. Of a sensor that sends on change it is drawn, in a "
            "simulation, after each message and held until the next, or drawn at each comparison."
        ),
    ] = None
    send_on_delta: Annotated[
        PositiveNumber | None,
        Field(
            description="Instead of a period: it sends when its output y is so far from C x_hat, which it knows by a "
            "copy of the observer. Of one output."
        ),
    ] = None
    check_every: Annotated[
        PositiveNumber | None,
        Field(
            description="With send_on_delta: it compares at multiples of this time, from 0 on; all the time where "
            "left out. The same of all sensors."
        ),
    ] = None
    delay: Annotated[DelayField | None, Field(description=f"{DELAY_WORDS} At once where left out.")] = None

    @property
    def is_reversed(self) -> bool:
        """Whether its least period is above its longest."""
        if self.min_period is None or self.max_period is None:
            return False
        share = share_of(self.min_period, self.max_period)
        return not ordered(self.min_period, self.max_period) if share is None else share > 1

    @property
    def most_lost(self) -> int:
        """In a row."""
        return 0 if self.lost is None else self.lost.at_most or 0

    @property
    def longest(self) -> Exact | None:
        """Between two of its samples that are not lost, where it keeps no step with others."""
        if self.max_period is not None:
            return self.max_period
        return None if self.period is None else self.period * Exact(self.most_lost + 1)

    @property
    def has_times(self) -> bool:
        """A period, or both ends of one."""
        return (self.period is None) != (self.max_period is None or self.min_period is None)

    @property
    def first(self) -> Exact:
        return EXACT_ZERO if self.offset is None else self.offset

    @property
    def rows(self) -> int:
        """How many outputs it has."""
        return len(self.output) if self.output is not None else 0 if self.C is None else self.C.shape[0]


def _named(value: Any) -> Any:
    if isinstance(value, list):
        sensors = [_rewritten(k, entry) for k, entry in enumerate(value)]
        raise wrong("sensors have names: a mapping is expected", f"write sensors: {{{', '.join(sensors)}}}")
    return value


def _rewritten(k: int, entry: Any) -> str:
    """A sensor of a list, as it is to be written."""
    known = entry if isinstance(entry, dict) else {}
    law = known.get("sampling", known)
    period = law.get("period") if isinstance(law, dict) else None
    kind = "output" if "output" in known else "C"
    seen = known.get(kind)
    return f"s{k + 1}: {{{kind}: {_text(seen)}, period: {_text(period)}}}"


def _text(value: Any) -> str:
    return ".." if value is None or isinstance(value, dict) else flow(value) or ".."


SensorsField = Annotated[dict[Name, SensorBlock], BeforeValidator(_named)]


def one_law(value: Any, info: ValidationInfo) -> Any:
    """A list of sampling laws is refused, and shown as sensors; a list of instants, and shown as an interval; keys of
    two laws at once."""
    if isinstance(value, dict):
        if (instants := next((name for name in _INSTANTS if name in value), None)) is not None:
            raise _listed(value[instants])
        _refuse_two_laws(value)
    if not isinstance(value, list):
        return value
    if value and not any(isinstance(one, dict | list) for one in value):
        raise _ends_of(value) if len(value) == 2 else _listed(value)
    C = info.data.get("C")
    rows = C.texts() if C is not None and C.shape[0] == len(value) else None
    listed = [None if rows is None else [[DecimalText(one) for one in row]] for row in rows or value]
    sensors = [_rewritten(k, {"C": listed[k], "sampling": law}) for k, law in enumerate(value)]
    what = "one law for all outputs is expected; outputs with periods of their own are sensors"
    raise wrong(what, f"write, for C and sampling, sensors: {{{', '.join(sensors)}}}")


_INSTANTS = ("times", "instants", "timestamps", "t_k", "sampling_times", "sample_times")


def _refuse_two_laws(value: dict[str, Any]) -> None:
    """A constant period, an interval of periods, and instants that the observer chooses exclude one another."""
    laws = [
        f"{{{', '.join(f'{name}: {_text(value[name])}' for name in names if name in value)}}}"
        for names in (("period",), ("min_period", "max_period"), ("updated",))
        if any(name in value for name in names)
    ]
    if len(laws) > 1:
        raise wrong(f"one law is expected, these are {len(laws)}", f"write sampling: {', or sampling: '.join(laws)}")


def _ends_of(ends: list[Any]) -> Exception:
    """Two numbers may be the ends of an interval of periods."""
    low, high = map(_text, ends)
    return wrong("a mapping is expected", f"write sampling: {{min_period: {low}, max_period: {high}}}")


def _listed(times: Any) -> Exception:
    """The error of instants one by one: what is proved is proved of a law."""
    ends = _gap_ends(times)
    low, high = ("..", "..") if ends is None else (decimal_text(end, 9) for end in ends)
    what = "a law of all instants is expected, not some of them"
    interval = f"write sampling: {{min_period: {low}, max_period: {high}}}, which holds all times with such gaps"
    shown = "and give those to be simulated by simulation.sampling_times, an expression of t_k"
    return wrong(what, f"{interval}, {shown}; a pattern that repeats is one of sensors with offsets")


def _gap_ends(times: Any) -> tuple[Fraction, Fraction] | None:
    """The shortest and the longest gap of a list of rising numbers; None of anything else."""
    if not isinstance(times, list) or not all(isinstance(one, str | int | float) for one in times):
        return None
    try:
        known = [Exact(str(one)).rational for one in times[:1000]]
    except (ExpressionError, ValueError):
        return None
    gaps = [b - a for a, b in pairwise(known) if a is not None and b is not None]
    return (min(gaps), max(gaps)) if gaps and len(gaps) == len(known) - 1 and min(gaps) > 0 else None


def sensor_problems(
    sensors: Mapping[str, SensorBlock], wrong_fields: set[str], states: tuple[str, ...] | None, dynamics: bool | None
) -> Iterator[Problem]:
    """Each sensor by itself, and all of them together; dynamics: whether the plant is typed so (None: not known)."""
    if not 1 <= len(sensors) <= MAX_SENSORS and not wrong_fields:
        yield Problem(AT, f"1 to {MAX_SENSORS} sensors are taken", str(len(sensors)))
    for name, sensor in sensors.items():
        yield from _problems_of_one(sensor, (*AT, name), states, dynamics)
    rows = sum(sensor.rows for sensor in sensors.values())
    if rows > MAX_STATES:
        yield Problem(AT, f"at most {MAX_STATES} outputs are taken", str(rows))
    yield from _noise_kinds(sensors)
    if sends_on_change(sensors):
        yield from _on_change_problems(sensors)
    elif sensors and all(one.has_times for one in sensors.values()):
        yield from _schedule_problems(sensors)


def _problems_of_one(
    sensor: SensorBlock, at: FieldPath, states: tuple[str, ...] | None, dynamics: bool | None
) -> Iterator[Problem]:
    if sensor.send_on_delta is not None:
        for name in ("period", "offset", "min_period", "max_period", "lost", "delay"):
            if getattr(sensor, name) is not None:
                what, hint = "does not go with send_on_delta", "check_every says how often it compares"
                yield Problem((*at, name), what, hint=hint)
        if sensor.rows > 1:
            what, hint = "one output sends for itself", "write a sensor for each, with thresholds of their own"
            yield Problem((*at, "send_on_delta"), what, f"{sensor.rows} outputs", "1 output", hint)
    elif sensor.check_every is not None:
        yield Problem((*at, "check_every"), "goes with send_on_delta, which is not given")
    if sensor.send_on_delta is None:
        yield from _problems_of_times(sensor, at)
    typed = [name for name in ("C", "output") if getattr(sensor, name) is not None]
    if len(typed) != 1:
        allowed = "output: [..] or C: [[..]]" if dynamics else "C: [[..]]"
        yield Problem(at, "what the sensor measures is expected, once", " and ".join(typed) or None, allowed)
    if sensor.output is not None and dynamics is False:
        yield Problem((*at, "output"), "goes with `dynamics`, which is not given", hint="write C: [[..]]")
    if sensor.C is not None and states is not None and sensor.C.shape[1] != len(states):
        wanted = (sensor.C.shape[0], len(states))
        yield from shape_problem((*at, "C"), sensor.C.shape, wanted, "a column for each state")
    if sensor.noise is not None:
        yield from noise_problems(sensor.noise, (*at, "noise"), sensor.rows or None)


def _problems_of_times(sensor: SensorBlock, at: FieldPath) -> Iterator[Problem]:
    if sensor.period is None and sensor.max_period is None:
        given = sensor.min_period is not None
        hint = None if given else "or send_on_delta: it sends when its output has changed; or min_period and max_period"
        yield Problem((*at, "max_period" if given else "period"), "is required", hint=hint)
    if sensor.period is not None and (sensor.max_period is not None or sensor.min_period is not None):
        what, hint = "period does not go with min_period and max_period", "write the one or the others"
        yield Problem((*at, "period"), what, hint=hint)
    if sensor.period is None and sensor.max_period is not None:
        if sensor.min_period is None:
            what, hint = "is required of a sensor among others", "the least time between two of its samples, above 0"
            yield Problem((*at, "min_period"), what, hint=hint)
        elif sensor.is_reversed:
            what = "min_period is above max_period"
            yield Problem((*at, "min_period"), what, str(sensor.min_period), f"at most {sensor.max_period}")
        if sensor.offset is not None:
            what, hint = (
                "goes with a period",
                "a sensor that keeps no step is read first between min_period and max_period after the time 0",
            )
            yield Problem((*at, "offset"), what, hint=hint)
        if sensor.lost is not None:
            hint = "else let max_period be the longest gap"
            yield Problem((*at, "lost"), "losses are counted in samples of a constant period", hint=hint)
    if sensor.period is not None and (sensor.period - sensor.first).sign() != 1:
        what, hint = "is not below the sensor's period", "an offset says when the sensor is read first"
        yield Problem((*at, "offset"), what, str(sensor.first), f"0 to {sensor.period}, which is left out", hint)
    if sensor.lost is not None and sensor.lost.probability is not None:
        what, hint = "of a sensor among others the losses in a row are taken", "write lost: {at_most: 3}"
        yield Problem((*at, "lost", "probability"), what, hint=hint)
    elif sensor.lost is not None and sensor.lost.at_most is None:
        yield Problem((*at, "lost"), "a number of losses is expected", None, "{at_most: 3}")


def sends_on_change(sensors: Mapping[str, SensorBlock]) -> bool:
    """Whether one of them does: then all do, or there are problems."""
    return any(sensor.send_on_delta is not None for sensor in sensors.values())


def _on_change_problems(sensors: Mapping[str, SensorBlock]) -> Iterator[Problem]:
    """All of them send on change, and compare at the same times."""
    times = [sensor.check_every for sensor in sensors.values() if sensor.send_on_delta is not None]
    first = times[0]
    for name, sensor in sensors.items():
        every = sensor.check_every
        if sensor.send_on_delta is None:
            if sensor.period is not None:
                what = "all sensors send on change, or none: periods are not mixed with thresholds"
                yield Problem((*AT, name, "period"), what, hint="write send_on_delta for each, or a period for each")
        elif (every is None) != (first is None) or (
            every is not None and first is not None and every != first and (every - first).sign() != 0
        ):
            what = "sensors that send on change compare at the same times"
            got, allowed = ("all the time" if one is None else str(one) for one in (every, first))
            at = (*AT, name) if every is None else (*AT, name, "check_every")
            yield Problem(at, what, got, allowed)


def _noise_kinds(sensors: Mapping[str, SensorBlock]) -> Iterator[Problem]:
    """Boxes with boxes, deviations with covariances."""
    boxed: str | None = None
    for name, sensor in sensors.items():
        if sensor.noise is None or len(sensor.noise.typed_kinds) != 1:
            continue
        kind = "a box" if sensor.noise.box is not None else "a covariance"
        if boxed is not None and kind != boxed:
            what, hint = "noise of all sensors is of one kind", "give each a box, or each a covariance (or std)"
            yield Problem((*AT, name, "noise"), what, kind, boxed, hint)
        boxed = boxed or kind


def _schedule_problems(sensors: Mapping[str, SensorBlock]) -> Iterator[Problem]:
    base = shortest_period(sensors)
    timed = [
        ((*AT, name, field), time)
        for name, sensor in sensors.items()
        for field in ("period", "offset", "min_period", "max_period")
        if (time := getattr(sensor, field)) is not None
    ]
    odd = [(at, time) for at, time in timed if share_of(time, base) is None]
    for at, time in odd:
        what = f"is no rational multiple of the shortest period, {base}"
        hint = "write periods and offsets in proportion, such as 0.1, 0.25 and 0.4, or min_period and max_period"
        yield Problem(at, what, str(time), hint=hint)
    free = any(sensor.max_period is not None for sensor in sensors.values())
    for name, sensor in sensors.items():
        if free and sensor.offset is not None and sensor.max_period is None:
            what, hint = "goes with sensors that all have a period", "where others keep no step leave it out"
            yield Problem((*AT, name, "offset"), what, str(sensor.offset), hint=hint)
    if odd or any(sensor.is_reversed for sensor in sensors.values()):
        return
    listed = schedule(sensors)
    if not any(sensor.is_free for sensor in listed) and not any(sensor.offset == 0 for sensor in listed):
        earliest = min(sensors, key=lambda name: float(sensors[name].first))
        what, hint = "time begins with a sample: one sensor has the offset 0", "take the least offset from all of them"
        yield Problem((*AT, earliest, "offset"), what, str(sensors[earliest].first), "0", hint)
    elif graph(listed) is None:
        yield Problem(AT, *_too_much(base, listed))


def _too_much(base: Exact, listed: Sequence[Sensor]) -> tuple[str, None, None, str]:
    if any(sensor.is_free for sensor in listed):
        what = f"too many orders of samples are possible: at most {MAX_NODES} situations are told apart"
        return what, None, None, "give the sensors less different periods, or fewer of them"
    if is_bounded(listed):
        what = f"too many patterns of losses are possible: at most {MAX_NODES} situations are told apart"
        return what, None, None, "let fewer samples be lost, or write min_period and max_period"
    what = f"the sensors are read as before only after {base * Exact(hyperperiod(listed))}"
    hint = "let all of them be multiples of one sensor's period, or small multiples of one another"
    return f"{what}: with at most {MAX_PHASES} samples until then", None, None, hint


def shortest_period(sensors: Mapping[str, SensorBlock]) -> Exact:
    """Of all sensors; of those that keep no step the longest that each may take."""
    free = any(sensor.max_period is not None for sensor in sensors.values())
    periods = (sensor.longest if free else sensor.period for sensor in sensors.values())
    return min((one for one in periods if one is not None), key=float)


def thresholds(sensors: Mapping[str, SensorBlock]) -> SamplingLaw:
    """The law of sensors that send on change; one without a threshold is left out."""
    found, every = [], None
    for sensor, (name, block) in enumerate(sensors.items()):
        if block.send_on_delta is not None:
            found.append(Threshold(name, sensor, block.send_on_delta))
            every = every or block.check_every
    return SamplingLaw.on_change(found, every)


def schedule(sensors: Mapping[str, SensorBlock]) -> list[Sensor]:
    """The nouns of sensors, outputs numbered through; one whose times are not in proportion is left out. One that keeps
    no step lets none of the others keep it."""
    base, first, listed = shortest_period(sensors), 0, []
    free = any(sensor.max_period is not None for sensor in sensors.values())
    for name, sensor in sensors.items():
        outputs = tuple(range(first, first + sensor.rows))
        first += sensor.rows
        longest, least = sensor.longest if free else sensor.period, sensor.min_period or sensor.period
        every, offset = None if longest is None else share_of(longest, base), share_of(sensor.first, base)
        between = None if least is None else share_of(least, base)
        if every is None or offset is None or between is None:
            continue
        listed.append(
            Sensor(name, outputs, every, lost=sensor.most_lost, least=between)
            if free
            else Sensor(name, outputs, every, offset, sensor.most_lost)
        )
    return listed


def stacked_rows(sensors: Mapping[str, SensorBlock]) -> ExactMatrix:
    """C of all sensors, shape (p, n)."""
    return ExactMatrix([row for sensor in sensors.values() if sensor.C is not None for row in sensor.C.rows])


def stacked_outputs(sensors: Mapping[str, SensorBlock], states: Sequence[str]) -> tuple[Expression, ...]:
    """What all sensors measure, as expressions over the states."""
    return tuple(one for sensor in sensors.values() for one in _outputs(sensor, states))


def _outputs(sensor: SensorBlock, states: Sequence[str]) -> tuple[Expression, ...]:
    if sensor.output is not None or sensor.C is None:
        return sensor.output or ()
    C, x = sensor.C, [Variable(name) for name in states]
    return tuple(sum(weighted(C, k, x), ZERO) for k in range(C.shape[0]))


def stacked_noise(sensors: Mapping[str, SensorBlock]) -> NoiseBlock | None:
    """The noise of all outputs: a box, or a covariance of blocks; 0 of a sensor without one."""
    noisy = [sensor.noise for sensor in sensors.values() if sensor.noise is not None]
    if not noisy:
        return None
    if noisy[0].box is not None:
        ends = [_ends(sensor) for sensor in sensors.values()]
        lower, upper = (tuple(end for pair in ends for end in pair[side]) for side in (0, 1))
        return NoiseBlock(lower=lower, upper=upper)
    return NoiseBlock(covariance=_blocks([_moment(sensor) for sensor in sensors.values()]))


def _ends(sensor: SensorBlock) -> tuple[tuple[Exact, ...], tuple[Exact, ...]]:
    box = None if sensor.noise is None else sensor.noise.box
    zero = (EXACT_ZERO,) * sensor.rows
    return (zero, zero) if box is None else (box.lower, box.upper)


def _moment(sensor: SensorBlock) -> ExactMatrix:
    moment = None if sensor.noise is None else sensor.noise.second_moment
    return ExactMatrix.diagonal([EXACT_ZERO] * sensor.rows) if moment is None else moment


def _blocks(matrices: Sequence[ExactMatrix]) -> ExactMatrix:
    """The block-diagonal matrix of these."""
    size, first, rows = sum(one.shape[0] for one in matrices), 0, []
    for one in matrices:
        after = size - first - one.shape[0]
        rows += [[EXACT_ZERO] * first + list(row) + [EXACT_ZERO] * after for row in one.rows]
        first += one.shape[0]
    return ExactMatrix(rows)
