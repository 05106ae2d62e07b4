"""An observer as it is carried elsewhere: its equations, and what is called when something is read.

Where the gain depends on what was read and when, a schedule tells it from the times between calls alone; samples that
arrive late are told by tickets. No absolute time is kept, so that single precision does not wear out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from math import ceil

from cdobs_cli.delays import longest
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ONE, ZERO, Expression
from cdobs_cli.hybrid import Observer, OriginalStates
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

Rows = tuple[Expression, ...]
ELAPSED = "elapsed"
MOST_KEPT = 1024  # events of late samples
_LOOSE_PERIOD = 16  # samples that are kept where nothing bounds how many there are


@dataclass(frozen=True)
class Correction:
    """What is called when these sensors are read, with their outputs (by number) in this order.

    jumps: the states after it, over states, inputs and `y.k`; one, or as many as the schedule tells apart.
    """

    suffix: str
    sensors: tuple[str, ...]
    outputs: tuple[int, ...]
    jumps: tuple[Rows, ...]


@dataclass(frozen=True)
class Step:
    """An edge of the timed graph: what is read on it (the number of a correction, None where nothing arrives) and which
    jump of that correction it takes. Times in shortest periods."""

    source: int
    target: int
    low: float
    high: float
    correction: int | None
    jump: int


@dataclass(frozen=True)
class Schedule:
    """Which gain is used when: nodes with their lengths and the ages of sensors in them (low, high), and steps.

    base: the shortest period. start: the node in which a run begins, the correction and the jump of its first sample.
    sensors: of each correction the numbers of the sensors whose ages it sets to 0.
    """

    base: float
    lengths: tuple[float, ...]
    ages: tuple[tuple[tuple[float, float], ...], ...]
    steps: tuple[Step, ...]
    start: tuple[int, int, int]
    sensors: tuple[tuple[int, ...], ...]

    @property
    def count(self) -> int:
        """How many sensors have ages; 0 where these tell nothing."""
        return len(self.ages[0])


@dataclass(frozen=True)
class Late:
    """Samples whose values arrive later: sensors by name with the outputs that arrive together; expected: the outputs
    over states and inputs; kept: how many events are; samples: of a pattern that repeats, each its own jump."""

    sensors: tuple[tuple[str, tuple[int, ...]], ...]
    expected: Rows
    kept: int
    samples: tuple[Rows, ...]


@dataclass(frozen=True)
class Portable:
    """Everything that a writer needs. Names in expressions: those of `states`, `inputs`, and `y.k`.

    estimates: rows by name, x_hat or x_lower and x_upper, of `plant_states`. original: the user's states where the
    plant is in other coordinates. control: inputs that the observer sets, after each correction. trigger: a sample is
    due from 0 on. compares: by sensor that sends on change: it sends from 0 on; its own output is `y.k`.
    first_sample: whether the sample at the beginning corrects.
    """

    name: str
    plant_states: tuple[str, ...]
    states: tuple[str, ...]
    start: Rows
    flow: Rows
    inputs: tuple[str, ...]
    outputs: int
    corrections: tuple[Correction, ...]
    estimates: Mapping[str, Rows]
    control: Mapping[str, Expression] = field(default_factory=dict)
    trigger: Expression | None = None
    compares: tuple[tuple[str, int, Expression], ...] = ()
    stops: tuple[tuple[Expression, str], ...] = ()
    original: Mapping[str, Expression] = field(default_factory=dict)
    schedule: Schedule | None = None
    late: Late | None = None
    first_sample: bool = True

    @property
    def starts_from_box(self) -> bool:
        """Whether it starts from the ends of a box of x(0), and not from an estimate."""
        return any(name.startswith(("lower.", "upper.")) for row in self.start for name in row.variables)

    @property
    def rows(self) -> list[Expression]:
        """All estimates, one after the other."""
        return [row for rows in self.estimates.values() for row in rows]


def portable(name: str, plant: Plant, observer: Observer, design: Design, original: OriginalStates | None) -> Portable:
    """An observer as `Family.observer_as_run` gives it, under the law that it was designed for."""
    law = design.sampling
    observer = _with_elapsed(observer)
    corrections, numbers = _corrections(plant, observer, law)
    late = _late(plant, observer, law) if plant.delays else None
    told_apart = any(len(one.jumps) > 1 for one in corrections) and late is None
    x_hat = observer.estimates.get("x_hat")
    there = dict(zip(plant.states, x_hat or (), strict=False))
    return Portable(
        identifier(name), plant.states, observer.states, observer.start, observer.flow,
        tuple(source.name for source in plant.inputs), plant.p, corrections, observer.estimates, observer.control,
        observer.trigger, _compares(observer, law), observer.stops,
        {} if original is None or not there
        else {state: row.substitute(there) for state, row in original.inverse.items()},
        _schedule(law, corrections, numbers) if told_apart else None, late, observer.jump_at_start,
    )  # fmt: skip


def identifier(name: str) -> str:
    """A name that C and Python take, of any text."""
    word = re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").lower()
    return word if re.match(r"[a-z]\w*_\w", word) else f"observer_{word}".rstrip("_")


def _with_elapsed(observer: Observer) -> Observer:
    """The time since the last sample as a state of its own, where anything reads it."""
    rows = [*observer.flow, *observer.jump, *(row for jump in observer.jumps for row in jump)]
    rows += [*(row for rows in observer.estimates.values() for row in rows)]
    rows += [*observer.control.values(), *(condition for condition, _ in observer.stops)]
    rows += [] if observer.trigger is None else [observer.trigger]
    if not any(ELAPSED in row.variables for row in rows):
        return observer
    return replace(
        observer, states=(*observer.states, ELAPSED), start=(*observer.start, ZERO), flow=(*observer.flow, ONE),
        jump=(*observer.jump, ZERO), jumps=tuple((*jump, ZERO) for jump in observer.jumps),
    )  # fmt: skip


def _corrections(
    plant: Plant, observer: Observer, law: SamplingLaw
) -> tuple[tuple[Correction, ...], dict[int, tuple[int, int]]]:
    """One for each set of sensors that is read at once, and of each reading of the law its correction and jump."""
    everything = tuple(range(plant.p))
    if law.is_on_change:
        own = zip(_suffixes(one.name for one in law.thresholds), law.thresholds, observer.jumps, strict=True)
        return tuple(Correction(word, (one.name,), (one.output,), (jump,)) for word, one, jump in own), {}
    if not law.has_sensors:
        return (Correction("", (), everything, (observer.jump,)),), {}
    sets: dict[tuple[str, ...], tuple[tuple[int, ...], list[Rows]]] = {}
    numbers = {}
    for number, (reading, jump) in enumerate(zip(law.readings, observer.jumps, strict=True)):
        names = tuple(sensor.name for sensor in reading.sensors)
        jumps = sets.setdefault(names, (reading.outputs, []))[1]
        if jump not in jumps:
            jumps.append(jump)
        numbers[number] = list(sets).index(names), jumps.index(jump)
    suffixes = _suffixes("_".join(names) for names in sets)
    corrections = (
        Correction(suffix, names, outputs, tuple(jumps))
        for suffix, (names, (outputs, jumps)) in zip(suffixes, sets.items(), strict=True)
    )
    return tuple(corrections), numbers


def _suffixes(names: Iterable[str]) -> list[str]:
    """What stands behind an underscore for each name; equal words are told apart by numbers."""
    taken: list[str] = []
    for name in names:
        word = re.sub(r"[^A-Za-z0-9_]+", "_", name)
        others = (word, *(f"{word}_{k}" for k in range(2, len(taken) + 3)))
        taken.append(next(one for one in others if one not in taken))
    return taken


def _schedule(law: SamplingLaw, corrections: Sequence[Correction], numbers: Mapping[int, tuple[int, int]]) -> Schedule:
    graph = law.graph
    names = [sensor.name for sensor in law.sensors]
    steps = []
    for edge in graph.edges:
        correction, jump = (None, 0) if edge.reading is None else numbers[edge.reading]
        steps.append(Step(edge.source, edge.target, float(edge.low), float(edge.high), correction, jump))
    node, reading = graph.start
    ages = tuple(tuple((float(low), float(high)) for low, high in one.ages) for one in graph.nodes)
    return Schedule(
        float(law.base), tuple(float(one.length) for one in graph.nodes), ages, tuple(steps),
        (node, *numbers[reading]), tuple(tuple(map(names.index, one.sensors)) for one in corrections),
    )  # fmt: skip


def _compares(observer: Observer, law: SamplingLaw) -> tuple[tuple[str, int, Expression], ...]:
    own = zip(_suffixes(one.name for one in law.thresholds), law.thresholds, observer.compares, strict=True)
    return tuple((word, one.output, row) for word, one, row in own)


def _late(plant: Plant, observer: Observer, law: SamplingLaw) -> Late:
    estimates = dict(zip(plant.states, observer.estimates["x_hat"], strict=True))
    expected = tuple(row.substitute(estimates) for row in plant.outputs())
    words = _suffixes(one.name for one in plant.delays)
    sensors = tuple((word, one.outputs) for word, one in zip(words, plant.delays, strict=True))
    window, shortest = float(longest(plant.delays)) + float(law.T_max), float(law.T_min)
    samples = ceil(window / shortest) + 2 if shortest > 0 else _LOOSE_PERIOD
    return Late(sensors, expected, min(MOST_KEPT, 2 * samples + 2), observer.jumps or (observer.jump,))
