"""Points of the output grid, read off many steps at once: what they are, and that none is left out."""

from dataclasses import replace

import numpy as np
import pytest
from loops import box, copy_observer, periodic, plan, plant, read
from test_compiled import compiled_of

from cdobs_cli.library import compiler
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate import postponed
from cdobs_cli.simulate.engine import simulate, simulate_batch
from cdobs_cli.simulate.record import SHOWN


def oscillator(period):
    """x = cos t, -sin t from (1, 0), whatever the observer does."""
    model = plant(("a", "b"), [[0, 1], [-1, 0]], law=periodic(period))
    return copy_observer(model, ["0.5", "0.1"])


def asked(runs, **further):
    return plan("12", [1, 0], [0, 0], runs=runs, **further)


def distance(trajectory):
    return np.abs(trajectory.x - np.array([np.cos(trajectory.t), -np.sin(trajectory.t)]).T).max()


# The grid has every sample of the first, and none but those at 0 and 12 of the second; steps hold several points of
# one run, and few of many.
@pytest.mark.parametrize("period", ["0.6", "0.7003", "12"])
@pytest.mark.parametrize("runs", [1, 3, 40])
def test_points_are_those_of_the_flow(period, runs):
    run = simulate(oscillator(period), asked(runs), periodic(period))
    grid = np.linspace(0, 12, 201 if runs > SHOWN else 2001)
    for trajectory in run.trajectories:
        assert np.all(np.diff(trajectory.t) >= 0)
        assert np.array_equal(np.unique(trajectory.t.round(9)), np.union1d(grid.round(9), trajectory.t_k.round(9)))
        assert distance(trajectory) < 1e-10


@pytest.mark.skipif(compiler() is None, reason="no compiler")
@pytest.mark.parametrize("period", ["0.6", "0.7003"])
def test_points_in_machine_code_are_those_of_the_flow(period):
    system, many = oscillator(period), asked(40)
    code = simulate_batch(system, many, periodic(period), compiled=compiled_of(system, many))
    arrays = simulate_batch(system, many, periodic(period))
    assert np.array_equal(code.paths.offsets, arrays.paths.offsets)
    assert np.array_equal(code.paths.t, arrays.paths.t)
    assert distance(code.trajectory(7)) < 1e-10


def test_points_do_not_depend_on_when_they_are_read(monkeypatch):
    system = oscillator("0.7003")
    starts = plan("12", None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=40)
    whole = simulate_batch(system, starts, periodic("0.7003")).paths
    monkeypatch.setattr(postponed, "_AT_ONCE", 1)
    assert np.array_equal(simulate_batch(system, starts, periodic("0.7003")).paths.z, whole.z)


@pytest.mark.parametrize("runs", [1, 3, 40])
def test_an_instant_that_is_chosen_may_be_a_point_of_the_grid(runs):
    system = oscillator("1")
    trigger = read("elapsed - 0.3", ["elapsed"])
    observer = replace(system.observer, trigger=trigger)
    run = simulate(replace(system, observer=observer), asked(runs), SamplingLaw("updated"))
    for trajectory in run.trajectories:
        assert trajectory.t_k == pytest.approx(0.3 * np.arange(len(trajectory.t_k)), abs=1e-12)
        assert distance(trajectory) < 1e-10
