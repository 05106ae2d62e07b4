"""From one sample to the next by the explicit method, and by the implicit one from where a run is found stiff."""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.simulate.implicit import MAX_STEPS_TOGETHER, ImplicitRun
from cdobs_cli.simulate.integrator import End, ManyRuns, OneRun, Progress, Watch
from cdobs_cli.simulate.loop import ClosedLoop

if TYPE_CHECKING:
    from cdobs_cli.simulate.record import Grid

_AT_THE_END = 3.0  # h times the fastest rate: steps that stability bounds, though the flow is short


class Flow:
    """All runs; those that are stiff go on one after the other."""

    def __init__(self, loop: ClosedLoop, horizon: float, max_steps: int, runs: int, together: int) -> None:
        """together: the runs that share limits of work, these among them."""
        self.loop, self.horizon, self.max_steps, self.runs = loop, horizon, max_steps, together
        one, many = partial(OneRun, loop, horizon, max_steps), partial(ManyRuns, loop, horizon, max_steps)
        self.explicit = one() if together == 1 else many(runs, together)
        self.stiff = np.zeros(runs, dtype=bool)

    @cached_property
    def implicit(self) -> ImplicitRun:
        return ImplicitRun(self.loop, self.horizon, min(self.max_steps, MAX_STEPS_TOGETHER // self.runs))

    def advance(self, runs: Integers, progress: Progress, ends: Array, grid: Grid, watch: Watch) -> Integers:
        """Flow the given runs to their ends (len(runs),); returns an End code for each."""
        codes, quick = np.full(len(runs), End.STIFF), np.flatnonzero(~self.stiff[runs])
        if quick.size:
            codes[quick] = self.explicit.advance(runs[quick], progress, ends[quick], grid, watch)
        for i in np.flatnonzero(codes == End.STIFF):
            self.stiff[runs[i]] = True
            codes[i] = self.implicit.advance(int(runs[i]), progress, float(ends[i]), grid, watch)
        return codes

    def exhausted(self, run: int, progress: Progress) -> str:
        """The sentence of a run that took more steps than it may, with its fastest rate."""
        held = tuple(progress.held[:, run].tolist())
        rate = self.implicit.jacobian.fastest(float(progress.t[run]), progress.y[:, run], held)
        stiff = bool(self.stiff[run])
        steps = self.implicit.max_steps if stiff else self.max_steps
        what = f"more than {steps} integration steps: the flow is too fast for this horizon"
        rates = f"rates up to {rate:.3g} per time unit over a horizon of {self.horizon:.6g}"
        if not stiff and not progress.h[run] * rate > _AT_THE_END:
            return f"{what}, with {rates}; a shorter horizon can be simulated"
        fewer = ", simulate fewer runs" if self.runs > 1 else ""
        return f"{what}, and stiff, with {rates}; eliminate the fast state{fewer} or shorten the horizon"
