"""Declared disturbance and noise drive a run unless they are typed: their statistics, and who sees what."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, plant
from scipy.linalg import expm

from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate import disturbance, signals
from cdobs_cli.simulate.engine import simulate

LAW = periodic("0.01")


def still(C=((1,),), **declared):
    """One state that stays at 0, measured by each row of C; no correction."""
    model = plant(("x",), [[0]], C=[list(row) for row in C], law=LAW, **declared)
    hat = copy_observer(plant(("x",), [[0]], law=LAW), ["0"]).observer
    return HybridSystem(model, hat)


def noise_of(system, horizon="20", **more):
    return simulate(system, plan(horizon, [0], [0], **more), LAW).trajectories[0].y_k


def test_noise_of_a_box_is_uniform_and_white():
    v = noise_of(still(((1,), (1,)), noise=box([-1, 2], [1, 4])), seed=3)
    assert len(v) == 2001
    assert np.all(v >= [-1, 2]) and np.all(v <= [1, 4]) and np.ptp(v, axis=0) == pytest.approx([2, 2], rel=0.01)
    assert v.mean(axis=0) == pytest.approx([0, 3], abs=4 * (1 / 3 / 2001) ** 0.5)
    assert np.cov(v.T) == pytest.approx(np.eye(2) / 3, abs=0.03)
    assert abs(np.corrcoef(v[:-1, 0], v[1:, 0])[0, 1]) < 0.09


@pytest.mark.parametrize(
    "R",
    [
        [["4", "-1.2"], ["-1.2", "0.5"]],
        [["4", "2"], ["2", "1"]],  # singular: v2 = v1 / 2
        [["0", "0"], ["0", "1e-12"]],
        [["1e12", "0.5"], ["0.5", "1e-12"]],
    ],
)
def test_noise_of_a_covariance_is_normal_with_it(R):
    R = ExactMatrix(R)
    v = noise_of(still(((1,), (1,)), covariance=R), seed=5)
    scale = np.sqrt(np.maximum(np.diag(R.floats), 1e-300))
    assert v.mean(axis=0) / scale == pytest.approx([0, 0], abs=4 / 2001**0.5)
    assert np.cov(v.T) / np.outer(scale, scale) == pytest.approx(R.floats / np.outer(scale, scale), abs=0.12)
    if R[0, 1] == Exact(2):
        assert v[:, 1] == pytest.approx(v[:, 0] / 2, abs=1e-12)
    if R[0, 0] == Exact(0):
        assert not v[:, 0].any()
    z = v[:, 1] / scale[1]
    assert np.mean(np.abs(z) < 1) == pytest.approx(0.6827, abs=0.04) and np.abs(z).max() > 3


def test_a_typed_signal_comes_first_and_zero_is_one():
    system = still(noise=box([-1], [1]))
    assert not noise_of(system, signals={"v.0": "0"}).any()
    assert noise_of(system, signals={"v.0": "0.5"})[7] == 0.5
    two = still(((1,), (1,)), covariance=ExactMatrix([[1, 0], [0, 1]]))
    assert not noise_of(two, signals={"v.1": "0"}).any(), "of what is typed in part the rest is 0"


def test_no_noise_no_draws():
    assert not noise_of(still()).any()
    assert not noise_of(still(covariance=ExactMatrix([[0]]))).any()
    assert not noise_of(still(noise=box([0], [0]))).any()


def disturbed(law=LAW, A=((0,),), **declared):
    model = plant(("x",), [list(row) for row in A], law=law, **declared)
    return copy_observer(model, ["0"])


@pytest.mark.parametrize("runs", [1, 3])
def test_a_bounded_disturbance_is_held_from_sample_to_sample(runs):
    law = periodic("0.1")
    run = simulate(disturbed(law, disturbance=box([-1], [3])), plan("30", [0], [0], runs=runs, seed=2), law)
    one = run.trajectories[0]
    x_k = np.interp(one.t_k, one.t, one.x[:, 0])
    d = np.diff(x_k) / 0.1
    assert len(d) == 300 and np.all(d >= -1 - 1e-9) and np.all(d <= 3 + 1e-9)
    assert d.mean() == pytest.approx(1, abs=4 * (4 / 3 / 300) ** 0.5) and d.std() == pytest.approx(2 / 3**0.5, rel=0.1)
    inside = np.interp(one.t_k[:-1] + 0.05, one.t, one.inputs["d.0"])
    assert inside == pytest.approx(d, abs=1e-9)
    assert not np.any(one.estimates["x_hat"])


def test_a_disturbance_away_from_zero_is_in_its_box_from_the_start():
    run = simulate(disturbed(disturbance=box(["0.5"], ["0.6"])), plan("1", [0], [0]), LAW)
    assert run.trajectories[0].inputs["d.0"].min() >= 0.5


MIXED = ((0, 1), ("-4", "-0.6"))
Q = ExactMatrix([["0.3", "0.1"], ["0.1", "0.5"]])


def sampled_covariance(monkeypatch, parts, period="1", Q=Q):
    """Of the state at the end of a period, from 0: every draw set to 1 in a run of its own, all others to 0."""
    monkeypatch.setattr(disturbance, "PARTS", parts)
    channels = len(Q.rows)

    def one_each(self, purpose, kind, channel, runs, index):
        assert (purpose, kind) == ("disturbance", "normal")
        return (np.asarray(runs) == channels * np.asarray(index) + channel).astype(float)

    monkeypatch.setattr(signals.Draws, "at", one_each)
    model = plant(("x", "y"), [list(row) for row in MIXED], law=periodic(period), intensity=Q)
    asked = plan(period, [0, 0], [0, 0], runs=channels * parts)
    run = simulate(copy_observer(model, ["0", "0"]), asked, periodic(period))
    X = np.array([one.x[-1] for one in run.trajectories]).T
    return X @ X.T


def van_loan(A, Q, T):
    """int_0^T exp(A s) Q exp(A' s) ds."""
    n = len(A)
    M = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * T)
    return M[n:, n:].T @ M[:n, n:]


def test_a_white_disturbance_gives_the_sampled_state_its_exact_covariance_to_second_order(monkeypatch):
    exact = van_loan(np.array(MIXED, dtype=float), Q.floats, 1.0)
    errors = [np.abs(sampled_covariance(monkeypatch, parts) - exact).max() / exact.max() for parts in (4, 8, 16)]
    assert errors[2] < 2e-3
    for coarse, fine in pairwise(errors):
        assert coarse / fine == pytest.approx(4, rel=0.1)


def test_a_singular_intensity_moves_what_it_moves(monkeypatch):
    only = ExactMatrix([[0, 0], [0, "0.7"]])
    exact = van_loan(np.array(MIXED, dtype=float), only.floats, 0.5)
    found = sampled_covariance(monkeypatch, 16, "0.5", only)
    assert found == pytest.approx(exact, rel=1e-2, abs=1e-3 * exact.max())


@pytest.mark.parametrize("law", [periodic("0.2"), SamplingLaw("aperiodic", Exact("0.05"), Exact("0.3"))])
def test_a_white_disturbance_walks(law):
    """x' = d: E x(t)^2 = q t whatever the samples, increments apart are independent."""
    run = simulate(disturbed(law, intensity=ExactMatrix([["0.09"]])), plan("4", [0], [0], runs=600, seed=1), law)
    at = np.array([[np.interp(t, one.t, one.x[:, 0]) for t in (1, 2, 4)] for one in run.trajectories])
    assert (at**2).mean(axis=0) == pytest.approx([0.09, 0.18, 0.36], rel=0.15)
    assert at.mean(axis=0) == pytest.approx([0, 0, 0], abs=4 * 0.6 / 600**0.5)
    assert abs(np.corrcoef(at[:, 0], at[:, 1] - at[:, 0])[0, 1]) < 0.15


def test_a_nonlinear_plant_is_driven_too():
    system = pendulum(intensity=ExactMatrix([[0, 0], [0, "1e-4"]]))
    run = simulate(system, plan("6", [1, 0], [1, 0]), system.plant.sampling)
    quiet = simulate(pendulum(), plan("6", [1, 0], [1, 0]), system.plant.sampling)
    assert 1e-4 < run.overall.rmse["omega"] < 0.1 and quiet.overall.rmse["omega"] < 1e-9


def chosen():
    """Samples when the observer's own clock has run for 0.25."""
    from cdobs_cli.exact.expression import ONE, Number, Variable

    model = plant(("x",), [[0]], law=SamplingLaw("updated"), intensity=ExactMatrix([[1]]))
    hat, clock = Variable("hat.x"), Variable("clock")
    observer = Observer(
        ("hat.x", "clock"), (Variable("initial.x"), Number(0)), (Number(0), ONE), (hat, Number(0)), {"x_hat": (hat,)},
        trigger=clock - Number(1) / Number(4),
    )  # fmt: skip
    return HybridSystem(model, observer)


def test_an_observer_that_chooses_its_samples_is_driven_at_a_fine_step():
    run = simulate(chosen(), plan("2", [0], [0], runs=300), SamplingLaw("updated"))
    assert run.trajectories[0].t_k == pytest.approx(np.arange(0, 2.01, 0.25), abs=1e-6)
    ends = np.array([one.x[-1, 0] for one in run.trajectories])
    assert ends.var() == pytest.approx(2, rel=0.25)


DECLARED = [
    {"noise": box([-1], [1]), "disturbance": box([-1, -1], [1, 1])},
    {"covariance": ExactMatrix([["0.01"]]), "intensity": ExactMatrix([["0.1", "0"], ["0", "0.2"]])},
]


@pytest.mark.parametrize("declared", DECLARED)
@pytest.mark.parametrize("law", [periodic("0.6"), SamplingLaw("aperiodic", Exact("0.1"), Exact("0.6"))])
def test_what_a_run_sees_does_not_depend_on_the_others(declared, law):
    system = pendulum(**declared)
    start = {"initial_box": box([-1, -1], [1, 1]), "seed": 4}
    few, many = (simulate(system, plan("6", None, [0, 0], runs=runs, **start), law) for runs in (2, 7))
    for r in (0, 1):
        for name in ("d.0", "d.1"):
            assert np.array_equal(few.trajectories[r].inputs[name], many.trajectories[r].inputs[name])
        # States may differ in rounding, which products of matrices do by their width.
        assert np.abs(few.trajectories[r].y_k - many.trajectories[r].y_k).max() < 1e-9
    alone = simulate(system, plan("6", None, [0, 0], **start), law).trajectories[0]
    assert np.abs(alone.y_k - many.trajectories[0].y_k).max() < 1e-9
    assert alone.inputs["d.1"] == pytest.approx(many.trajectories[0].inputs["d.1"], abs=1e-12)
    assert np.ptp(alone.inputs["d.1"]) > 0.1
    again = simulate(system, plan("6", None, [0, 0], **start), law).trajectories[0]
    assert np.array_equal(alone.x, again.x) and np.array_equal(alone.y_k, again.y_k)
    other = simulate(system, plan("6", None, [0, 0], **{**start, "seed": 5}), law).trajectories[0]
    assert not np.array_equal(other.inputs["d.1"][:10], alone.inputs["d.1"][:10])


@pytest.mark.parametrize("declared", DECLARED)
def test_a_batch_equals_its_single_runs_under_noise(declared):
    system, law = pendulum(**declared), periodic("0.6")
    many = simulate(system, plan("3", [1, 0], [0, 0], runs=3), law)
    alone = simulate(system, plan("3", [1, 0], [0, 0]), law).trajectories[0]
    assert np.abs(many.trajectories[0].t - alone.t).max() < 1e-13
    assert np.abs(many.trajectories[0].x - alone.x).max() < 1e-9


def test_noise_and_disturbance_are_streams_of_their_own():
    """The noise is the same with and without a disturbance."""
    noisy = {"noise": box([-1], [1])}
    calm, rough = (
        simulate(disturbed(**noisy, **more), plan("1", [0], [0]), LAW).trajectories[0]
        for more in ({}, {"disturbance": box([-1], [1])})
    )
    x_k = np.interp(rough.t_k, rough.t, rough.x[:, 0])
    assert rough.y_k[:, 0] - x_k == pytest.approx(calm.y_k[:, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("declared", "size"),
    [
        ({"noise": box(["-1e6"], ["1e6"])}, 1e6), ({"noise": box(["-1e-6"], ["1e-6"])}, 1e-6),
        ({"covariance": ExactMatrix([["1e12"]])}, 1e6), ({"covariance": ExactMatrix([["1e-12"]])}, 1e-6),
    ],
)  # fmt: skip
def test_sizes_far_from_one(declared, size):
    v = noise_of(still(**declared), "2")
    assert 0.3 * size < v.std() < 2 * size


def test_a_huge_white_disturbance_ends_the_run_with_a_sentence():
    run = simulate(disturbed(intensity=ExactMatrix([["1e30"]])), plan("1", [0], [0]), LAW)
    assert run.overall.diverged and "1e6" in str(run.overall.stopped)
    with pytest.raises(SpecError, match="too large"):
        simulate(disturbed(intensity=ExactMatrix([[Exact(10) * Exact(10**308)]])), plan("1", [0], [0]), LAW)


def test_figures_of_the_second_half_leave_the_transient_out():
    system = pendulum(noise=box(["-0.001"], ["0.001"]))
    overall = simulate(system, plan("20", [1, 0], [0, 0]), system.plant.sampling).overall
    assert overall.rmse["theta"] > 0.05 > 0.01 > overall.rmse_after_transient["theta"] > 1e-5
    quiet = replace(system, plant=replace(system.plant, noise=None))
    assert (
        simulate(quiet, plan("20", [1, 0], [0, 0]), system.plant.sampling).overall.rmse_after_transient["theta"] < 1e-6
    )
