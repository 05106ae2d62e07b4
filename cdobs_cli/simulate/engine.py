"""Flow, jump, next sample. Every flow starts at a sampling instant and ends at the next one.

xdot = f(t, x),  t_k <= t < t_(k+1);    y_k = C x(t_k) + v_k;    x+ = g(x-, y_k)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.records import dataclass
from cdobs_cli.run import Run, RunSummary, SimulationPlan, Trajectory
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.disturbance import Disturbance, longest_sub_step
from cdobs_cli.simulate.ending import GROWN, SENTENCES, Ending
from cdobs_cli.simulate.flow import Flow
from cdobs_cli.simulate.integrator import End, Progress
from cdobs_cli.simulate.late import Recompute
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.record import Grid, Log, Paths, Record, Samples, Sides, grid_times, paths, sides_of_one
from cdobs_cli.simulate.sampling import Timetable
from cdobs_cli.simulate.signals import Draws, Noise, Signals
from cdobs_cli.simulate.summary import overall, summarise, trajectory
from cdobs_cli.simulate.watch import Watch

if TYPE_CHECKING:
    from cdobs_cli.simulate.compiled import Compiled

# No input may hang: a run ends with a finding after so many samples or steps, fewer where there are many runs.
MAX_RUNS, MAX_STATES_TOGETHER = 20_000, 400_000
MAX_SAMPLES, MAX_SAMPLES_TOGETHER = 50_000, 5_000_000
MAX_STEPS, MAX_STEPS_TOGETHER = 200_000, 4_000_000
MOST_AT_ONCE = 1000  # corrections at one instant


def simulate(
    system: HybridSystem, plan: SimulationPlan, law: SamplingLaw, *, first: int = 0, max_steps: int = MAX_STEPS
) -> Run:
    """Run plant and observer together over [0, horizon], every run shown.

    Sampling starts at t_0 = 0. The seed fixes initial states drawn from the box, aperiodic periods (uniform over their
    law), disturbance and noise; what a run sees does not depend on the other runs. Without typed signals, noise is
    uniform in its box or normal with its covariance, a bounded disturbance uniform in its box and held from sample to
    sample, a white one as in `disturbance`. An input without a signal is 0; an initial estimate that is not given is
    the middle of the known box, or 0.

    Args:
        first: the number of the first run: runs of the same number see the same.
        max_steps: of the integration, of one run.

    Raises:
        SpecError: a signal outside its declared interval, a period outside the law, a start that needs a box
            that is not given, more samples or runs than can be had.
    """
    batch = simulate_batch(system, plan, law, first=first, max_steps=max_steps)
    runs = tuple(batch.trajectory(run) for run in range(plan.runs))
    together = overall(batch.summaries)
    return Run(runs, tuple(batch.summaries), together, steps=batch.steps, implicit=batch.implicit)


def simulate_batch(
    system: HybridSystem, plan: SimulationPlan, law: SamplingLaw, *, first: int = 0, together: int | None = None,
    max_steps: int = MAX_STEPS, compiled: Compiled | None = None,
) -> Batch:  # fmt: skip
    """As `simulate`: `plan.runs` runs of the `together` that are kept in one memory budget, from number `first` on.

    Args:
        compiled: the loop in machine code; without it, over arrays.

    Raises:
        SpecError: as `simulate`.
    """
    with np.errstate(all="ignore"):
        try:
            simulation = _Simulation(system, plan, law, first, max_steps, together or plan.runs)
            simulation.begin()
        except OverflowError as error:
            what = "a number that is too large to be simulated"
            raise SpecError.at(("simulation",), what, str(error), "numbers below 1e308") from error
        kept = None if compiled is None else simulation.run_compiled(compiled)
        return simulation.batch(*(kept or simulation.run()))


@dataclass(frozen=True)
class Batch:
    """Runs that were made together: their figures, and what there is to be shown of them; steps: of the one that took
    most; implicit: how many were stiff."""

    loop: ClosedLoop
    watch: Watch
    paths: Paths
    samples: Samples
    summaries: list[RunSummary]
    error: Array | None
    grid: Array
    steps: int
    implicit: int

    def trajectory(self, run: int) -> Trajectory:
        return trajectory(self.loop, self.watch, self.paths, self.samples, run)


class _Simulation:
    """One call of `simulate`; all runs, each at its own time."""

    def __init__(
        self, system: HybridSystem, plan: SimulationPlan, law: SamplingLaw, first: int, max_steps: int, together: int
    ) -> None:
        """together: the runs that share limits of memory and work."""
        self.plan, self.runs, self.horizon = plan, plan.runs, float(plan.horizon)
        _refuse_impossible(system, plan)
        box = plan.initial_box
        self.box = None if box is None else (_columns(box.lower, self.runs), _columns(box.upper, self.runs))
        signals = Signals.of(system.plant, plan.signals, system.observer.control)
        self.loop = ClosedLoop(system, signals)
        self.draws = Draws(plan.seed, self.runs, first)
        self.noise = Noise(signals, self.draws)
        self.max_samples = min(MAX_SAMPLES, max(100, MAX_SAMPLES_TOGETHER // together))
        chooses = self.loop.is_triggered
        self.unread = self._unread(law, system.plant.p)
        self.timetable = None if chooses else Timetable(law, plan, self.draws, self.max_samples)
        self.max_steps = min(max_steps, MAX_STEPS, max(1000, MAX_STEPS_TOGETHER // together))
        self.integrator = Flow(self.loop, self.horizon, self.max_steps, self.runs, together)
        self.watch = Watch(self.loop, self.runs)
        width = self.loop.size + len(self.loop.held)
        self.grid = grid_times(self.horizon, width, together)
        sides = Sides(sides_of_one(width, together))
        self.record = Record(Grid(self.grid, self.loop.size, len(self.loop.held), self.runs), sides)
        self.next = np.full(self.runs, self.horizon)
        longest = longest_sub_step(None if chooses else float(law.T_max), self.horizon, self.max_steps)
        self.disturbance = Disturbance(signals, self.draws, self.runs, longest)
        late = (self.loop, plan, system.plant.delays, self.draws, self.max_steps, together)
        self.late = Recompute(*late) if system.plant.delays else None
        self.drawn = np.zeros(self.runs, dtype=np.int64)  # noises so far of sensors that compare

    def run(self) -> tuple[Log, Samples]:
        """Every run to its end, over arrays; returns what was recorded."""
        progress, watch = self.progress, self.watch
        going, index = np.flatnonzero(~watch.halted), 0
        while going.size:
            codes = self._flow(going)
            due = going[(~watch.halted[going]) & ((codes == End.TRIGGERED) | (progress.t[going] >= self.next[going]))]
            index += 1
            if due.size and index >= self.max_samples:
                self._end(due, Ending.SAMPLES)
            elif due.size:
                self._sample(due, index)
            going = going[~watch.halted[going] & (progress.t[going] < self.horizon)]
        # A jump at the horizon is followed by no flow that would look at it.
        left = np.flatnonzero(~watch.halted)
        watch(left, *progress.at(left))
        self.integrator.explicit.postponed.settle(self.record.grid)
        return self.record.log(), self.record.samples(self.runs)

    def run_compiled(self, compiled: Compiled) -> tuple[Log, Samples] | None:
        """As `run`, in machine code; None where a signal leaves its declared interval."""
        _, _, _, before, _ = self.record.sides.entries[0]
        _, _, measured = self.record.measured[0]
        progress, watch = self.progress, self.watch
        numbers = {
            "horizon": self.horizon, "runs": self.runs, "max_steps": self.max_steps, "max_samples": self.max_samples,
            "grid": self.grid, "y0": progress.y, "held0": progress.held, "before0": before, "measured0": measured,
            "limit": watch.limit, "unread": self.unread,
            **self._instants(),
            "code": np.where(watch.halted, Ending.START, Ending.HORIZON),
        }  # fmt: skip
        ended = watch.halted.copy()
        made = compiled.run(numbers, self.disturbance, self.draws)
        if made is None:
            return None
        outcome, log, samples = made
        progress.t, progress.y, progress.held = outcome.stop_t, outcome.stop_y.T.copy(), outcome.stop_held.T.copy()
        progress.steps, watch.margin = outcome.steps, outcome.margin
        watch.departures.take(outcome.first, outcome.which, outcome.value, outcome.beyond)
        for run in map(int, np.flatnonzero((outcome.code != Ending.HORIZON) & ~ended)):
            reason, here = int(outcome.code[run]) - Ending.WATCH, (float(progress.t[run]), progress.y[:, run])
            if reason < 0:
                self._end(np.array([run]), Ending(int(outcome.code[run])))
            else:
                held, sentence = progress.held[:, run], watch.reasons[reason]
                watch.halt(run, *here, held, sentence, diverged=reason == 0)
        return log, samples

    @staticmethod
    def _unread(law: SamplingLaw, p: int) -> Integers:
        """1 where a reading leaves an output out, shape (readings, p); empty where all read all."""
        unread = law.unread(p)
        table = np.zeros((len(unread), p), dtype=np.int64)
        for number, outputs in enumerate(unread):
            table[number, outputs] = 1
        return table

    def _instants(self) -> dict[str, Array | Integers | None]:
        """All sampling instants after the first, shape (R, K), infinite after the horizon; None where the observer
        chooses them; and what is read then."""
        if self.timetable is None:
            return {"instants": None, "readings": np.zeros((self.runs, 1), dtype=np.int64)}
        everyone = np.arange(self.runs)
        columns, index = [self.next.copy()], 0
        readings = [self.timetable.reading(everyone, 1)]
        while (going := np.flatnonzero(columns[-1] < self.horizon)).size and index < self.max_samples:
            index += 1
            after = np.full(self.runs, np.inf)
            after[going] = self.timetable.after(going, index, columns[-1][going])
            columns.append(after)
            readings.append(self.timetable.reading(everyone, index + 1))
        columns.append(np.full(self.runs, np.inf))
        return {"instants": np.stack(columns, axis=1), "readings": np.stack([*readings, readings[-1]], axis=1)}

    def batch(self, log: Log, samples: Samples) -> Batch:
        """What came out, from what was recorded."""
        progress, watch, size = self.progress, self.watch, self.loop.size
        final_t = np.where(watch.halted, watch.stop_t, progress.t)
        final_y = np.where(watch.halted, watch.stop_y, progress.y)
        final_z = np.concatenate([final_y, np.where(watch.halted, watch.stop_held, progress.held)])
        kept = paths(log, samples, self.record.sides.most, float(self.grid[1]), size, final_t, final_z)
        summaries, error = summarise(self.loop, watch, kept, samples)
        implicit = int(self.integrator.stiff.sum())
        return Batch(self.loop, watch, kept, samples, summaries, error, self.grid, int(progress.steps.max()), implicit)

    def _flow(self, runs: Integers) -> Integers:
        """Flow the given runs to their next sample, or the horizon, by what arrives on the way.

        Returns the End code of each.
        """
        last = np.minimum(self.next[runs], self.horizon)
        if self.late is None:
            return self._flow_until(runs, last)
        codes, live = np.full(len(runs), End.REACHED), np.arange(len(runs))
        while live.size:
            ids = runs[live]
            codes[live] = self._flow_until(ids, np.minimum(last[live], self.late.next[ids]))
            going = (codes[live] == End.REACHED) & ~self.watch.halted[ids]
            live = live[going & (self.progress.t[ids] >= self.late.next[ids])]
            if live.size:
                self._arrive(runs[live])
        return codes

    def _arrive(self, runs: Integers) -> None:
        """What arrives now changes the estimate."""
        assert self.late is not None
        t, y, held = self.progress.at(runs)
        estimate, codes = self.late.arrive(runs, t)
        after = np.concatenate([y[: self.loop.plant.n], estimate])
        self.record.sides.add(self.late.index, runs, t, np.concatenate([y, held]), np.concatenate([after, held]))
        self.progress.y[:, runs] = after
        self._halt_stuck(runs, codes)

    def _flow_until(self, runs: Integers, last: Array) -> Integers:
        """Flow the given runs to the times `last`; a white disturbance is drawn anew on the way.

        Returns the End code of each.
        """
        codes, live = np.full(len(runs), End.REACHED), np.arange(len(runs))
        progress = self.progress
        while live.size:
            ids = runs[live]
            ends = np.minimum(last[live], self.disturbance.until[ids])
            codes[live] = self.integrator.advance(ids, progress, ends, self.record.grid, self.watch)
            self._halt_stuck(ids, codes[live])
            going = (codes[live] == End.REACHED) & ~self.watch.halted[ids] & (progress.t[ids] < last[live])
            live = live[going]
            if live.size:
                ids = runs[live]
                self.disturbance.at_sub_step(ids, progress.t[ids])
                progress.held[self.loop.disturbance_rows, ids] = self.disturbance.values[:, ids]
        return codes

    def begin(self) -> None:
        """Place all runs at t_0, measure there, and jump where the observer does."""
        runs, zeros = np.arange(self.runs), np.zeros(self.runs)
        x = self._initial_states()
        no_observer = np.zeros((self.loop.size - len(x), self.runs))
        held = np.zeros((len(self.loop.held), self.runs))
        measured = self._measured(runs, 0, zeros, np.concatenate([x, no_observer]), held)
        y = self.loop.start(measured, self.box, self._initial_estimate(), x)
        held_before = self.loop.hold(zeros, y, held, measured, self.disturbance.before(runs))
        self.progress = Progress.start(zeros.copy(), y, held_before)
        self.watch.begin(zeros, y, self.progress.held)
        self._end(runs[~np.isfinite(y).all(axis=0)], Ending.START)
        if self.loop.observer.compares:
            self.record.measured.append((runs[:0], zeros[:0], measured[:, :0]))
            self._compare(runs, 0, sends=False)
            return
        self._jump(runs, 0, measured, jumps=self.loop.observer.jump_at_start)

    def _sample(self, runs: Integers, index: int) -> None:
        """Measure sample number `index` of the given runs, and jump."""
        if self.loop.observer.compares:
            self._compare(runs, index, sends=self.loop.compares_always)
            return
        t, y, held = self.progress.at(runs)
        self._jump(runs, index, self._measured(runs, index, t, y, held), jumps=True)

    def _compare(self, runs: Integers, index: int, *, sends: bool) -> None:
        """Sensors send, then what is held, and the next comparison. sends: whether one is known to be at its threshold.

        Noise is drawn for each comparison at an instant; where outputs are compared all the time, after each instant at
        which there were messages.
        """
        progress, loop = self.progress, self.loop
        t, y, held = progress.at(runs)
        before = np.concatenate([y, held])
        if not loop.compares_always or index == 0:
            self._draw(runs, t, held)
        rounds, known = 0, len(self.record.measured)
        far = self._send(runs, np.arange(len(runs)), t, y, held, sends=sends)
        changed = len(self.record.measured) > known
        while far.size and loop.compares_always:
            if rounds >= MOST_AT_ONCE:
                self._end(runs[far], Ending.CROWDED)
                break
            drawn, rounds = held[:, far], rounds + 1
            self._draw(runs[far], t[far], drawn)
            held[:, far] = drawn
            far = self._send(runs, far, t, y, held, sends=False)
        self.next[runs] = np.inf if self.timetable is None else self.timetable.after(runs, index, t)
        self.disturbance.at_sample(runs, index, t, self.next[runs])
        held[loop.disturbance_rows] = self.disturbance.values[:, runs]
        if changed or index == 0:
            self.record.sides.add(index, runs, t, before, np.concatenate([y, held]))
        progress.y[:, runs], progress.held[:, runs] = y, held

    def _send(self, runs: Integers, far: Integers, t: Array, y: Array, held: Array, *, sends: bool) -> Integers:
        """The messages of one instant: the sensor farthest beyond its threshold corrects the estimate, until none is at
        its threshold. Each sends once: what was sent at this instant is known, and used again where another correction
        asks for it. y and held are brought up to date; returns those of `far` that sent."""
        loop, p, first, steps = self.loop, self.loop.plant.p, far, 0
        sent = np.zeros((p, len(runs)), dtype=bool)
        while far.size:
            values = loop.compared(t[far], y[:, far], held[:, far])
            which = values.argmax(axis=0)
            if steps or not sends:
                at_threshold = np.flatnonzero(values.max(axis=0) >= 0)
                far, which = far[at_threshold], which[at_threshold]
            if steps >= MOST_AT_ONCE:
                self._end(runs[far], Ending.CROWDED)
                break
            for sensor in range(p):
                own = far[which == sensor]
                here = t[own], y[:, own], held[:, own]
                measured = loop.measure(*here, here[2][loop.noise_rows])
                measured[[k for k in range(p) if k != sensor]] = np.nan
                y[:, own] = loop.jump(np.full(len(own), sensor), *here, measured)
                held[:, own] = loop.hold(t[own], y[:, own], here[2], measured, here[2][loop.disturbance_rows])
                new = ~sent[sensor, own]
                self.record.measured.append((runs[own[new]], t[own[new]], measured[:, new]))
                sent[sensor, own] = True
            steps += 1
        counts: Integers = sent.sum(axis=0)
        return first[(counts[first] > 0) & ~self.watch.halted[runs[first]]]

    def _draw(self, runs: Integers, t: Array, held: Array) -> None:
        """New noise for the given runs, into what they hold."""
        if self.loop.held_noise:
            held[self.loop.noise_rows] = self.noise.at(runs, self.drawn[runs], t)
            self.drawn[runs] += 1

    def _measured(self, runs: Integers, index: int, t: Array, y: Array, held: Array) -> Array:
        """What sample number `index` reads; outputs that it does not read are not a number."""
        measured = self.loop.measure(t, y, held, self.noise.at(runs, index, t))
        if self.unread.size:
            measured[self.unread[self._which(runs, index)].T == 1] = np.nan
        return measured

    def _which(self, runs: Integers, index: int) -> Integers:
        """What sample number `index` of each run reads; 0 where all are alike."""
        return np.zeros(len(runs), dtype=np.int64) if self.timetable is None else self.timetable.reading(runs, index)

    def _jump(self, runs: Integers, index: int, measured: Array, *, jumps: bool) -> None:
        """x+ = g(x-, y_k), then what is held, then the next sampling instant."""
        t, y, held = self.progress.at(runs)
        elapsed = t - held[-1]
        after = self._corrected(runs, index, t, y, held, measured) if jumps else y
        unknown = np.full(len(runs), np.inf)
        self.next[runs] = unknown if self.timetable is None else self.timetable.after(runs, index, t)
        self.disturbance.at_sample(runs, index, t, self.next[runs])
        held_after = self.loop.hold(t, after, held, measured, self.disturbance.values[:, runs])
        self.record.measured.append((runs, t, measured))
        self.record.sides.add(index, runs, t, np.concatenate([y, held]), np.concatenate([after, held_after]))
        self.progress.y[:, runs], self.progress.held[:, runs] = after, held_after
        if self.timetable is not None:
            return
        going = ~self.watch.halted[runs]
        # 1e-12 of the horizon is below what an instant can be told apart by: instants that close accumulate.
        crowded = going & (elapsed < 1e-12 * self.horizon) & (index > 0)
        self._end(runs[crowded], Ending.CROWDED)
        unready = going & ~crowded & ~(self.loop.trigger(t, after, held_after) < 0)
        self._end(runs[unready], Ending.UNREADY)

    def _corrected(self, runs: Integers, index: int, t: Array, y: Array, held: Array, measured: Array) -> Array:
        """All states after sample number `index`, as far as it is there at once."""
        if self.late is None:
            return self.loop.jump(self._which(runs, index), t, y, held, measured)
        after, arrival = self.late.take(runs, index, self._which(runs, index), t, y, held, measured)
        self.record.arrivals.append(arrival)
        return after

    def _halt_stuck(self, runs: Integers, codes: Integers) -> None:
        """Turn an integrator that cannot go on into a sentence."""
        if codes.max() < End.SINGULAR:
            return
        self._end(runs[codes == End.EXHAUSTED], Ending.STEPS)
        self._end(runs[codes == End.SINGULAR], Ending.NO_STEP)

    def _end(self, runs: Integers, ending: Ending) -> None:
        """End runs where they stand."""
        t, y, held = self.progress.t, self.progress.y, self.progress.held
        for run in map(int, runs):
            grown = ending is Ending.NO_STEP and self._has_grown(run)
            sentence = GROWN if grown else SENTENCES.get(ending) or self.integrator.exhausted(run, self.progress)
            sentence = sentence.format(max_samples=self.max_samples)
            self.watch.halt(run, float(t[run]), y[:, run], held[:, run], sentence, diverged=grown)

    def _has_grown(self, run: int) -> bool:
        largest = float(np.max(np.abs(self.progress.y[:, run])))
        first = self.record.sides.entries[0][4][: self.loop.size, run]
        return not largest <= 1e6 * (1.0 + float(np.max(np.abs(first))))

    def _initial_states(self) -> Array:
        """x(0), shape (n, R): typed, or drawn uniformly from the box."""
        if self.plan.initial_state is not None:
            return _columns(self.plan.initial_state, self.runs)
        assert self.box is not None
        (lower, upper), runs = self.box, np.arange(self.runs)
        shares = np.array([self.draws.at("initial", "uniform", i, runs, 0) for i in range(len(lower))])
        x: Array = lower + (upper - lower) * shares
        return x

    def _initial_estimate(self) -> Array:
        if self.plan.initial_estimate is not None:
            return _columns(self.plan.initial_estimate, self.runs)
        return np.zeros((self.loop.plant.n, self.runs)) if self.box is None else (self.box[0] + self.box[1]) / 2


def _columns(values: tuple[Exact, ...], runs: int) -> Array:
    """The same vector for every run, shape (n, R)."""
    return np.repeat(np.array([[float(value)] for value in values]), runs, axis=1)


def _refuse_impossible(system: HybridSystem, plan: SimulationPlan) -> None:
    """Raises: SpecError for what no simulation can be started from."""
    at, needed = "simulation", {name for row in system.observer.start for name in row.variables}
    most = max(1, min(MAX_RUNS, MAX_STATES_TOGETHER // len(system.states)))
    problems = []
    if not float(plan.horizon) > 0:
        problems.append(Problem((at, "horizon"), "a horizon above 0 is expected", str(plan.horizon)))
    if not 1 <= plan.runs <= most:
        what = "a number of runs that cannot be simulated"
        problems.append(Problem((at, "runs"), what, str(plan.runs), f"1 to {most}"))
    if plan.initial_state is None and plan.initial_box is None:
        problems.append(Problem((at,), "an initial state is missing", allowed="initial_state, or initial_box"))
    if plan.initial_box is None and any(name.startswith(("lower.", "upper.")) for name in needed):
        what = "this observer starts from a known box of x(0)"
        problems.append(Problem((at, "initial_box"), what, "none", "initial_box"))
    chosen = "this observer chooses its sampling instants" if system.observer.trigger is not None else None
    chosen = "sensors send when their outputs have changed" if system.observer.compares else chosen
    if plan.sampling_times is not None and chosen is not None:
        what = chosen
        problems.append(Problem((at, "sampling_times"), what, str(plan.sampling_times)))
    if problems:
        raise SpecError(tuple(problems))
