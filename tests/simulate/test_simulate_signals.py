"""Inputs, disturbances and noise: declared intervals, seeds."""

import numpy as np
import pytest
from loops import box, copy_observer, periodic, plan, plant, read

from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Call, Number
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Input, Interval
from cdobs_cli.simulate.engine import simulate

UNIFORM = Call("uniform", (Number(-1), Number(1)))
NORMAL = Call("normal", (Number(1),))


def noisy(noise=(-1, 1)):
    return copy_observer(plant(("x",), [[0]], law=periodic("0.01"), noise=box([noise[0]], [noise[1]])), ["0.5"])


def noise_of(run, r=0):
    return run.trajectories[r].y_k[:, 0] - 1.0


def test_uniform_noise_fills_its_interval_and_repeats_with_the_seed():
    first = simulate(noisy(), plan("10", [1], [1], signals={"v.0": UNIFORM}, seed=4), periodic("0.01"))
    again = simulate(noisy(), plan("10", [1], [1], signals={"v.0": UNIFORM}, seed=4), periodic("0.01"))
    other = simulate(noisy(), plan("10", [1], [1], signals={"v.0": UNIFORM}, seed=5), periodic("0.01"))
    v = noise_of(first)
    assert np.array_equal(v, noise_of(again))
    assert not np.array_equal(v, noise_of(other))
    assert len(v) == 1001
    assert v.min() < -0.98 and v.max() > 0.98 and abs(v.mean()) < 0.06 and v.std() == pytest.approx(3**-0.5, rel=0.05)
    assert abs(np.corrcoef(v[:-1], v[1:])[0, 1]) < 0.1


def test_what_a_run_sees_does_not_depend_on_the_number_of_runs():
    few = simulate(noisy(), plan("1", [1], [1], signals={"v.0": UNIFORM}, runs=2, seed=4), periodic("0.01"))
    many = simulate(noisy(), plan("1", [1], [1], signals={"v.0": UNIFORM}, runs=9, seed=4), periodic("0.01"))
    alone = simulate(noisy(), plan("1", [1], [1], signals={"v.0": UNIFORM}, seed=4), periodic("0.01"))
    for r in (0, 1):
        assert np.array_equal(few.trajectories[r].y_k, many.trajectories[r].y_k)
    assert np.array_equal(alone.trajectories[0].y_k, many.trajectories[0].y_k)
    assert not np.array_equal(noise_of(many, 0), noise_of(many, 1))


def test_normal_noise_has_its_deviation_and_must_stay_inside_too():
    run = simulate(noisy((-9, 9)), plan("10", [1], [1], signals={"v.0": NORMAL}), periodic("0.01"))
    assert noise_of(run).std() == pytest.approx(1, rel=0.08)
    with pytest.raises(SpecError, match=r"simulation\.signals\.v\[0\].*leaves its declared interval.*at t = "):
        simulate(noisy(), plan("10", [1], [1], signals={"v.0": NORMAL}), periodic("0.01"))


def test_every_occurrence_of_a_random_function_is_a_draw_of_its_own():
    difference = UNIFORM - UNIFORM
    run = simulate(noisy((-2, 2)), plan("10", [1], [1], signals={"v.0": difference}), periodic("0.01"))
    assert noise_of(run).std() == pytest.approx((2 / 3) ** 0.5, rel=0.08)
    squared = UNIFORM * Number(0) + Call("uniform", (Number(0), read("0.5 + 0.5*sin(t)**2", ["t"])))
    v = noise_of(simulate(noisy(), plan("10", [1], [1], signals={"v.0": squared}), periodic("0.01")))
    assert (v >= 0).all() and (v <= 0.5 + 0.5 * np.sin(0.01 * np.arange(1001)) ** 2 + 1e-12).all()


def disturbed(law="0.5"):
    return copy_observer(plant(("x",), [[0]], law=periodic(law), disturbance=box([-1], [1])), ["1"])


def test_a_disturbance_drives_the_plant_only():
    run = simulate(disturbed("10"), plan("3", [0], [0], signals={"d.0": "sin(t)"}), periodic("10"))
    trajectory = run.trajectories[0]
    assert trajectory.x[:, 0] == pytest.approx(1 - np.cos(trajectory.t), abs=1e-10)
    assert np.abs(trajectory.estimates["x_hat"]).max() == 0
    assert trajectory.inputs["d.0"] == pytest.approx(np.sin(trajectory.t), abs=1e-14)


@pytest.mark.parametrize("runs", [1, 2])
def test_a_signal_that_leaves_its_interval_is_an_error_with_time_and_value(runs):
    with pytest.raises(SpecError) as caught:
        simulate(disturbed(), plan("20", [0], [0], signals={"d.0": "0.2*t"}, runs=runs), periodic("0.5"))
    (problem,) = caught.value.problems
    assert problem.path == "simulation.signals.d[0]"
    assert "at t = 5" in problem.got
    assert problem.allowed == "[-1, 1]"
    simulate(disturbed(), plan("20", [0], [0], signals={"d.0": "0.05*t"}, runs=runs), periodic("0.5"))


def test_inputs_stay_in_their_range_and_default_to_zero():
    def driven(low, high):
        source = Input("u", Interval(Exact(low), Exact(high)))
        return copy_observer(plant(("x",), [[0]], law=periodic("0.5"), inputs=(source,), B=[[1]]), ["1"])

    run = simulate(driven(0, 1), plan("2", [0], [0], signals={"u": "0.5 + 0.5*cos(t)"}), periodic("0.5"))
    trajectory = run.trajectories[0]
    assert trajectory.x[:, 0] == pytest.approx(0.5 * trajectory.t + 0.5 * np.sin(trajectory.t), abs=1e-10)
    assert np.abs(simulate(driven(0, 1), plan("2", [1], [1]), periodic("0.5")).trajectories[0].x - 1).max() == 0
    with pytest.raises(SpecError, match=r"simulation\.signals\.u.*got 0 at t = 0"):
        simulate(driven("0.1", 1), plan("2", [0], [0]), periodic("0.5"))
    with pytest.raises(SpecError, match=r"simulation\.signals\.u.*got inf"):
        simulate(driven(0, 1), plan("2", [0], [0], signals={"u": "1/t"}), periodic("0.5"))


def test_signals_that_nothing_reads_and_random_disturbances_are_refused():
    with pytest.raises(SpecError) as caught:
        simulate(disturbed(), plan("1", [0], [0], signals={"v.0": "0", "w": "0", "d.0": UNIFORM}), periodic("0.5"))
    paths = {problem.path for problem in caught.value.problems}
    assert paths == {"simulation.signals.v[0]", "simulation.signals.w", "simulation.signals.d[0]"}
    assert "measurement.noise" in str(caught.value)


def test_a_controlled_input_takes_no_other_signal_than_zero():
    model = plant(("x",), [[0]], law=periodic("0.5"), inputs=(Input("u"),), B=[[1]])
    system = copy_observer(model, ["1"], control={"u": read("-hat__x", ["hat.x"])})
    run = simulate(system, plan("1", [1], [0], signals={"u": "0"}), periodic("0.5"))
    assert run.trajectories[0].x[-1] == pytest.approx(0.25)
    with pytest.raises(SpecError, match="set by the observer's controller"):
        simulate(system, plan("1", [1], [0], signals={"u": "1"}), periodic("0.5"))
