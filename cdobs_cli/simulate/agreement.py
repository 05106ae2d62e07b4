"""Whether the figures of a stored run are those of its trajectories, as far as these show them."""

from __future__ import annotations

from math import isclose

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.run import Run, RunSummary, Trajectory
from cdobs_cli.simulate.departure import Departures, Limits
from cdobs_cli.simulate.loop import View
from cdobs_cli.simulate.record import Paths
from cdobs_cli.simulate.summary import of_trajectory, overall, root_mean_squares
from cdobs_cli.simulate.watch import DIVERGED, distance

_ROUNDING = 1e-9
_TOGETHER = 1e-3  # what a second observer in the loop may change of the steps, and so of the first one's error


def agrees(run: Run, system: HybridSystem) -> bool:
    """Whether every run is one of this plant and observer, and its summary does not say better of it than its
    trajectory shows: measurements, periods, errors anew; divergence, leaving the domain and the margin of the
    inclusion at least as bad as on the grid (the integrator has looked at more points than are kept)."""
    pairs = zip(run.trajectories, (run.summaries[number] for number in run.shown), strict=True)
    return (
        overall(run.summaries) == run.overall
        and _is_compared(run, system)
        and all(_is_of(one, system) and _agrees(one, system, told) for one, told in pairs)
    )


def _is_compared(run: Run, system: HybridSystem) -> bool:
    """Whether there is a comparison where one belongs, and it says no better of observer and filter than run 0 shows:
    the mean square over the runs is at least its share."""
    plant, told, filtered = system.plant, run.comparison, run.filtered
    declared = plant.is_perturbed
    if not (declared and "x_hat" in system.observer.estimates):
        return told is None and filtered is None
    if told is None or told.seeds < 1 or not told.states.keys() <= set(plant.states):
        return False
    shares = [(one.rmse, run.summaries[0].rmse_after_transient.get(name, 0.0)) for name, one in told.states.items()]
    if filtered is not None:
        shown = root_mean_squares(plant.states, Paths.one(filtered.t, filtered.error.T), filtered.error.T, late=True)[0]
        shares += [(one.rmse_ekf or 0.0, shown.get(name, 0.0)) for name, one in told.states.items()]
    elif any(one.rmse_ekf is not None for one in told.states.values()):
        return False
    return all(mean * told.seeds**0.5 >= share * (1.0 - _TOGETHER) for mean, share in shares)


def _is_of(one: Trajectory, system: HybridSystem) -> bool:
    plant, observer = system.plant, system.observer
    shown = one.x.shape[1], one.y_k.shape[1], one.estimates.keys(), one.internals.keys()
    known = shown == (plant.n, plant.p, observer.estimates.keys(), observer.internals.keys())
    known = known and (one.arrival_k is not None) == bool(plant.delays)
    return known and {source.name for source in plant.inputs} <= one.inputs.keys()


def _agrees(one: Trajectory, system: HybridSystem, told: RunSummary) -> bool:
    with np.errstate(all="ignore"):
        nothing: Array = np.empty((0, len(one.t)))
        seen = View(one.x.T, {name: rows.T for name, rows in one.estimates.items()}, {}, {}, nothing)
        shown = of_trajectory(system.plant.states, one, seen, told)
        if not (shown.document().keys() == told.document().keys() and _are_close(shown, told)):
            return False
        error = distance(seen)
        diverges = error is not None and bool(np.any(error > DIVERGED * (1.0 + error[0]) * (1.0 + _ROUNDING)))
        if (diverges and not told.diverged) or not _tells_of_leaving(system, one.t, seen, told):
            return False
        if told.diverged and one.stopped is None:
            return False
        if not seen.encloses:
            return told.inclusion_margin is None
        return told.inclusion_margin is not None and told.inclusion_margin <= max(float(seen.margin.min()), 0.0)


def _tells_of_leaving(system: HybridSystem, t: Array, seen: View, told: RunSummary) -> bool:
    """Whether the run is told to leave the domain no later than the grid shows, and by a limit that there is."""
    limits, departure = Limits(system), told.departure
    departures = Departures(limits, 1)
    departures.look(np.zeros(len(t), dtype=np.int64), t, seen.x, seen.estimates.get("x_hat"))
    shown = departures.of(0)
    if departure is None or not told.left_domain:
        return shown is None and departure is None and not told.left_domain
    is_known = any((one.what, one.text) == (departure.what, departure.allowed) for one in limits.limits)
    return is_known and departure.beyond > 0 and (shown is None or departure.time <= shown.time)


def _are_close(shown: RunSummary, told: RunSummary) -> bool:
    numbers = [(getattr(shown, name), getattr(told, name)) for name in ("period_min", "period_max", "error_final")]
    for a, b in ((shown.rmse, told.rmse), (shown.rmse_after_transient, told.rmse_after_transient)):
        numbers += [(a.get(name), b.get(name)) for name in a.keys() | b.keys()]
    exact = (shown.measurements, shown.stopped) == (told.measurements, told.stopped)
    # Sums may be taken in another order by another release of numpy.
    return exact and all(a == b or (None not in (a, b) and isclose(a, b, rel_tol=_ROUNDING)) for a, b in numbers)
