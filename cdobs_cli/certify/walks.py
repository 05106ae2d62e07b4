"""Ways through a timed graph that end where they began, and what is read on them: the periods of words.

Of sensors in step those of few steps; of sensors that keep none schedules of periods in simple proportions, which is
what the observer does along them once their ages have settled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from itertools import islice, product

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.graph import Edge, Graph, graph
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Phase, Sensor, is_bounded, phases

Steps = tuple[tuple[Fraction, Edge], ...]
_MOST_WALKS = 120
_COUNTS, _OFFSETS = (1, 2, 3, 4, 5, 6), (Fraction(1, 2), Fraction(1, 8))


@dataclass(frozen=True)
class Walk:
    """The time of each step, and what is read at its end: numbers of readings, None where nothing arrives."""

    gaps: tuple[Exact, ...]
    readings: tuple[int | None, ...]


def walks(law: SamplingLaw) -> list[Walk]:
    """Short ones first."""
    return [
        Walk(tuple(law.base * Exact(clock) for clock, _ in steps), tuple(edge.reading for _, edge in steps))
        for steps in _steps(law.sensors)
    ]


@lru_cache(maxsize=8)
def _steps(sensors: tuple[Sensor, ...]) -> tuple[Steps, ...]:
    """The same in shortest periods."""
    timed = graph(sensors)
    if timed is None:
        return ()
    if any(one.is_free for one in sensors):
        found = (_settled(timed, sensors, of) for of in islice(_schedules(sensors), 4 * _MOST_WALKS))
        known = dict.fromkeys(steps for steps in found if _is_run(timed, steps, sensors))
        return tuple(known)[:_MOST_WALKS]
    if not is_bounded(sensors):
        return ()
    return tuple(tuple((edge.low, edge) for edge in edges) for edges in islice(_closed(timed), _MOST_WALKS))


def _is_run(timed: Graph, steps: Steps, sensors: Sequence[Sensor]) -> bool:
    """Whether the sensors may go so for ever."""
    return timed.repeats([clock for clock, _ in steps], [edge.reading for _, edge in steps], sensors)


def _closed(graph: Graph) -> Iterator[tuple[Edge, ...]]:
    """Ways that come back to their first node, through no node twice; each once, those of few steps first."""
    ways: list[tuple[Edge, ...]] = [(edge,) for edge in graph.edges]
    while ways:
        yield from (way for way in ways if way[-1].target == way[0].source)
        ways = [
            (*way, edge)
            for way in ways[: 20 * _MOST_WALKS]
            if way[-1].target != way[0].source
            for edge in graph.leaving(way[-1].target)
            if edge.target not in {one.source for one in way[1:]} and edge.target >= way[0].source
        ]


def _schedules(sensors: Sequence[Sensor]) -> Iterator[tuple[Phase, ...]]:
    """Of sensors that keep no step: periods at and between their ends, in simple proportions, with some offsets."""
    first, *others = sensors
    for period in _between(first):
        choices = [list(_in_proportion(other, period)) for other in others]
        for chosen in product(*choices):
            moved = product(*((Fraction(0), *(every * share for share in _OFFSETS)) for every in chosen))
            for offsets in moved:
                own = [replace(first, every=period, least=None)]
                own += [
                    replace(one, every=every, offset=offset, least=None)
                    for one, every, offset in zip(others, chosen, offsets, strict=True)
                ]
                if is_bounded(own):
                    yield _in_turn(phases(own))


def _between(sensor: Sensor) -> list[Fraction]:
    least = sensor.every if sensor.least is None else sensor.least
    between = (sensor.every + least) / 2 if sensor.step is None else least * 2
    return list(dict.fromkeys(one for one in (sensor.every, least, between) if one <= sensor.every))


def _in_proportion(sensor: Sensor, period: Fraction) -> Iterator[Fraction]:
    """Periods of this sensor in simple proportion to one, the longest first."""
    least = sensor.every if sensor.least is None else sensor.least
    made = {period * Fraction(a, b) for a, b in product(_COUNTS, _COUNTS)} | {sensor.every}
    fitting = (one for one in made if least <= one <= sensor.every and (sensor.step is None or one % sensor.step == 0))
    yield from islice(sorted(fitting, reverse=True), 4)


def _in_turn(of: Sequence[Phase]) -> tuple[Phase, ...]:
    """Sensors that are read at once, one after the other."""
    turned: list[Phase] = []
    for phase in of:
        turned += [Phase((one,), phase.time, Fraction(0)) for one in phase.sensors[:-1]]
        turned.append(Phase(phase.sensors[-1:], phase.time, phase.gap))
    return tuple(turned)


def _settled(timed: Graph, sensors: Sequence[Sensor], of: tuple[Phase, ...]) -> Steps:
    """A schedule as the graph takes it from the second time on, with the ages as they are then; empty where it does
    not."""
    names = [sensor.name for sensor in sensors]
    ages, node, steps = dict.fromkeys(names, Fraction(0)), None, list[tuple[Fraction, Edge]]()
    for turn in range(3):
        for q, phase in enumerate(of):
            clock, name = of[q - 1].gap, phase.sensors[0].name
            ages = {one: Fraction(0) if one == name else age + clock for one, age in ages.items()}
            known = [ages[one] for one in names]
            if turn == 0:
                continue
            if node is None:
                node = timed.standing(names.index(name), known)
                continue
            edge = timed.next(node, clock, [name], known)
            if edge is None:
                return ()
            node = edge.target
            steps.append((clock, edge))
    return tuple(steps[-len(of) :]) if len(steps) >= len(of) else ()
