"""The timed graph of sensors: what may be read when, as nodes with a clock and edges between them.

A run stands in a node while the clock, the time since the last sample, grows; at a sample it takes an edge whose guard
[low, high] holds the clock, some sensors are read (or all that were to be read are lost), and the clock begins anew.
Every run of the sensors is one of the graph. Of sensors in step the opposite holds as well; of sensors that keep no
step nodes tell their ages, the times since each was read, within bins only. Times are parts of the sensors' shortest
period.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from fractions import Fraction
from functools import cached_property
from itertools import combinations, pairwise, product
from math import gcd, prod

from cdobs_cli.records import dataclass
from cdobs_cli.sensors import Reading, Sensor, is_bounded, phases

MAX_NODES, MAX_EDGES = 64, 256
_MOST_BINS = (16, 8, 6, 4, 3, 2, 1)  # of the ages of a sensor
Ages = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class Node:
    """How long the clock may run; of sensors that keep no step within which bins the age of each is as it begins, and
    the number of the one that was read last."""

    length: Fraction
    ages: tuple[Ages, ...] = ()
    last: int | None = None


@dataclass(frozen=True)
class Edge:
    """From `source` to `target` with the clock in [low, high]; reading: the number of what is read, None where nothing
    arrives."""

    source: int
    target: int
    low: Fraction
    high: Fraction
    reading: int | None


@dataclass(frozen=True)
class Graph:
    """start: the node in which a run begins, after a sample of this reading. Each reading is of one edge."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]
    readings: tuple[Reading, ...]
    start: tuple[int, int]

    @cached_property
    def breaks(self) -> tuple[tuple[Fraction, ...], ...]:
        """Of each node 0, the ends of the guards, and its length."""
        ends = [{Fraction(0), node.length} for node in self.nodes]
        for edge in self.edges:
            ends[edge.source] |= {edge.low, edge.high}
        return tuple(tuple(sorted(one)) for one in ends)

    @cached_property
    def shortest(self) -> Fraction:
        """Of the times between two samples."""
        return min(edge.low for edge in self.edges)

    @cached_property
    def longest(self) -> Fraction:
        return max(node.length for node in self.nodes)

    def into(self, reading: int) -> Edge:
        """The edge on which it is read."""
        return self._by_reading[reading]

    @cached_property
    def _by_reading(self) -> dict[int | None, Edge]:
        return {edge.reading: edge for edge in self.edges}

    def leaving(self, node: int) -> Iterator[Edge]:
        return (edge for edge in self.edges if edge.source == node)

    def next(self, node: int, clock: Fraction, read: Sequence[str], ages: Sequence[Fraction] = ()) -> Edge | None:
        """The edge of a run that stands in a node, as the clock shows so much and these sensors are read, whose ages
        are so much then; None where no run goes so. Of several, the first."""
        for edge in self.leaving(node):
            names = () if edge.reading is None else tuple(one.name for one in self.readings[edge.reading].sensors)
            within = zip(self.nodes[edge.target].ages, ages, strict=False)
            if names == tuple(read) and edge.low <= clock <= edge.high and all(a <= x <= b for (a, b), x in within):
                return edge
        return None

    def standing(self, last: int, ages: Sequence[Fraction]) -> int | None:
        """The node just after sensor number `last` was read, by the ages of all."""
        for number, node in enumerate(self.nodes):
            if node.last == last and all(low <= age <= high for (low, high), age in zip(node.ages, ages, strict=True)):
                return number
        return None

    def repeats(self, clocks: Sequence[Fraction], readings: Sequence[int | None], sensors: Sequence[Sensor]) -> bool:
        """Whether a run of these sensors may take such steps again and again, the observer's gains being these."""
        if not clocks or len(clocks) != len(readings):
            return False
        if any(sensor.is_free for sensor in sensors):
            return self._settles(clocks, readings, sensors)
        return is_bounded(sensors) and any(self._returns(q, clocks, readings) for q in range(len(self.nodes)))

    def _returns(self, first: int, clocks: Sequence[Fraction], readings: Sequence[int | None]) -> bool:
        node = first
        for clock, reading in zip(clocks, readings, strict=True):
            edges = [one for one in self.leaving(node) if one.reading == reading and one.low <= clock <= one.high]
            if not edges:
                return False
            node = edges[0].target
        return node == first

    def _settles(self, clocks: Sequence[Fraction], readings: Sequence[int | None], sensors: Sequence[Sensor]) -> bool:
        """Every sensor keeps its law from one of its samples to the next, those that keep a step have a common time 0,
        and each step takes the first edge that the ages allow."""
        edges = [self._by_reading.get(reading) for reading in readings]
        chosen = [edge for edge in edges if edge is not None and edge.reading is not None]
        if len(chosen) < len(clocks) or any(clock < 0 for clock in clocks):
            return False
        read = [self.readings[edge.reading].sensors[0].name for edge in chosen if edge.reading is not None]
        names, total = [sensor.name for sensor in sensors], sum(clocks, Fraction(0))
        ages, at, now = dict.fromkeys(names, total), dict[str, Fraction](), Fraction(0)
        for turn in range(2):
            for k, (clock, edge) in enumerate(zip(clocks, chosen, strict=True)):
                ages, now = {name: age + clock for name, age in ages.items()}, now + clock
                sensor = next(one for one in sensors if one.name == read[k])
                if turn and not _is_due(sensor, ages[sensor.name]):
                    return False
                ages[sensor.name], at[sensor.name] = Fraction(0), now
                known = [ages[name] for name in names]
                if turn and (
                    edge.source != chosen[k - 1].target or self.next(edge.source, clock, [read[k]], known) != edge
                ):
                    return False
        return set(read) == set(names) and _have_begun(sensors, at)


def _is_due(sensor: Sensor, age: Fraction) -> bool:
    """Whether it may be read so long after the time before."""
    in_step = sensor.step is None or age % sensor.step == 0
    return in_step and (sensor.least or sensor.every) <= age <= sensor.every


def _have_begun(sensors: Sequence[Sensor], at: Mapping[str, Fraction]) -> bool:
    """Whether sensors that are read at these times can all have had the age 0 at one time before: those that keep a
    step are a multiple of it from there. Pairs are enough (Chinese remainders)."""
    steps = [(at[one.name], one.step) for one in sensors if one.step is not None]
    return all((a - b) % _common(p, q) == 0 for (a, p), (b, q) in combinations(steps, 2))


def _common(a: Fraction, b: Fraction) -> Fraction:
    """The largest of which both are multiples."""
    return Fraction(gcd(a.numerator * b.denominator, b.numerator * a.denominator), a.denominator * b.denominator)


@dataclass
class _Growing:
    """A graph as it is made, from its first node on."""

    nodes: dict[tuple[object, ...], Node] = field(default_factory=dict)
    edges: list[Edge] = field(default_factory=list)
    readings: list[Reading] = field(default_factory=list)

    def number(self, key: tuple[object, ...], node: Node) -> int:
        self.nodes.setdefault(key, node)
        return list(self.nodes).index(key)

    def read(self, sensors: tuple[Sensor, ...]) -> int | None:
        """A reading of its own."""
        if not sensors:
            return None
        self.readings.append(Reading(sensors))
        return len(self.readings) - 1

    @property
    def is_large(self) -> bool:
        return len(self.nodes) > MAX_NODES or len(self.edges) > MAX_EDGES

    def done(self, start: tuple[int, int]) -> Graph:
        return Graph(tuple(self.nodes.values()), tuple(self.edges), tuple(self.readings), start)


def graph(sensors: Sequence[Sensor]) -> Graph | None:
    """None where it has too many nodes or edges."""
    if any(sensor.is_free for sensor in sensors):
        return _out_of_step(sensors)
    if not is_bounded(sensors):
        return _one_node(sensors)
    return _with_losses(sensors) if any(sensor.lost for sensor in sensors) else _cycle(sensors)


def _cycle(sensors: Sequence[Sensor]) -> Graph:
    """Each sample of the hyperperiod follows the one before."""
    of = phases(sensors)
    edges = tuple(Edge((q - 1) % len(of), q, of[q - 1].gap, of[q - 1].gap, q) for q in range(len(of)))
    return Graph(tuple(Node(phase.gap) for phase in of), edges, of, (0, 0))


def _with_losses(sensors: Sequence[Sensor]) -> Graph | None:
    """Nodes: the sample of the hyperperiod, and how many samples of each sensor were lost just before."""
    of, growing = phases(sensors), _Growing()
    place = {sensor: k for k, sensor in enumerate(sensors)}

    def node(q: int, lost: tuple[int, ...]) -> int:
        return growing.number((q, lost), Node(of[q].gap))

    node(0, (0,) * len(sensors))
    done = 0
    while done < len(growing.nodes):
        q, lost = list(growing.nodes)[done]
        assert isinstance(q, int) and isinstance(lost, tuple)
        after = (q + 1) % len(of)
        may = [one for one in of[after].sensors if lost[place[one]] < one.lost]
        for count in range(len(may) + 1):
            for missed in combinations(may, count):
                arrived = tuple(one for one in of[after].sensors if one not in missed)
                counts = tuple(
                    lost[k] + 1 if one in missed else 0 if one in arrived else lost[k] for one, k in place.items()
                )
                reading = growing.read(arrived)
                growing.edges.append(Edge(done, node(after, counts), of[q].gap, of[q].gap, reading))
        if growing.is_large:
            return None
        done += 1
    return growing.done(_whole(growing, len(of)))


def _whole(growing: _Growing, count: int) -> tuple[int, int]:
    """The first node, and what is read on the way into it with nothing lost."""
    keys = list(growing.nodes)
    before = keys.index(((count - 1) % count, keys[0][1]))
    arrived = (edge.reading for edge in growing.edges if edge.source == before and edge.target == 0)
    return 0, next(reading for reading in arrived if reading is not None)


def _one_node(sensors: Sequence[Sensor]) -> Graph | None:
    """Of a long hyperperiod whose samples are all those of one sensor: at each any others may be read, or none."""
    fast = [one for one in sensors if one.every == 1 and not one.offset]
    others = [one for one in sensors if not (one.every == 1 and not one.offset)]
    in_step = all(one.every.denominator == one.offset.denominator == 1 for one in others)
    if not fast or not in_step or any(one.lost for one in sensors) or 2 ** len(others) > MAX_NODES:
        return None
    growing, one = _Growing(), Fraction(1)
    growing.number((), Node(one))
    for count in range(len(others) + 1):
        for chosen in combinations(others, count):
            read = tuple(sensor for sensor in sensors if sensor in fast or sensor in chosen)
            growing.edges.append(Edge(0, 0, one, one, growing.read(read)))
    first = {sensor.name for sensor in sensors if not sensor.offset}
    names = [{sensor.name for sensor in reading.sensors} for reading in growing.readings]
    return growing.done((0, names.index(first)))


def _out_of_step(sensors: Sequence[Sensor]) -> Graph | None:
    """Nodes: the sensor that was read last, and bins of the ages of the others then; as fine as there is room for."""
    for most in _MOST_BINS:
        made = _in_bins(sensors, [_bins(sensor, most) for sensor in sensors])
        if made is not None:
            return made
    return None


def _in_bins(sensors: Sequence[Sensor], bins: Sequence[Sequence[Ages]]) -> Graph | None:
    if len(sensors) * prod(map(len, bins)) > MAX_NODES * max(map(len, bins)):
        return None
    growing, none = _Growing(), (Fraction(0), Fraction(0))

    def node(last: int, ages: tuple[Ages, ...]) -> int:
        length = min(one.every - low for one, (low, _) in zip(sensors, ages, strict=True))
        return growing.number((last, ages), Node(length, ages, last))

    node(0, tuple(none if k == 0 else own[0] for k, own in enumerate(bins)))
    done = 0
    while done < len(growing.nodes):
        here = list(growing.nodes.values())[done]
        for o, sensor in enumerate(sensors):
            chosen = product(*([none] if k == o else own for k, own in enumerate(bins)))
            guards = [(ages, _guard(here, sensor, o, ages)) for ages in chosen]
            for ages, (low, high) in guards:
                if low <= high and not _is_touched(here, o, ages, low, high, guards):
                    growing.edges.append(Edge(done, node(o, ages), low, high, growing.read((sensor,))))
        if growing.is_large:
            return None
        done += 1
    reading = next(edge.reading for edge in growing.edges if edge.target == 0 and edge.reading is not None)
    return growing.done((0, reading))


def _guard(here: Node, sensor: Sensor, o: int, ages: Sequence[Ages]) -> Ages:
    """When sensor number o may be read and the ages of the others be in these bins: each is what it was and the
    clock."""
    pairs = [pair for k, pair in enumerate(zip(ages, here.ages, strict=True)) if k != o]
    least = Fraction(0) if sensor.least is None else sensor.least
    low = max(Fraction(0), least - here.ages[o][1], *(low - old[1] for (low, _), old in pairs))
    return low, min(here.length, *(high - old[0] for (_, high), old in pairs))


def _is_touched(
    here: Node,
    o: int,
    ages: Sequence[Ages],
    low: Fraction,
    high: Fraction,
    guards: Sequence[tuple[Sequence[Ages], Ages]],
) -> bool:
    """Whether bins are met at one time only, where the ages lie in other bins as well."""
    if low < high:
        return False
    met = [(max(a, old[0] + low), min(b, old[1] + low)) for (a, b), old in zip(ages, here.ages, strict=True)]
    return any(
        first <= low <= last and first < last
        and all(k == o or (a <= x and y <= b) for k, ((a, b), (x, y)) in enumerate(zip(other, met, strict=True)))
        for other, (first, last) in guards
    )  # fmt: skip


def _bins(sensor: Sensor, most: int) -> list[Ages]:
    """Ages of a sensor as another is read, in equal parts of about half of the shortest period, so many at most."""
    count = min(most, max(1, round(sensor.every * 2)))
    return list(pairwise(sensor.every * k / count for k in range(count + 1)))
