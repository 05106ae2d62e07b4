"""Measurements that arrive late: the observer keeps what it knew at each stamp, and computes again from there on.

Kept of sample k until it and all before it are there: t_k, the observer's state just before its jump, and y_k. When
something arrives, the jumps from its stamp on are made anew with all that is there by then, and the observer flows
from each of them to the next under the inputs as they were applied. After the last arrival the estimate is that of an
observer that had every sample at once.
"""

from __future__ import annotations

from collections import deque
from functools import cached_property
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.delays import Delay
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.records import dataclass
from cdobs_cli.run import SimulationPlan
from cdobs_cli.simulate.flow import Flow
from cdobs_cli.simulate.integrator import End, Progress
from cdobs_cli.simulate.loop import ClosedLoop, stacked
from cdobs_cli.simulate.record import Grid
from cdobs_cli.simulate.signals import Draws

MAX_UNDER_WAY = 200  # samples: each arrival makes the jumps of those after it anew


class ObserverAlone(ClosedLoop):
    """The observer's flow without the plant's: to an integrator as the whole loop. What is held stays in its place."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.system, self.signals = loop.system, loop.signals
        self.plant, self.observer = loop.plant, loop.observer
        self.states, self.held = loop.observer.states, loop.held
        self.names = ("t", *self.states, *self.held)
        self.size = len(self.states)
        self.flow, self.is_triggered = tuple(map(loop.closed, loop.observer.flow)), False


@dataclass
class Sample:
    """One sample of all runs: t (R,); which (R,), what is read; both states and what is held just before its jump, y
    (size, R), held (c, R); what is measured and when it arrives (p, R), infinite where it is not read; which of it is
    there (p, R)."""

    t: Array
    which: Integers
    y: Array
    held: Array
    measured: Array
    arrival: Array
    there: Booleans


class Recompute:
    """The late samples of all runs, on the way and arrived.

    next (R,): when something arrives next, infinite where nothing is under way.
    """

    def __init__(
        self, loop: ClosedLoop, plan: SimulationPlan, delays: tuple[Delay, ...], draws: Draws, max_steps: int,
        together: int,
    ) -> None:  # fmt: skip
        """together: the runs that share limits of work."""
        self.loop, self.plan, self.delays, self.draws, self.runs = loop, plan, delays, draws, plan.runs
        self.horizon, self.max_steps, self.together = float(plan.horizon), max_steps, together
        self.next = np.full(self.runs, np.inf)
        self._kept: deque[tuple[int, Sample]] = deque()
        estimates = dict(zip(loop.plant.states, loop.observer.estimates["x_hat"], strict=True))
        own = [loop.closed(row.substitute(estimates)) for row in loop.plant.outputs()]
        self._expected = compile_floats(own, loop.names, arrays=True)
        self._nowhere = Grid(np.empty(0), 0, 0, self.runs)
        names = loop.observer.states
        self._progress = Progress.start(
            np.zeros(self.runs), np.zeros((len(names), self.runs)), np.zeros((len(loop.held), self.runs))
        )

    @cached_property
    def _flow(self) -> Flow:
        return Flow(ObserverAlone(self.loop), self.horizon, self.max_steps, self.runs, self.together)

    def take(
        self, runs: Integers, index: int, which: Integers, t: Array, y: Array, held: Array, measured: Array
    ) -> tuple[Array, Array]:
        """Keep sample number `index` of the given runs, at t; returns all states after what is there of it at once, and
        when each of its outputs arrives (p, len(runs)), not a number where one is not read.

        Raises: SpecError where more are under way than can be followed.
        """
        if len(self._kept) >= MAX_UNDER_WAY:
            at = next(one.field for one in self.delays if one.is_late)
            what, hint = "too many samples are under way at a time", "shorten the delay or lengthen the period"
            raise SpecError.at(at, what, str(len(self._kept) + 1), f"at most {MAX_UNDER_WAY}", hint)
        arrival = self._arrivals(runs, index, t, measured)
        sample = self._empty()
        sample.which[runs] = which
        sample.t[runs], sample.y[:, runs], sample.held[:, runs] = t, y, held
        sample.measured[:, runs], sample.arrival[:, runs] = measured, arrival
        self._kept.append((index, sample))
        sample.there[:, runs] = arrival <= t
        self._await(runs)
        return self._jumped(sample, runs, y), np.where(np.isfinite(arrival), arrival, np.nan)

    def _empty(self) -> Sample:
        """A sample that no run took."""
        R, p = self.runs, self.loop.plant.p
        nothing = np.full((p, R), np.inf)
        y, held = np.zeros((self.loop.size, R)), np.zeros((len(self.loop.held), R))
        return Sample(
            np.full(R, np.inf),
            np.zeros(R, dtype=np.int64),
            y,
            held,
            np.full((p, R), np.nan),
            nothing,
            np.zeros((p, R), dtype=bool),
        )

    def _arrivals(self, runs: Integers, index: int, t: Array, measured: Array) -> Array:
        """t_k + d, of each sensor uniform in its interval, or as late as may be."""
        arrival = np.full(measured.shape, np.inf)
        for channel, one in enumerate(self.delays):
            low, high = float(one.lower), float(one.upper)
            share = np.ones(len(runs))
            if not self.plan.latest and low < high:
                share = self.draws.at("delays", "uniform", channel, runs, index)
            arrival[list(one.outputs)] = t + low + (high - low) * share
        return np.where(np.isnan(measured), np.inf, arrival)

    def _await(self, runs: Integers) -> None:
        """Set `next` of the given runs, and let go of what is there of all of them."""
        coming = np.full(len(runs), np.inf)
        for _, sample in self._kept:
            missing = np.where(sample.there[:, runs], np.inf, sample.arrival[:, runs])
            coming = np.minimum(coming, missing.min(axis=0, initial=np.inf))
        self.next[runs] = coming
        while len(self._kept) > 1 and not np.any(~self._kept[0][1].there & np.isfinite(self._kept[0][1].arrival)):
            self._kept.popleft()

    def _jumped(self, sample: Sample, runs: Integers, y: Array) -> Array:
        """All states after what is there of a sample; y: before it. What is not there is taken as it is expected, so
        that it corrects nothing."""
        there = sample.there[:, runs]
        some = np.flatnonzero(there.any(axis=0))
        after = y.copy()
        if some.size:
            at, t, held = runs[some], sample.t[runs[some]], sample.held[:, runs[some]]
            expected = stacked(self._expected(t, *y[:, some], *held), len(some))
            known = np.where(there[:, some], sample.measured[:, at], expected)
            after[:, some] = self.loop.jump(sample.which[at], t, y[:, some], held, known)
        return after

    def arrive(self, runs: Integers, t: Array) -> tuple[Array, Integers]:
        """What arrives by t (len(runs),): the observer's states now (states, len(runs)), and an End code each."""
        first = np.full(len(runs), len(self._kept))
        for place, (_, sample) in enumerate(self._kept):
            new = (sample.arrival[:, runs] <= t) & ~sample.there[:, runs]
            first = np.where(new.any(axis=0), np.minimum(first, place), first)
            sample.there[:, runs] |= new
        codes, n = np.full(len(runs), End.REACHED), self.loop.plant.n
        now = np.zeros((self.loop.size - n, len(runs)))
        kept = list(self._kept)
        for place, (_, sample) in enumerate(kept):
            at = np.flatnonzero((first <= place) & (codes == End.REACHED) & np.isfinite(sample.t[runs]))
            if not at.size:
                continue
            ids, later = runs[at], first[at] < place
            sample.y[n:, ids[later]] = now[:, at[later]]
            after = self._jumped(sample, ids, sample.y[:, ids])
            follows = kept[place + 1][1].t[ids] if place + 1 < len(kept) else np.full(len(ids), np.inf)
            now[:, at], codes[at] = self._flown(ids, sample, after[n:], np.minimum(follows, t[at]))
        self._await(runs)
        return now, codes

    def _flown(self, runs: Integers, sample: Sample, start: Array, ends: Array) -> tuple[Array, Integers]:
        progress = self._progress
        progress.t[runs], progress.y[:, runs], progress.held[:, runs] = sample.t[runs], start, sample.held[:, runs]
        codes = self._flow.advance(runs, progress, ends, self._nowhere, self._unseen)
        return progress.y[:, runs], codes

    def _unseen(self, runs: Any, t: Any, y: Any, held: Any) -> Booleans:
        """A watch that stops nothing."""
        return np.zeros(self.runs, dtype=bool)

    @property
    def index(self) -> int:
        """The number of the last sample."""
        return self._kept[-1][0]
