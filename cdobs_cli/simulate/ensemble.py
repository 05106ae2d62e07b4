"""Many runs, a batch at a time: memory does not grow with their number, and no batch changes what a run is.

Of every run the figures are kept; of the error of all of them percentiles at common times; of some, and of the worst,
the trajectory. Batches are parts on disk while it goes on, so that a killed simulation may go on where it was.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from cdobs_cli import progress
from cdobs_cli.arrays import Array
from cdobs_cli.codec import read
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.records import dataclass
from cdobs_cli.run import Bands, Ensemble, Run, RunSummary, SimulationPlan, Trajectory
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.compiled import Compiled
from cdobs_cli.simulate.engine import Batch, simulate, simulate_batch
from cdobs_cli.simulate.record import SHOWN, grid_of_many
from cdobs_cli.simulate.stiffness import MAX_RUNS
from cdobs_cli.simulate.summary import overall
from cdobs_cli.store import write_atomically

Shown = dict[int, Trajectory]  # by number of the run
Made = tuple[list[RunSummary], int, int, Shown]  # figures, the most steps of a run, stiff runs, what may be shown
LEVELS = (5.0, 25.0, 50.0, 75.0, 95.0, 100.0)  # percent
DRAWN = 20  # of many runs, from the first on; the worst is drawn too
RUNS, RUNS_OF_ARRAYS = 500, 1000  # of a batch: arrays take as many calls for more
COMPILED_FROM = MAX_RUNS  # runs; of fewer, those that are stiff go on implicitly, which arrays know
_AT_ONCE = 4_000_000  # numbers of all runs that percentiles are taken of in one go
_CHECKED_RUNS, _AGREES = 4, 1e-6


@dataclass(frozen=True)
class Parts:
    """Where batches are kept until all are there.

    key: what they come from; workers: batches at a time; resumes: whether those of the same key that stand are used.
    """

    folder: Path
    key: Mapping[str, str]
    workers: int = 1
    resumes: bool = False


def ensemble(
    system: HybridSystem, plan: SimulationPlan, law: SamplingLaw, parts: Parts, *, runs_of_a_batch: int | None = None
) -> Run:
    """As `simulate`; of more than SHOWN runs the first are shown, and the worst. The same bits for any batch and any
    number of workers.

    Raises:
        SpecError: as `simulate`.
        ToolError: the folder cannot be written.
    """
    if plan.runs <= SHOWN:
        return simulate(system, plan, law)
    if not parts.resumes:
        shutil.rmtree(parts.folder, ignore_errors=True)
    compiled = _compiled(system, plan, law) if plan.runs > COMPILED_FROM else None
    made = _Ensemble(system, plan, law, parts, compiled)
    starts = _starts(plan.runs, runs_of_a_batch or (RUNS if compiled else RUNS_OF_ARRAYS))
    summaries: list[RunSummary] = []
    shown: Shown = {}
    steps = implicit = 0
    for done, (own, most, stiff, seen) in made.batches(starts):
        summaries += own
        steps, implicit = max(steps, most), implicit + stiff
        shown |= seen
        kept = {*range(DRAWN), *_may_be_worst({number: summaries[number] for number in shown})}
        shown = {number: one for number, one in shown.items() if number in kept}
        progress.doing(f"run {done} of {plan.runs}")
    run = made.run(starts, summaries, steps, implicit, shown)
    shutil.rmtree(parts.folder, ignore_errors=True)
    return run


def _starts(runs: int, batch: int) -> list[tuple[int, int]]:
    """(first, count) of each batch. None is of one run: sums over a single column might be taken in another order."""
    batch = max(2, batch)
    starts = [(first, min(batch, runs - first)) for first in range(0, runs, batch)]
    if starts[-1][1] == 1 and len(starts) > 1:
        (first, count), _ = starts[-2:]
        starts[-2:] = [(first, count + 1)]
    return starts


@dataclass(frozen=True)
class _Ensemble:
    system: HybridSystem
    plan: SimulationPlan
    law: SamplingLaw
    parts: Parts
    compiled: Compiled | None

    def batch(self, first: int, count: int) -> Batch:
        plan = replace(self.plan, runs=count)
        return simulate_batch(self.system, plan, self.law, first=first, together=self.plan.runs, compiled=self.compiled)

    def batches(self, starts: Sequence[tuple[int, int]]) -> Iterator[tuple[int, Made]]:
        """In order: how many runs are done, and what the batch came to."""
        with ThreadPoolExecutor(max(1, self.parts.workers)) as pool:
            waiting: deque[tuple[int, Future[Made]]] = deque()
            for first, count in starts:
                waiting.append((first + count, pool.submit(self._part, first, count)))
                if len(waiting) > self.parts.workers:
                    done, future = waiting.popleft()
                    yield done, future.result()
            for done, future in waiting:
                yield done, future.result()

    def _part(self, first: int, count: int) -> Made:
        """A batch as it stands, or a new one, written."""
        if self.parts.resumes and (stored := self._stored(first, count)) is not None:
            return stored
        batch = self.batch(first, count)
        errors = _on_grid(batch)
        document = {
            "from": {**self.parts.key, "first": first, "count": count},
            "summaries": [one.document() for one in batch.summaries], "steps": batch.steps,
            "implicit": batch.implicit,
        }  # fmt: skip
        if errors is not None:
            self.parts.folder.mkdir(parents=True, exist_ok=True)
            np.save(self._path(first, "npy"), errors)
        # The document last: a part counts as there when it is.
        write_atomically(self._path(first, "json"), _sealed(json.dumps(document)).encode())
        kept = {number for number in range(DRAWN) if first <= number < first + count}
        kept |= _may_be_worst(dict(enumerate(batch.summaries, first)))
        shown = {number: batch.trajectory(number - first) for number in sorted(kept)}
        return batch.summaries, batch.steps, batch.implicit, shown

    def _path(self, first: int, suffix: str) -> Path:
        return self.parts.folder / f"{first:06}.{suffix}"

    def _stored(self, first: int, count: int) -> Made | None:
        """None where there is none of this key, or it is damaged."""
        try:
            content = self._path(first, "json").read_text(encoding="ascii")
            document = json.loads(content)
            del document["sha256"]
            is_whole = content == _sealed(json.dumps(document))
            if not is_whole or document["from"] != {**self.parts.key, "first": first, "count": count}:
                return None
            errors = self._path(first, "npy")
            if errors.exists() and np.load(errors, mmap_mode="r").shape[0] != count:
                return None
            return (
                list(read(tuple[RunSummary, ...], document["summaries"])),
                int(document["steps"]),
                int(document["implicit"]),
                {},
            )
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def run(
        self, starts: Sequence[tuple[int, int]], summaries: list[RunSummary], steps: int, implicit: int, known: Shown
    ) -> Run:
        worst = worst_of(summaries)
        numbers = [*range(DRAWN), *((worst,) if worst >= DRAWN else ())]
        if not all(number in known for number in range(DRAWN)):
            first = self.batch(0, DRAWN)
            known = known | {number: first.trajectory(number) for number in range(DRAWN)}
        shown = [known[number] if number in known else self._alone(number) for number in numbers]
        return Run(
            tuple(shown), tuple(summaries), overall(summaries), steps=steps, implicit=implicit,
            ensemble=Ensemble.of(summaries, tuple(numbers), worst), bands=self._bands(starts),
        )  # fmt: skip

    def _alone(self, number: int) -> Trajectory:
        """One run, of a batch of two."""
        first = max(0, number - 1)
        return self.batch(first, 2).trajectory(number - first)

    def _bands(self, starts: Sequence[tuple[int, int]]) -> Bands | None:
        files = [self._path(first, "npy") for first, _ in starts]
        if not all(path.exists() for path in files):
            return None
        errors = [np.load(path, mmap_mode="r") for path in files]
        states, times = self.system.plant.states, grid_of_many(float(self.plan.horizon))
        values = np.empty((len(states), len(LEVELS), len(times)))
        width = max(1, _AT_ONCE // self.plan.runs)
        for state in range(len(states)):
            for start in range(0, len(times), width):
                chunk = np.concatenate([part[:, state, start : start + width] for part in errors])
                # Of runs that came to no end the error is infinite: `lower` never takes the mean of two.
                values[state, :, start : start + width] = np.percentile(chunk, LEVELS, axis=0, method="lower")
        return Bands(times, LEVELS, dict(zip(states, values, strict=True)))


def _sealed(text: str) -> str:
    """A JSON object with the sha256 of its text before all else."""
    return f'{{"sha256": "{hashlib.sha256(text.encode()).hexdigest()}", {text[1:]}'


def _on_grid(batch: Batch) -> Array | None:
    """|e| at the common times, shape (R, n, G): at a jump what is left after it, and infinity after a run's end."""
    if batch.error is None:
        return None
    paths, grid = batch.paths, batch.grid
    # Runs one after the other on one axis: each is longer than any time in it.
    length = 2.0 * grid[-1]
    runs = np.arange(len(paths.offsets) - 1)[:, None]
    last = np.searchsorted(paths.t + paths.run * length, grid + 1e-9 * grid[1] + runs * length, side="right") - 1
    errors = np.abs(batch.error[:, last])
    over = grid > paths.t[paths.last][:, None] + 1e-9 * grid[1]
    return np.where(over | np.isnan(errors), np.inf, errors).transpose(1, 0, 2)


def worst_of(summaries: Sequence[RunSummary]) -> int:
    """The run that came to no end first, else the one whose error is largest after the transient, each state by what is
    usual of it; of the whole run where nothing is left after it."""
    early = [number for number, one in enumerate(summaries) if one.stopped is not None]
    if early:
        return early[0]
    sizes = np.zeros(len(summaries))
    for name in summaries[0].rmse_after_transient:
        late = np.array([one.rmse_after_transient.get(name, np.inf) for one in summaries])
        sizes = np.maximum(sizes, late / (usual if (usual := float(np.median(late))) > 0 else 1.0))
    if not sizes.max(initial=0.0) > 0:
        sizes = np.array([max(one.rmse.values(), default=0.0) for one in summaries])
    return int(np.argmax(sizes))


def _may_be_worst(summaries: Mapping[int, RunSummary]) -> set[int]:
    """Of some runs, by number, those that `worst_of` may choose, whatever the others are: the first that ends early,
    and of each figure the first of the largest."""
    numbers, every = list(summaries), list(summaries.values())
    early = [number for number, one in summaries.items() if one.stopped is not None][:1]
    names = dict.fromkeys(name for one in every for name in one.rmse_after_transient)
    figures = [[one.rmse_after_transient.get(name, np.inf) for one in every] for name in names]
    figures.append([max(one.rmse.values(), default=0.0) for one in every])
    return {*early, *(numbers[int(np.argmax(row))] for row in figures if row)}


def _compiled(system: HybridSystem, plan: SimulationPlan, law: SamplingLaw) -> Compiled | None:
    """The loop in machine code, if it does as the array path does: looked at when it is used first. What arrives late
    is known to arrays alone."""
    if system.plant.delays:
        return None
    from cdobs_cli.simulate.loop import ClosedLoop
    from cdobs_cli.simulate.signals import Signals

    if system.observer.compares:  # messages are over arrays alone
        return None
    loop = ClosedLoop(system, Signals.of(system.plant, plan.signals, system.observer.control))
    compiled = Compiled.of(loop)
    if compiled is None or compiled.is_checked:
        return compiled
    if not _agree(system, _glance(plan, law), law, compiled):
        return None
    compiled.mark_checked()
    return compiled


def _glance(plan: SimulationPlan, law: SamplingLaw) -> SimulationPlan:
    """A few runs, for so long as rounding cannot grow much, and some samples are taken."""
    horizon = plan.horizon * Exact(Fraction(1, 20))
    some = law.T_max * Exact(3)
    if not law.is_updated and (some - horizon).sign() == 1:
        horizon = some if (plan.horizon - some).sign() == 1 else plan.horizon
    return replace(plan, runs=_CHECKED_RUNS, horizon=horizon)


def _agree(system: HybridSystem, plan: SimulationPlan, law: SamplingLaw, compiled: Compiled) -> bool:
    in_arrays, in_code = (simulate_batch(system, plan, law, compiled=one) for one in (None, compiled))
    if not np.array_equal(in_arrays.paths.offsets, in_code.paths.offsets):
        return False
    z, other = in_arrays.paths.z, in_code.paths.z
    size = 1.0 + np.abs(z).max(axis=1, initial=0.0, where=np.isfinite(z))[:, None]
    return bool(np.allclose(z / size, other / size, rtol=0.0, atol=_AGREES, equal_nan=True))
