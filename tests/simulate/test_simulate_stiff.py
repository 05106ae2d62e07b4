"""Stiff flows: found, gone on with implicitly, and told where they are too long; others are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, plant, read

from cdobs_cli.exact.expression import Variable
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.dormand_prince import A
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.simulate.implicit import ImplicitRun, Jacobian
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.signals import Signals
from cdobs_cli.simulate.stiffness import Stiffness, ratio


def two_rates(fast, period="1", phi=("0", "0")):
    """adot = -a + phi_1, bdot = fast (a - b) + phi_2: a is measured."""
    A = [["-1", 0], [fast, f"-{fast}"]]
    return copy_observer(plant(("a", "b"), A, phi, [[1, 0]], law=periodic(period)), ["0.5", "0"])


@pytest.fixture
def implicit_flows(monkeypatch):
    """The runs that flow implicitly, in order."""
    flows, advance = [], ImplicitRun.advance

    def counted(self, run, *further):
        flows.append(run)
        return advance(self, run, *further)

    monkeypatch.setattr(ImplicitRun, "advance", counted)
    return flows


@pytest.mark.parametrize("runs", [1, 3])
@pytest.mark.parametrize("fast", ["1e5", "1e6"])
def test_two_rates_agree_with_the_exact_solution(implicit_flows, fast, runs):
    """a = exp(-t); b is r/(r - 1) exp(-t) once exp(-r t) has gone; the copy's error in `a` halves at each sample."""
    system, r = two_rates(fast), float(fast)
    run = simulate(system, plan("5", [1, 0], [0, 0], runs=runs), system.plant.sampling)
    assert set(implicit_flows) == set(range(runs))
    for trajectory in run.trajectories:
        t, x = trajectory.t, trajectory.x
        assert x[:, 0] == pytest.approx(np.exp(-t), rel=1e-8)
        assert x[:, 1] == pytest.approx(r / (r - 1) * (np.exp(-t) - np.exp(-r * t)), rel=1e-8, abs=1e-9)
        error = trajectory.estimates["x_hat"][-1, 0] - x[-1, 0]
        assert error == pytest.approx(-np.exp(-5) / 2 ** len(trajectory.t_k), rel=1e-6)
    assert run.overall.stopped is None
    assert run.steps < 2000
    assert run.implicit == run.document()["implicit"] == runs


def test_van_der_pol_keeps_its_period(implicit_flows):
    """mu = 1000: T = (3 - 2 log 2) mu + 7.01432 mu^(-1/3) + ..; Source: HairerWanner1996, IV.8 prints its solution."""
    model = plant(("x", "v"), [[0, 1], [-1, 0]], ("0", "1000*(1 - x**2)*v"), law=periodic("100"))
    trajectory = simulate(copy_observer(model, ["0.5", "0"]), plan("2000", [2, 0], [1, 0]), model.sampling)
    t, x = trajectory.trajectories[0].t, trajectory.trajectories[0].x[:, 0]
    falls, rises = (t[np.flatnonzero(np.diff(np.sign(x)) == way)[0]] for way in (-2, 2))
    half = ((3 - 2 * np.log(2)) * 1000 + 7.01432 * 1000 ** (-1 / 3)) / 2
    assert rises - falls == pytest.approx(half, abs=2)  # the grid's step is 1
    assert implicit_flows
    assert trajectory.overall.stopped is None


@pytest.mark.parametrize(
    ("system", "start", "horizon"),
    [
        (pendulum(), [1, 0], "20"),
        (pendulum(period="2000"), [1, 0], "2000"),
        (copy_observer(plant(("x", "v"), [[0, "1e3"], ["-1e3", 0]], law=periodic("1")), ["1", "0"]), [1, 0], "3"),
        (copy_observer(plant(("x",), [["-1e3"]], law=periodic("1")), ["1"]), [1], "1"),
    ],
    ids=["pendulum", "pendulum, a long flow", "fast oscillation", "too short"],
)
@pytest.mark.parametrize("runs", [1, 2])
def test_a_flow_that_accuracy_bounds_is_never_switched(monkeypatch, implicit_flows, system, start, horizon, runs):
    told = plan(horizon, start, [0] * len(start), runs=runs)
    run = simulate(system, told, system.plant.sampling)
    assert not implicit_flows
    assert "implicit" not in run.document()
    monkeypatch.setattr(Stiffness, "worth_a_look", lambda _, left, *further: left < 0)
    unwatched = simulate(system, told, system.plant.sampling)
    assert run.steps == unwatched.steps
    for one, other in zip(run.trajectories, unwatched.trajectories, strict=True):
        assert np.array_equal(one.x, other.x)
        assert np.array_equal(one.estimates["x_hat"], other.estimates["x_hat"])


@pytest.mark.parametrize("runs", [1, 2])
def test_a_trigger_is_located_along_implicit_steps(implicit_flows, runs):
    """Ldot = L and L+ = 2 beside a fast state: (t - t_k) L = 1/2 has its root at W(1/4)."""
    law = SamplingLaw("updated")
    model = plant(("a", "b"), [["-1", 0], ["1e6", "-1e6"]], C=[[1, 0]], law=law)
    names = ["hat.a", "L", "y.0", "elapsed"]
    observer = Observer(
        ("hat.a", "L"), (Variable("initial.a"), read("2", names)), (read("-hat__a", names), read("L", names)),
        (Variable("y.0"), read("2", names)), {"x_hat": (Variable("hat.a"), Variable("hat.a"))}, jump_at_start=False,
        trigger=read("elapsed*L - 0.5", names),
    )  # fmt: skip
    run = simulate(HybridSystem(model, observer), plan("2", [1, 0], [0, 0], runs=runs), law)
    s = 0.2038883547022401649
    for trajectory in run.trajectories:
        assert trajectory.t_k == pytest.approx(s * np.arange(10), abs=1e-9)
    assert implicit_flows


def test_what_runs_see_does_not_depend_on_the_others(implicit_flows):
    """Only the runs with a > 1/2 are stiff while bdot reads 1e6 max(a - 1/2, 0)."""
    phi = ("0", "1e6*max(a - 0.5, 0)*(1 - b)")
    model = plant(("a", "b"), [["0", 0], [0, "-1"]], phi, [[1, 0]], law=periodic("1"))
    system = copy_observer(model, ["0.5", "0"])
    told = plan("2", None, [0, 0], initial_box=box([0, 0], [1, 1]), runs=6, seed=1)
    many = simulate(system, told, system.plant.sampling)
    stiff = [run for run, trajectory in enumerate(many.trajectories) if trajectory.x[0, 0] > 0.5]
    assert 0 < len(stiff) < 6
    assert set(implicit_flows) == set(stiff)
    assert many.implicit == len(stiff)
    for trajectory in many.trajectories:
        start = [repr(float(value)) for value in trajectory.x[0]]
        alone = simulate(system, plan("2", start, [0, 0]), system.plant.sampling).trajectories[0]
        assert trajectory.x[-1] == pytest.approx(alone.x[-1], rel=1e-8)


@pytest.mark.parametrize("runs", [1, 2])
def test_a_finite_escape_beside_a_fast_state_ends_with_its_sentence(implicit_flows, runs):
    """adot = a^2 from 1/2 ends at t = 2: no implicit step goes across."""
    system = two_rates("1e5", phi=("a + a**2", "0"))
    run = simulate(system, plan("10", [0.5, 0], [0.5, 0], runs=runs), system.plant.sampling)
    assert implicit_flows
    assert "without bound in finite time" in run.summaries[0].stopped
    assert run.trajectories[0].t[-1] == pytest.approx(2, abs=1e-6)


@pytest.mark.parametrize("runs", [1, 2])
def test_an_undefined_flow_ends_a_stiff_run(implicit_flows, runs):
    """adot = -1 + 0.1 sqrt(a - 1/2)^3 is undefined from where a has fallen to 1/2."""
    system = two_rates("1e5", phi=("a - 1 + 0.1*sqrt(a - 0.5)**3", "0"))
    run = simulate(system, plan("10", [2, 0], [2, 0], runs=runs), system.plant.sampling)
    assert implicit_flows
    assert "undefined or singular" in run.summaries[0].stopped
    assert run.trajectories[0].x[-1, 0] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(("runs", "advice"), [(1, "state or shorten"), (3, "state, simulate fewer runs or shorten")])
def test_too_many_implicit_steps_are_a_finding_with_advice(runs, advice):
    system = two_rates("1e5")
    run = simulate(system, plan("20", [1, 0], [0, 0], runs=runs), system.plant.sampling, max_steps=400)
    stopped = run.summaries[0].stopped
    assert "400 integration steps" in stopped
    assert (
        f"and stiff, with rates up to 1e+05 per time unit over a horizon of 20; eliminate the fast {advice}" in stopped
    )


def test_flows_too_short_for_an_implicit_method_are_told_to_be_stiff():
    system = two_rates("1e5", period="0.001")
    run = simulate(system, plan("20", [1, 0], [0, 0]), system.plant.sampling, max_steps=1000)
    assert "and stiff, with rates up to 1e+05" in run.overall.stopped


def test_many_stiff_runs_share_their_steps(monkeypatch):
    monkeypatch.setattr("cdobs_cli.simulate.flow.MAX_STEPS_TOGETHER", 1200)
    system = two_rates("1e5")
    run = simulate(system, plan("20", [1, 0], [0, 0], runs=3), system.plant.sampling)
    assert all("400 integration steps" in summary.stopped for summary in run.summaries)


def test_runs_that_reach_the_horizon_together_are_not_taken_one_by_one(implicit_flows, monkeypatch):
    """About 1600 explicit steps: quicker for many at once, and more than implicit ones may be for a thousand runs."""
    system = two_rates("1e4")
    starts = box([0, 0], [1, 1])
    for runs in (2, 300):
        monkeypatch.setattr("cdobs_cli.simulate.engine.MAX_STEPS_TOGETHER", 2000 * runs)
        told = plan("1", None, [0, 0], initial_box=starts, runs=runs)
        run = simulate(system, told, system.plant.sampling)
        assert not implicit_flows
        assert run.overall.stopped is None


def test_more_runs_than_can_go_one_by_one_are_told_to_be_stiff(implicit_flows, monkeypatch):
    monkeypatch.setattr("cdobs_cli.simulate.stiffness.MAX_RUNS", 2)
    system = two_rates("1e5")
    run = simulate(system, plan("1", [1, 0], [0, 0], runs=3), system.plant.sampling, max_steps=1000)
    assert not implicit_flows
    assert "1000 integration steps" in run.summaries[0].stopped
    assert "and stiff, with rates up to 1e+05" in run.summaries[0].stopped
    assert "simulate fewer runs" in run.summaries[0].stopped


def test_a_root_within_rounding_of_its_sample_is_no_crash(implicit_flows):
    """L is 1, then 1e-16: the second sample stands where the first does."""
    law = SamplingLaw("updated")
    model = plant(("a", "b"), [["-1", 0], ["1e6", "-1e6"]], C=[[1, 0]], law=law)
    names = ["hat.a", "L", "y.0", "elapsed"]
    observer = Observer(
        ("hat.a", "L"), (Variable("initial.a"), read("1", names)), (read("-hat__a", names), read("0", names)),
        (Variable("y.0"), read("1e-16", names)), {"x_hat": (Variable("hat.a"), Variable("hat.a"))},
        jump_at_start=False, trigger=read("elapsed - L", names),
    )  # fmt: skip
    run = simulate(HybridSystem(model, observer), plan("2", [1, 0], [0, 0]), law)
    assert implicit_flows
    assert "sampling instants accumulate" in run.overall.stopped
    assert run.trajectories[0].t_k[1] == pytest.approx(1, abs=1e-9)


def test_the_ratio_of_a_linear_flow_is_its_rate():
    """Of ydot = -r y the two stages differ by r times their distance, whatever they are."""
    slopes = np.linspace(1.0, 2.0, 13)[:, None, None] ** 2
    h, y, floor = np.array([0.1]), np.array([[3.0]]), np.ones((1, 1))
    stage = y + np.array(A[11]) @ slopes[:11, :, 0] * h
    new = stage - 0.25
    slopes[12] = slopes[11] - 40.0 * (new - stage)
    assert ratio(h, y, new, slopes, floor) == pytest.approx([0.1 * 40])


def test_the_jacobian_is_that_of_differences_and_0_where_undefined():
    system = copy_observer(
        plant(("x", "v"), [[0, 1], [-1, 0]], ("0", "1000*(1 - x**2)*v + sqrt(x)")), ["0.5", "0"]
    )  # fmt: skip
    loop = ClosedLoop(system, Signals.of(system.plant, {}, {}))
    J, flow, z = Jacobian(loop), loop.scalar_flow(), np.array([0.7, 0.3, 0.4, -0.2])
    step = 1e-6 * np.eye(4)
    apart = [np.subtract(flow(0.0, *(z + e), 0.0), flow(0.0, *(z - e), 0.0)) / 2e-6 for e in step]
    assert J(0.0, z, (0.0,)) == pytest.approx(np.array(apart).T, rel=1e-6, abs=1e-6)
    assert not J(0.0, np.zeros(4), (0.0,)).any()
