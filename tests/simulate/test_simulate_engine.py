"""Flow, jump, next sample: against matrix exponentials, closed forms, and known behaviour of observers."""

import json

import numpy as np
import pytest
from loops import box, copy_observer, exact, pendulum, periodic, plan, plant, read
from scipy.linalg import expm

from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Domain, Input, Interval
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate

BOX = box([-1, -1], [1, 1])


def run_pendulum(K=("1", "1.8361"), horizon="20", **further):
    system = pendulum(K)
    return simulate(system, plan(horizon, further.pop("x0", [1, 0]), [0, 0], **further), system.plant.sampling)


def test_dinh2014_observer_3_converges_with_the_right_sign_of_its_gain():
    run = run_pendulum()
    assert run.overall.error_final < 1e-9
    assert not run.overall.diverged
    assert run.overall.stopped is None
    assert run.overall.measurements == 34  # t = 0, 0.6, .., 19.8


def test_dinh2014_printed_gain_diverges():
    run = run_pendulum(("-1", "-1.8361"))
    assert run.overall.diverged
    assert "1e6" in run.overall.stopped
    assert run.trajectories[0].t[-1] < 20
    assert np.isfinite(run.trajectories[0].x).all()


@pytest.mark.parametrize("runs", [1, 3])
def test_linear_plants_agree_with_the_matrix_exponential(runs):
    A = [["-0.1", "2", "0"], ["-2", "-0.1", "1"], ["0", "0.3", "0.2"]]
    model = plant(("a", "b", "c"), A, law=periodic("0.7"))
    K = ["0.8", "-0.3", "0.1"]
    system = copy_observer(model, K)
    run = simulate(system, plan("9.1", [1, "-0.5", "0.25"], [0, 0, 0], runs=runs), model.sampling)
    A, K = model.A.floats, np.array(K, dtype=float)
    for trajectory in run.trajectories:
        e = np.array([-1.0, 0.5, -0.25])
        for t_k in trajectory.t_k:
            places = np.flatnonzero(np.abs(trajectory.t - t_k) < 1e-13)
            assert len(places) == 2
            error = trajectory.estimates["x_hat"][places] - trajectory.x[places]
            assert error[0] == pytest.approx(e, abs=1e-10)
            e = e - K * e[0]
            assert error[1] == pytest.approx(e, abs=1e-10)
            inside = np.flatnonzero((trajectory.t > t_k) & (trajectory.t < t_k + 0.7 - 1e-9))
            for i in inside[::9]:
                e_t = expm(A * (trajectory.t[i] - t_k)) @ e
                assert trajectory.estimates["x_hat"][i] - trajectory.x[i] == pytest.approx(e_t, abs=1e-10)
            e = expm(A * 0.7) @ e
        x = np.array([expm(A * t) @ [1, -0.5, 0.25] for t in trajectory.t[::50]])
        assert np.abs(trajectory.x[::50] - x).max() < 1e-10 * np.abs(x).max()


@pytest.mark.parametrize("runs", [1, 2])
def test_a_flow_that_jumps_at_samples_is_never_integrated_across_one(runs):
    """The observer counts samples and its flow is the parity: the exact integral is a sum of whole periods."""
    model = plant(("x",), [[0]], law=periodic("0.3"))
    names = ["count", "area", "y.0"]
    observer = Observer(
        ("count", "area"), (read("0", names), read("0", names)),
        (read("0", names), read("max(-1, min(1, 1e6*(1.5 - count)))", names)),
        (read("3 - count", names), Variable("area")), {"x_hat": (Variable("area"),)}, jump_at_start=False,
    )  # fmt: skip
    system = HybridSystem(model, observer)
    run = simulate(system, plan("3", [0], runs=runs), model.sampling)
    area = run.trajectories[0].estimates["x_hat"][:, 0]
    t = run.trajectories[0].t
    # count is 0, 3, 0, 3, ..: the slope is +1 on even periods and -1 on odd ones, exactly.
    k = np.floor(t / 0.3 + 1e-9)
    expected = np.where(k % 2 == 0, t - 0.3 * k, 0.3 - (t - 0.3 * k))
    assert np.abs(area - expected).max() < 1e-13


def test_a_batch_equals_its_single_runs():
    system = pendulum()
    many = simulate(system, plan("6", None, [0, 0], initial_box=BOX, runs=20, seed=5), system.plant.sampling)
    for r in (0, 7, 19):
        start = many.trajectories[r].x[0]
        alone = simulate(system, plan("6", [repr(float(v)) for v in start], [0, 0]), system.plant.sampling)
        batch, single = many.trajectories[r], alone.trajectories[0]
        assert batch.t_k == pytest.approx(single.t_k, abs=1e-13)
        assert np.abs(batch.t - single.t).max() < 1e-13
        assert np.abs(batch.x - single.x).max() < 1e-9
        assert np.abs(batch.estimates["x_hat"] - single.estimates["x_hat"]).max() < 1e-9
        assert many.summaries[r].rmse["theta"] == pytest.approx(alone.overall.rmse["theta"], rel=1e-9)


def test_aperiodic_periods_come_from_the_seed_and_do_not_depend_on_other_runs():
    law = SamplingLaw("aperiodic", Exact("0.1"), Exact("0.5"))
    system = pendulum()

    def simulated(runs, seed):
        return simulate(system, plan("5", [1, 0], [0, 0], runs=runs, seed=seed), law)

    first, again, other = simulated(3, 1), simulated(5, 1), simulated(3, 2)
    for r in range(3):
        assert np.array_equal(first.trajectories[r].t_k, again.trajectories[r].t_k)
        periods = np.diff(first.trajectories[r].t_k)
        assert periods.min() >= 0.1 and periods.max() <= 0.5
    assert not np.array_equal(first.trajectories[0].t_k, first.trajectories[1].t_k)
    assert not np.array_equal(first.trajectories[0].t_k, other.trajectories[0].t_k)
    assert np.array_equal(simulated(1, 1).trajectories[0].t_k, first.trajectories[0].t_k)


def test_typed_sampling_times_are_followed_and_must_be_in_the_law():
    law = SamplingLaw("aperiodic", Exact(0), Exact("0.5"))
    system = pendulum()
    run = simulate(system, plan("3", [1, 0], [0, 0], sampling_times="0.3 + 0.1*cos(t)"), law)
    t_k = run.trajectories[0].t_k
    assert np.diff(t_k) == pytest.approx(0.3 + 0.1 * np.cos(t_k[:-1]), abs=1e-12)
    with pytest.raises(SpecError, match=r"simulation\.sampling_times.*T_k = 0\.6"):
        simulate(system, plan("3", [1, 0], [0, 0], sampling_times="0.3 + 0.3*cos(t)"), law)


def test_an_undefined_flow_ends_with_a_sentence_and_not_with_nan():
    model = plant(("h",), [[0]], ("-sqrt(h)",), law=periodic("0.5"))
    system = copy_observer(model, ["1"])
    for runs in (1, 2):
        run = simulate(system, plan("5", [1], ["1.1"], runs=runs), model.sampling)
        assert "undefined or singular" in run.summaries[0].stopped
        assert run.trajectories[0].t[-1] == pytest.approx(2.0, abs=1e-3)
        assert np.isfinite(run.trajectories[0].x).all()


def test_finite_escape_is_divergence():
    model = plant(("z",), [[0]], ("z**2",), law=periodic("0.5"))
    system = copy_observer(model, ["1"])
    for runs in (1, 2):
        run = simulate(system, plan("5", [1], [1], runs=runs), model.sampling)
        assert run.overall.diverged
        assert run.summaries[0].stopped is not None
        assert run.trajectories[0].t[-1] == pytest.approx(1.0, abs=1e-3)


def test_stop_conditions_of_an_observer_end_the_run():
    model = plant(("x",), [[1]], law=periodic("0.25"))
    system = copy_observer(model, ["1"], stops=((read("10 - hat__x", ["hat.x"]), "x_hat left its box"),))
    for runs in (1, 2):
        run = simulate(system, plan("10", [1], [1], runs=runs), model.sampling)
        assert run.summaries[0].stopped.startswith("x_hat left its box")
        assert not run.summaries[0].diverged
        assert np.log(10) <= run.trajectories[0].t[-1] < np.log(10) + 0.25


def test_leaving_the_domain_is_noted_for_the_state_and_for_the_estimate():
    domain = Domain({"theta": Interval(Exact(-1), Exact("1.5"))})
    run = simulate(pendulum(domain=domain), plan("1", [0, 0], [0, 0]), periodic("0.6"))
    assert not run.overall.left_domain
    run = simulate(pendulum(domain=domain), plan("20", [1, "0.5"], [1, "0.5"]), periodic("0.6"))
    assert run.overall.left_domain
    run = simulate(pendulum(domain=domain), plan("1", [0, 0], [2, 0]), periodic("0.6"))
    assert run.overall.left_domain
    where = Domain(where=(read("0.5 - theta", ["theta"]),))
    assert simulate(pendulum(domain=where), plan("20", ["0.4", 0], [0, 0]), periodic("0.6")).overall.left_domain


def test_extreme_scales():
    """Time scaled by 1e6 and states by 1e-6: the same trajectory, scaled."""
    slow = run_pendulum(horizon="6")
    model = plant(
        ("theta", "omega"), [[0, "1e6"], [0, 0]], ("0", "sin(theta*1e6)"), law=periodic("6e-7")
    )  # theta' = 1e6 omega, in microseconds and micro-units
    fast = simulate(copy_observer(model, ["1", "1.8361"]), plan("6e-6", ["1e-6", 0], [0, 0]), model.sampling)
    # theta = 1e-6 s, omega = 1e-6 w with ds/dT = w, dw/dT = sin(s) in T = 1e6 t.
    assert fast.overall.measurements == slow.overall.measurements
    assert fast.trajectories[0].x * 1e6 == pytest.approx(slow.trajectories[0].x, abs=1e-8)


def test_work_is_bounded_before_it_starts():
    system = pendulum(period="1e-9")
    with pytest.raises(SpecError, match=r"simulation\.horizon.*too many samples"):
        simulate(system, plan("1e6", [1, 0], [0, 0]), system.plant.sampling)
    with pytest.raises(SpecError, match="period"):
        simulate(system, plan("1", [1, 0], [0, 0]), SamplingLaw("aperiodic", Exact(0), Exact(0)))
    with pytest.raises(SpecError, match=r"simulation\.runs"):
        simulate(system, plan("1e-6", [1, 0], [0, 0], runs=10**9), system.plant.sampling)
    with pytest.raises(SpecError, match="initial state"):
        simulate(system, plan("1e-6"), system.plant.sampling)


def test_a_flow_too_fast_for_its_horizon_ends_with_a_finding(monkeypatch):
    monkeypatch.setattr("cdobs_cli.simulate.engine.MAX_STEPS", 2000)
    model = plant(("x", "v"), [[0, "1e7"], ["-1e7", 0]], law=periodic("1"))
    for runs in (1, 2):
        run = simulate(copy_observer(model, ["1", "0"]), plan("5", [1, 0], [0, 0], runs=runs), model.sampling)
        assert "2000 integration steps" in run.summaries[0].stopped
        assert "rates up to 1e+07 per time unit over a horizon of 5" in run.summaries[0].stopped
        assert not run.summaries[0].diverged


def test_a_controlled_input_is_held_from_sample_to_sample():
    model = plant(("x",), [[0]], law=periodic("0.5"), inputs=(Input("u", Interval(Exact(-1), Exact(1))),), B=[[1]])
    control = {"u": read("-0.5*hat__x", ["hat.x"])}
    run = simulate(copy_observer(model, ["1"], control=control), plan("3", [1], [0]), model.sampling)
    trajectory = run.trajectories[0]
    # x_hat = x after every jump and flows as x does: x(t_k) = 0.75^k, u_k = -x_k / 2.
    for k, t_k in enumerate(trajectory.t_k):
        inside = (trajectory.t > t_k) & (trajectory.t < t_k + 0.5)
        assert trajectory.inputs["u"][inside] == pytest.approx(-0.5 * 0.75**k, abs=1e-12)
        assert trajectory.y_k[k] == pytest.approx(0.75**k, abs=1e-12)
    strong = {"u": read("-3*hat__x", ["hat.x"])}
    run = simulate(copy_observer(model, ["1"], control=strong), plan("3", [1], [0]), model.sampling)
    assert "input u" in run.overall.stopped


def test_enclosing_estimates_give_a_margin():
    """xdot = -x in [x_lower, x_upper] with the same flow: the margin is the distance at the horizon."""
    model = plant(("x",), [[-1]], law=periodic("0.5"))
    names = ["low", "up", "y.0"]
    observer = Observer(
        ("low", "up"), (Variable("lower.x"), Variable("upper.x")), (read("-low", names), read("-up", names)),
        (Variable("low"), Variable("up")), {"x_lower": (Variable("low"),), "x_upper": (Variable("up"),)},
    )  # fmt: skip
    system = HybridSystem(model, observer)
    run = simulate(system, plan("2", [1], initial_box=box([0], ["1.5"])), model.sampling)
    assert run.overall.inclusion_margin == pytest.approx(0.5 * np.exp(-2), rel=1e-9)
    outside = simulate(system, plan("2", [2], initial_box=box([0], ["1.5"])), model.sampling)
    assert outside.overall.inclusion_margin == pytest.approx(-0.5, rel=1e-9)
    with pytest.raises(SpecError, match="known box"):
        simulate(system, plan("2", [1]), model.sampling)


def test_initial_states_fill_the_box_and_no_more():
    run = simulate(pendulum(), plan("0.1", None, [0, 0], initial_box=box([2, -1], [3, 0]), runs=400), periodic("0.6"))
    starts = np.array([trajectory.x[0] for trajectory in run.trajectories])
    assert (starts >= [2, -1]).all() and (starts <= [3, 0]).all()
    assert starts.mean(axis=0) == pytest.approx([2.5, -0.5], abs=0.06)
    assert exact([1]) is not None


def test_where_conditions_are_checked_along_the_estimate_too():
    where = Domain(where=(read("0.5 - theta", ["theta"]),))
    assert simulate(pendulum(domain=where), plan("0.1", [0, 0], [1, 0]), periodic("0.6")).overall.left_domain
    assert not simulate(pendulum(domain=where), plan("0.1", [0, 0], ["0.4", 0]), periodic("0.6")).overall.left_domain


@pytest.mark.parametrize("seed", range(6))
def test_random_linear_loops_at_extreme_scales(seed):
    """States of size 1e-6 to 1e6, time constants of 1e-6 to 1e6: the sampled error map is J exp(A T)."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 5))
    rate, size = 10.0 ** random.uniform(-6, 6, 2)
    A = np.round(random.normal(size=(n, n)), 3)
    K = np.round(random.normal(size=n) / 2, 3)
    x = np.round(random.normal(size=n), 3)
    period = f"{0.5 / rate:.6g}"
    model = plant(
        [f"x{i}" for i in range(n)], [[repr(float(v)) for v in row] for row in A * rate], law=periodic(period)
    )
    system = copy_observer(model, [repr(float(v)) for v in K])
    start = [repr(float(v * size)) for v in x]
    run = simulate(system, plan(repr(4.2 * float(period)), start, [0] * n), model.sampling).trajectories[0]
    J, Phi = np.eye(n) - np.outer(K, np.eye(n)[0]), expm(model.A.floats * float(period))
    e = -np.array([float(v) for v in start])
    largest = np.abs(e).max()
    for t_k in run.t_k:
        after = np.flatnonzero(np.abs(run.t - t_k) <= 1e-12 * run.t[-1])[-1]
        e = J @ e
        largest = max(largest, np.abs(run.x[after]).max())
        assert np.abs(run.estimates["x_hat"][after] - run.x[after] - e).max() < 1e-10 * largest
        e = Phi @ e
    assert len(run.t_k) == 5


def test_memory_is_bounded_by_keeping_fewer_jumps(monkeypatch):
    monkeypatch.setattr("cdobs_cli.simulate.record.BUDGET", 2000)
    run = simulate(pendulum(period="0.01"), plan("20", [1, 0], [0, 0]), periodic("0.01"))
    trajectory = run.trajectories[0]
    assert run.overall.measurements == len(trajectory.t_k) == 2001
    assert len(trajectory.t) < 1000
    assert (np.diff(trajectory.t) >= 0).all()
    assert trajectory.t[0] == 0 and trajectory.t[-1] == 20


def test_numbers_beyond_floats_are_an_error_and_not_a_crash():
    with pytest.raises(SpecError, match="too large"):
        simulate(pendulum(), plan("1", ["1e399", 0], [0, 0]), periodic("0.6"))
    with pytest.raises(SpecError, match="too large"):
        simulate(pendulum(), plan("1e399", [1, 0], [0, 0]), periodic("0.6"))
    with pytest.raises(SpecError, match="no sampling period"):
        simulate(pendulum(), plan("1", [1, 0], [0, 0]), periodic("1e-399"))
    for runs in (1, 2):
        run = simulate(pendulum(), plan("1", ["1e308", 0], ["-1e308", 0], runs=runs), periodic("0.6"))
        assert run.overall.stopped is not None
        json.dumps(run.document(), allow_nan=False)


def test_an_undefined_jump_is_divergence_and_leaves_no_nan_behind():
    model = plant(("x",), [[0]], law=periodic("0.5"))
    names = ["hat.x", "y.0", "t"]
    jump = read("sqrt(0.7 - t)", names)
    observer = Observer(("hat.x",), (read("1", names),), (read("1", names),), (jump,), {"x_hat": (Variable("hat.x"),)})
    for runs in (1, 2):
        run = simulate(HybridSystem(model, observer), plan("2", [1], [0], runs=runs), model.sampling)
        assert run.summaries[0].diverged
        assert run.trajectories[0].t[-1] == 1
        assert np.isfinite(run.trajectories[0].estimates["x_hat"]).all()
        assert run.summaries[0].error_final == pytest.approx(abs(0.2**0.5 + 0.5 - 1), rel=1e-9)


def test_an_observer_whose_start_is_undefined_ends_at_once():
    model = plant(("x",), [[0]], law=periodic("0.5"))
    names = ["hat.x", "initial.x", "y.0"]
    observer = Observer(
        ("hat.x",),
        (read("sqrt(initial__x)", names),),
        (read("0", names),),
        (Variable("y.0"),),
        {"x_hat": (Variable("hat.x"),)},
    )
    for runs in (1, 2):
        run = simulate(HybridSystem(model, observer), plan("2", [1], [-1], runs=runs), model.sampling)
        assert "start is undefined" in run.summaries[0].stopped
        assert run.trajectories[0].t[-1] == 0


def test_a_state_on_its_bounds_is_inside():
    """x = x_lower = x_upper in exact arithmetic, written differently: what is left is rounding."""
    model = plant(("x",), [["-1"]], law=periodic("0.1"))
    names = ["low", "up", "y.0"]
    observer = Observer(
        ("low", "up"), (Variable("lower.x"), Variable("upper.x")),
        (read("-low/3 - 2*low/3", names), read("-0.1*up - 0.9*up", names)),
        (Variable("low"), Variable("up")), {"x_lower": (Variable("low"),), "x_upper": (Variable("up"),)},
    )  # fmt: skip
    run = simulate(HybridSystem(model, observer), plan("9", ["0.7"], initial_box=box(["0.7"], ["0.7"])), model.sampling)
    assert run.overall.inclusion_margin == 0.0
