"""Runs through the timed graph of sensors: which sample comes next, and when."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import lcm

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.graph import Edge
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import is_read
from cdobs_cli.simulate.signals import Draws

_SLACK = 1e-9  # of the shortest period, by which an edge may be missed in floats


def walker(law: SamplingLaw, draws: Draws, runs: int) -> Walker:
    """Of a law whose samples the timed graph tells."""
    if any(sensor.is_free for sensor in law.sensors):
        return _OutOfStep(law, draws, runs)
    return _LongPattern(law, draws, runs) if len(law.graph.nodes) == 1 else _Lossy(law, draws, runs)


class Walker:
    """Attributes:
    reading: of each run what its next sample reads, shape (R,).
    """

    def __init__(self, law: SamplingLaw, draws: Draws, runs: int) -> None:
        self.law, self.graph, self.draws, self.base = law, law.graph, draws, float(law.base)
        node, reading = self.graph.start
        self.node = np.full(runs, node)
        self.reading = np.full(runs, reading)
        self.drawn = np.zeros((len(law.sensors), runs), dtype=np.int64)

    def after(self, runs: Integers, index: int, t: Array) -> Array:
        """The instants that follow sample number `index`, which was at t (len(runs),)."""
        raise NotImplementedError

    def share(self, channel: int, runs: Integers) -> Array:
        """A further number in [0, 1) of each run."""
        shares = self.draws.at("periods", "uniform", channel, runs, self.drawn[channel, runs])
        self.drawn[channel, runs] += 1
        return shares


class _Lossy(Walker):
    """Sensors in step: of what may be lost each possibility as often as the others."""

    def __init__(self, law: SamplingLaw, draws: Draws, runs: int) -> None:
        super().__init__(law, draws, runs)
        self.edges = [list(self.graph.leaving(q)) for q in range(len(self.graph.nodes))]
        self.parts = lcm(*(node.length.denominator for node in self.graph.nodes))
        self.lengths = np.array([int(node.length * self.parts) for node in self.graph.nodes])
        self.counts = np.array(list(map(len, self.edges)))
        self.targets = _table(self.edges, [[edge.target for edge in own] for own in self.edges])
        self.read = _table(
            self.edges, [[-1 if edge.reading is None else edge.reading for edge in own] for own in self.edges]
        )
        self.ticks = np.zeros(runs, dtype=np.int64)

    def after(self, runs: Integers, index: int, t: Array) -> Array:
        left = runs
        while left.size:
            node = self.node[left]
            which = np.minimum((self.share(0, left) * self.counts[node]).astype(np.int64), self.counts[node] - 1)
            self.ticks[left] += self.lengths[node]
            self.node[left], self.reading[left] = self.targets[node, which], self.read[node, which]
            left = left[self.reading[left] < 0]
        after: Array = np.asarray(self.ticks[runs] * (self.base / self.parts), dtype=float)
        return after


class _LongPattern(Walker):
    """Sensors in step after long: whichever are read at a sample of the fastest."""

    def __init__(self, law: SamplingLaw, draws: Draws, runs: int) -> None:
        super().__init__(law, draws, runs)
        self.numbers = {reading.sensors: number for number, reading in enumerate(self.graph.readings)}

    def after(self, runs: Integers, index: int, t: Array) -> Array:
        read = tuple(sensor for sensor in self.law.sensors if is_read(sensor, Fraction(index + 1)))
        self.reading[runs] = self.numbers[read]
        return np.full(len(runs), (index + 1) * self.base)


class _OutOfStep(Walker):
    """Sensors that keep no step: the time to the next sample of each is drawn between its ends; of one that keeps
    a step of its own how many of its samples are lost."""

    def __init__(self, law: SamplingLaw, draws: Draws, runs: int) -> None:
        super().__init__(law, draws, runs)
        edges, count = self.graph.edges, len(law.sensors)
        names = [sensor.name for sensor in law.sensors]
        self.least = np.array([float(one.every if one.least is None else one.least) for one in law.sensors])
        self.most = np.array([float(one.every) for one in law.sensors])
        self.in_step = [one.step is not None for one in law.sensors]
        self.lost = [one.lost for one in law.sensors]
        self.last, self.next = np.zeros((count, runs)), np.zeros((count, runs))  # in shortest periods
        self.sources = np.array([edge.source for edge in edges])
        self.targets = np.array([edge.target for edge in edges])
        self.numbers = np.array([-1 if edge.reading is None else edge.reading for edge in edges])
        self.sensors = np.array([names.index(self.graph.readings[number].name) for number in self.numbers])
        self.guards = np.array([[float(edge.low), float(edge.high)] for edge in edges])
        bins = [[list(map(float, ends)) for ends in self.graph.nodes[edge.target].ages] for edge in edges]
        self.bins = np.array(bins)  # (edges, sensors, 2)
        self.now = np.zeros(runs)

    def after(self, runs: Integers, index: int, t: Array) -> Array:
        for s in range(len(self.most)):
            due = runs if index == 0 else runs[self.next[s, runs] <= self.last[s, runs]]
            if not due.size:
                continue
            share = self.share(s, due)
            if self.in_step[s]:
                gap = self.least[s] * (1 + np.minimum(np.floor(share * (self.lost[s] + 1)), self.lost[s]))
            else:
                gap = self.least[s] + (self.most[s] - self.least[s]) * share
            self.next[s, due] = self.last[s, due] + gap
        sensor = np.argmin(self.next[:, runs], axis=0)
        when = self.next[sensor, runs]
        clock = when - self.now[runs]
        self.last[sensor, runs] = self.now[runs] = when
        ages = when - self.last[:, runs]  # (sensors, R)
        beyond = np.maximum(self.guards[:, :1] - clock, clock - self.guards[:, 1:])  # (edges, R)
        beyond = np.maximum(beyond, (self.bins[:, :, :1] - ages[None]).max(axis=1))
        beyond = np.maximum(beyond, (ages[None] - self.bins[:, :, 1:]).max(axis=1))
        other = (self.sources[:, None] != self.node[runs]) | (self.sensors[:, None] != sensor)
        edge = np.argmin(np.where(other, np.inf, np.maximum(beyond, _SLACK)), axis=0)
        self.node[runs], self.reading[runs] = self.targets[edge], self.numbers[edge]
        after: Array = when * self.base
        return after


def _table(edges: Sequence[Sequence[Edge]], rows: Sequence[Sequence[int]]) -> Integers:
    """Rows of numbers filled up to the longest."""
    table = np.zeros((len(edges), max(map(len, edges))), dtype=np.int64)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    return table
