"""Observers that choose their sampling instants: located roots, accumulation, runaway."""

import numpy as np
import pytest
from loops import box, plan, plant, read
from scipy.special import lambertw

from cdobs_cli.exact.expression import Variable
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate

UPDATED = SamplingLaw("updated")


def updated(rate, trigger="elapsed*L - 0.5", jump="2", start="2", **further):
    """An observer whose only lively state is a gain L between samples: Ldot = rate, L+ = jump."""
    model = plant(("x",), [["-1"]], law=UPDATED)
    names = ["hat.x", "L", "y.0", "elapsed", "t"]
    observer = Observer(
        ("hat.x", "L"), (Variable("initial.x"), read(start, names)), (read("-hat__x", names), read(rate, names)),
        (Variable("y.0"), read(jump, names)), {"x_hat": (Variable("hat.x"),)}, jump_at_start=False,
        trigger=read(trigger, names), internals={"L": Variable("L")}, **further,
    )  # fmt: skip
    return HybridSystem(model, observer)


@pytest.mark.parametrize("runs", [1, 3])
def test_instants_agree_with_the_closed_form_to_1e_12(runs):
    """Ldot = L, L+ = 2: s 2 exp(s) = 1/2 gives s = W(1/4)."""
    run = simulate(updated("L"), plan("5", [1], [0], runs=runs), UPDATED)
    s = float(lambertw(0.25).real)
    for trajectory in run.trajectories:
        t_k = trajectory.t_k
        assert len(t_k) == 1 + int(5 / s)
        assert t_k == pytest.approx(s * np.arange(len(t_k)), rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("runs", [1, 2])
def test_the_first_of_several_roots_is_taken(runs):
    """0.5 - cos(3 s) first reaches 0 at s = pi/9; a step may hold several of its roots."""
    run = simulate(updated("0", "0.5 - cos(3*elapsed)"), plan("4", [1], [0], runs=runs), UPDATED)
    assert np.diff(run.trajectories[0].t_k) == pytest.approx(np.pi / 9, rel=1e-12)


def test_runs_with_different_instants_agree_with_each_run_alone():
    system = updated("L*(1 + hat__x**2)")
    many = simulate(system, plan("3", None, [0], initial_box=box([-2], [2]), runs=6, seed=3), UPDATED)
    assert len({len(trajectory.t_k) for trajectory in many.trajectories}) > 1
    for trajectory in many.trajectories[:3]:
        alone = simulate(system, plan("3", [repr(float(trajectory.x[0, 0]))], [0]), UPDATED).trajectories[0]
        assert trajectory.t_k == pytest.approx(alone.t_k, rel=1e-11)
        assert trajectory.internals["L"] == pytest.approx(alone.internals["L"], rel=1e-9)


@pytest.mark.parametrize("runs", [1, 2])
def test_accumulating_instants_are_a_finding(runs):
    """L+ = 10 L: the periods shrink tenfold each, and their sum is finite."""
    run = simulate(updated("0", jump="10*L"), plan("5", [1], [0], runs=runs), UPDATED)
    assert "accumulate" in run.summaries[0].stopped
    assert run.trajectories[0].t[-1] == pytest.approx(0.25 / 0.9, rel=1e-9)


def test_a_gain_that_runs_away_is_a_finding():
    """Ldot = L^3 escapes before s L reaches the trigger's level."""
    run = simulate(updated("L**3", "elapsed*L - 1e9"), plan("5", [1], [0]), UPDATED)
    assert run.overall.stopped is not None
    assert run.trajectories[0].t[-1] == pytest.approx(1 / 8, abs=1e-3)
    stops = ((read("100 - L", ["L"]), "the gain grew beyond 100"),)
    run = simulate(updated("L**3", "elapsed*L - 1e9", stops=stops), plan("5", [1], [0]), UPDATED)
    assert run.overall.stopped.startswith("the gain grew beyond 100")
    assert run.trajectories[0].internals["L"][-1] >= 100


def test_a_trigger_that_is_not_below_zero_after_a_sample_is_a_finding():
    run = simulate(updated("0", "elapsed + 1"), plan("5", [1], [0]), UPDATED)
    assert "not below 0" in run.overall.stopped


def test_too_many_measurements_are_a_finding(monkeypatch):
    monkeypatch.setattr("cdobs_cli.simulate.engine.MAX_SAMPLES", 50)
    run = simulate(updated("0", "elapsed - 0.01"), plan("5", [1], [0]), UPDATED)
    assert "50 measurements" in run.overall.stopped
    assert run.overall.measurements == 50


def test_a_trigger_that_never_fires_runs_to_the_horizon():
    run = simulate(updated("0", "-1"), plan("2", [1], [0]), UPDATED)
    assert run.overall.stopped is None
    assert run.overall.measurements == 1
    assert run.overall.period_min is None
    assert run.trajectories[0].t[-1] == 2
