"""When the next sample comes, where the observer does not choose: period, random periods, or an expression."""

from __future__ import annotations

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.loop import stacked
from cdobs_cli.simulate.signals import Draws
from cdobs_cli.simulate.walk import walker

_SLACK = 1e-9  # relative, by which a typed sequence of periods may touch the ends of its law


class Timetable:
    """Sampling instants t_0 = 0 < t_1 < ..

    periodic: t_k = k T. aperiodic: T_k drawn uniformly from (T_min, T_max] with the seed, or `sampling_times` at t_k.
    lossy: after each sample that arrives 0 to `lost` of those that follow are lost, each number as often as the others.
    random: each is lost with the law's probability. multirate: at the times of its phases. graph: see `walk`.
    on_change: those of comparisons. An instant within rounding of the horizon is the horizon.

    Raises:
        SpecError: a law that needs more samples than one run may have, or a typed period outside the law.
    """

    def __init__(self, law: SamplingLaw, plan: SimulationPlan, draws: Draws, max_samples: int) -> None:
        self.low, self.high, self.periodic = float(law.T_min), float(law.T_max), law.is_periodic or law.is_checked
        self.horizon, self.draws = float(plan.horizon), draws
        self.lost, self.probability = law.lost, float(law.probability)
        self.gaps = np.array([float(gap) for gap in law.gaps])
        self.readings = len(law.readings)
        self.walker = walker(law, draws, plan.runs) if law.is_graph else None
        self.slots = np.zeros(plan.runs)  # samples so far, lost ones too, of each run
        self._typed = None if plan.sampling_times is None else compile_floats([plan.sampling_times], ["t"], arrays=True)
        if law.is_graph and self._typed is not None:
            what, hint = "sensors have samples of their own", "leave sampling_times out: they are drawn with the seed"
            raise SpecError.at(("simulation", "sampling_times"), what, str(plan.sampling_times), hint=hint)
        if not self.high > 0:
            raise SpecError.at(
                ("measurement", "sampling"), "no sampling period above 0", str(law.document()), "a positive period"
            )
        mean = float(self.gaps.mean()) if self.gaps.size else (self.low + self.high) / 2
        samples = self.horizon / mean
        if self._typed is None and samples >= max_samples:
            got, allowed = f"about {samples:.3g} a run", f"{max_samples} a run"
            hint = "shorten the horizon or lengthen the period"
            raise SpecError.at(("simulation", "horizon"), "the horizon holds too many samples", got, allowed, hint)

    def reading(self, runs: Integers, index: int) -> Integers:
        """What sample number `index`, the next one of each run, reads; of no sensors 0."""
        if self.walker is not None:
            return self.walker.reading[runs]
        return np.full(len(runs), index % max(1, self.readings))

    def after(self, runs: Integers, index: int, t: Array) -> Array:
        """The instants that follow sample number `index`, which was at t (len(runs),)."""
        if self._typed is not None:
            period = stacked(self._typed(t), len(t))[0]
            self._refuse_outside(index, t, period)
            after = t + period
        elif self.walker is not None:
            after = self.walker.after(runs, index, t)
        elif self.probability:
            share = 1.0 - self.draws.at("periods", "uniform", 0, runs, index)  # in (0, 1]
            # A probability that rounds to 1 leaves no sample.
            lost = np.floor(np.log(share) / np.log(self.probability)) if self.probability < 1 else np.inf
            self.slots[runs] += 1 + lost
            after = self.slots[runs] * self.low
        elif self.lost:
            share = self.draws.at("periods", "uniform", 0, runs, index)
            self.slots[runs] += 1 + np.minimum(np.floor(share * (self.lost + 1)), self.lost)
            after = self.slots[runs] * self.low
        elif self.gaps.size:
            patterns, phase = divmod(index + 1, len(self.gaps))
            after = np.full(len(t), patterns * self.gaps.sum() + self.gaps[:phase].sum())
        elif self.periodic:
            after = np.full(len(t), (index + 1) * self.high)
        else:
            # 1 - u is in (0, 1]: a period is never 0.
            share = 1.0 - self.draws.at("periods", "uniform", 0, runs, index)
            after = t + self.low + (self.high - self.low) * share
        return np.where(np.abs(after - self.horizon) <= 1e-12 * self.horizon, self.horizon, after)

    def _refuse_outside(self, index: int, t: Array, period: Array) -> None:
        low, high = self.low, self.high
        if self.gaps.size:
            low = high = float(self.gaps[index % len(self.gaps)])
        wrong = ~((period > 0) & (period >= low * (1 - _SLACK)) & (period <= high * (1 + _SLACK)))
        if self.probability:
            wrong = ~(period > 0)
        if self.lost or self.probability:
            wrong |= np.abs(period / self.low - np.round(period / self.low)) > _SLACK * period / self.low
        if wrong.any():
            first = int(np.argmax(wrong))
            got = f"T_k = {period[first]:.9g} at t_k = {t[first]:.9g}"
            whole = f"a multiple of {self.low:.9g} " if self.lost or self.probability else ""
            allowed = f"{whole}above 0, in [{low:.9g}, {high:.9g}]"
            raise SpecError.at(("simulation", "sampling_times"), "a period outside the sampling law", got, allowed)
