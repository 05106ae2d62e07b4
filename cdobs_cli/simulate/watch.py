"""What ends a run early, and what is noted along the way: divergence, stops, the domain, enclosure."""

from __future__ import annotations

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.simulate.departure import Departures, Limits
from cdobs_cli.simulate.loop import ClosedLoop, View

DIVERGED = 1e6  # times 1 + |e0|


class Watch:
    """Looks at every accepted step and both sides of every jump.

    halted, diverged, margin, stop_t: (R,); stopped: one sentence a run, or None; stop_y, stop_held: the state where a
    run was stopped; departures: who left the domain.
    """

    def __init__(self, loop: ClosedLoop, runs: int) -> None:
        self.loop = loop
        self.halted, self.diverged = (np.zeros(runs, dtype=bool) for _ in range(2))
        self.departures = Departures(Limits(loop.system), runs)
        self.margin, self.stop_t, self.limit = np.full(runs, np.inf), np.full(runs, np.inf), np.full(runs, np.inf)
        self.stopped: list[str | None] = [None] * runs
        leaves = "the input {} that the controller sets left its declared range"
        self.reasons = (
            "the error grew beyond 1e6 (1 + |e0|)",
            *(sentence for _, sentence in loop.observer.stops),
            *(leaves.format(one.name) for one in loop.signals.held_ranges),
        )
        self.stop_y, self.stop_held = np.zeros((loop.size, runs)), np.zeros((len(loop.held), runs))

    def begin(self, t: Array, y: Array, held: Array) -> None:
        """Fix the limit of the error from where all runs start."""
        error = distance(self.loop.see(t, y, held))
        if error is not None:
            self.limit = DIVERGED * (1.0 + error)

    def __call__(self, runs: Integers, t: Array, y: Array, held: Array) -> Booleans:
        """Look at points (P,), in the order of time for each run. Returns `halted`.

        Raises:
            SpecError: a signal outside its declared interval.
        """
        seen = self.loop.see(t, y, held)
        self.loop.signals.refuse_outside(t, seen.signals)
        finite = np.isfinite(y).all(axis=0)
        error = distance(seen)
        near = finite if error is None else finite & (error <= self.limit[runs])
        # A condition that cannot be evaluated is not met.
        bad = [np.logical_not(near), *(~(row > 0) for row in seen.stops)]
        bad += [~one.holds(seen.signals[one.name]) for one in self.loop.signals.held_ranges]
        for number, points in enumerate(bad):
            for point in np.flatnonzero(points) if points.any() else ():
                run = int(runs[point])
                if t[point] < self.stop_t[run]:
                    self.halt(
                        run, float(t[point]), y[:, point], held[:, point], self.reasons[number], diverged=number == 0
                    )
        if not (self.departures.limits or seen.encloses):
            return self.halted
        going = finite & (t <= self.stop_t[runs])
        x_hat = seen.estimates.get("x_hat")
        self.departures.look(runs[going], t[going], seen.x[:, going], None if x_hat is None else x_hat[:, going])
        if seen.encloses:
            np.minimum.at(self.margin, runs[going], seen.margin[going])
        return self.halted

    def halt(self, run: int, t: float, y: Array, held: Array, sentence: str, *, diverged: bool) -> None:
        """End a run at time t; of several reasons the earliest counts."""
        self.halted[run], self.diverged[run], self.stop_t[run] = True, diverged, t
        self.stop_y[:, run], self.stop_held[:, run] = y, held
        self.stopped[run] = f"{sentence} (t = {t:.6g})"


def distance(seen: View) -> Array | None:
    """|x_hat - x|, or the larger distance of x from the ends of its interval."""
    if "x_hat" in seen.estimates:
        parts = seen.estimates["x_hat"] - seen.x
    elif seen.encloses:
        parts = np.maximum(np.abs(seen.x - seen.estimates["x_lower"]), np.abs(seen.estimates["x_upper"] - seen.x))
    else:
        return None
    return np.sqrt((parts * parts).sum(axis=0))  # type: ignore[no-any-return]
