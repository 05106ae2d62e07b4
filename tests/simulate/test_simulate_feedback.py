"""An input as a function of the estimate and of the last measurement, against closed forms, on every path."""

from __future__ import annotations

import json
from math import exp, log
from pathlib import Path

import numpy as np
import pytest
from loops import box, copy_observer, periodic, plan, plant, read

from cdobs_cli.batch import Settings, run
from cdobs_cli.design import Design
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.outcome import STAGES, Job
from cdobs_cli.plant import Input, Interval
from cdobs_cli.simulate.agreement import agrees
from cdobs_cli.simulate.archive import from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import system_of

NAMES = ["t", "hat.x", "y.0"]
TRIGGERS = {"law": {}, "trigger": {"trigger": Variable("elapsed") - Exact("0.25").expression}}


def unstable(K: str = "1", *, range_: Interval | None = None, **further):
    """x' = x + u."""
    return copy_observer(
        plant(("x",), [[1]], B=[[1]], inputs=(Input("u", range_),), law=periodic("0.25")), [K], **further
    )


def fed(u: str, horizon: str = "2", x0: str = "1", estimate: str = "1", **further):
    return plan(horizon, [x0], [estimate], signals={"u": read(u, NAMES)}, **further)


@pytest.mark.parametrize("sampled", TRIGGERS)
@pytest.mark.parametrize("runs", [1, 3])
def test_feedback_of_the_estimate_acts_between_samples(sampled, runs):
    made = simulate(unstable(**TRIGGERS[sampled]), fed("-2*hat__x", runs=runs), periodic("0.25"))
    for one in made.trajectories:
        assert one.x[:, 0] == pytest.approx(np.exp(-one.t), rel=1e-9)
        assert one.inputs["u"] == pytest.approx(-2 * np.exp(-one.t), rel=1e-9)


@pytest.mark.parametrize("sampled", TRIGGERS)
@pytest.mark.parametrize("runs", [1, 3])
def test_the_measurement_is_held(sampled, runs):
    made = simulate(unstable(**TRIGGERS[sampled]), fed("-2*y__0", runs=runs, estimate="0"), periodic("0.25"))
    factor = exp(0.25) - 2 * (exp(0.25) - 1)
    for one in made.trajectories:
        assert one.y_k[:, 0] == pytest.approx(factor ** np.arange(len(one.t_k)), rel=1e-9)
        last = np.searchsorted(one.t_k, one.t + 1e-9, side="right") - 1
        inside = np.abs(one.t - one.t_k[last]) > 1e-9
        assert one.inputs["u"][inside] == pytest.approx(-2 * one.y_k[last[inside], 0], rel=1e-12)


def test_a_wrong_estimate_is_what_is_fed_back():
    """The jump at t_0 sets x_hat = x; without it the input is that of the wrong estimate, and so is the state."""
    right = simulate(unstable(), fed("-2*hat__x", estimate="3"), periodic("0.25"))
    assert right.trajectories[0].x[-1, 0] == pytest.approx(exp(-2), rel=1e-9)
    wrong = simulate(unstable("0"), fed("-2*hat__x", "1", estimate="0.5"), periodic("0.25"))
    # x_hat' = -x_hat, e = x_hat - x = -0.5 e^t
    assert wrong.trajectories[0].x[-1, 0] == pytest.approx(0.5 * exp(-1) + 0.5 * exp(1), rel=1e-9)


def test_the_middle_of_bounds_stands_for_the_estimate():
    model = plant(("x",), [[1]], B=[[1]], inputs=(Input("u"),), law=periodic("0.25"))
    low, up, u = Variable("low"), Variable("up"), Variable("u")
    bounds = {"x_lower": (low,), "x_upper": (up,)}
    start, flow = (Variable("lower.x"), Variable("upper.x")), (low + u, up + u)
    system = HybridSystem(model, Observer(("low", "up"), start, flow, (low, up), bounds))
    asked = plan("1", [2], initial_box=box([1], [3]), signals={"u": read("-2*hat__x", NAMES)})
    made = simulate(system, asked, periodic("0.25"))
    assert made.trajectories[0].x[-1, 0] == pytest.approx(2 * exp(-1), rel=1e-9)


def test_an_input_that_leaves_its_range_ends_the_run_with_a_finding():
    ends = Interval(Exact(-1), Exact(1))
    system = unstable("0", range_=ends)
    made = simulate(system, fed("-hat__x/4", estimate="1", horizon="4"), periodic("0.25"))
    assert made.overall.stopped.startswith("the input u that the controller sets left its declared range")
    assert made.trajectories[0].t[-1] == pytest.approx(log(4) / 0.75, abs=0.25)
    kept = simulate(system, fed("max(-hat__x/4, -1)", estimate="1", horizon="4"), periodic("0.25"))
    assert kept.overall.stopped is None
    with pytest.raises(SpecError, match="leaves its declared interval"):
        simulate(system, fed("t", horizon="4"), periodic("0.25"))


def test_what_is_not_the_estimate_is_no_feedback():
    for name in ("x", "hat.z", "y.1", "u"):
        signals = {"u": Variable(name)}
        with pytest.raises(SpecError, match="a signal is an expression of t"):
            simulate(unstable(), plan("1", [1], [1], signals=signals), periodic("0.25"))


def test_the_archive_keeps_the_inputs_and_agrees():
    system = unstable()
    made = simulate(system, fed("-2*hat__x - y__0/8"), periodic("0.25"))
    again = from_bytes(to_bytes(made), made.document())
    assert np.array_equal(again.trajectories[0].inputs["u"], made.trajectories[0].inputs["u"])
    assert agrees(again, system)
    assert to_bytes(simulate(system, fed("-2*hat__x - y__0/8"), periodic("0.25"))) == to_bytes(made)


CART = """\
spec_version: 1
title: Inverted pendulum on a cart, balanced by the estimate
plant:
  states: [x, v, theta, omega]
  inputs: {F: {range: [-20, 20]}}
  parameters: {M: 0.5, m: 0.2, l: 0.3, g: 9.81, b: 0.1}
  dynamics:
    - v
    - (F - b*v + m*l*omega**2*sin(theta) - m*g*sin(theta)*cos(theta))/(M + m*sin(theta)**2)
    - omega
    - (g*(M + m)*sin(theta) - cos(theta)*(F - b*v + m*l*omega**2*sin(theta)))/(l*(M + m*sin(theta)**2))
  output: [x, theta]
  domain: {theta: [-0.5, 0.5], omega: [-3, 3], v: [-2, 2]}
measurement: {sampling: {period: 0.02}, noise: {lower: [-0.001, -0.001], upper: [0.001, 0.001]}}
observer:
  family: lpv_zoh
  gain: {L: [[21.05, -0.96], [107.94, -13.83], [-0.31, 20.75], [3.82, 151.99]]}
simulation:
  horizon: 5
  initial_box: {lower: [0, 0, 0.1, 0], upper: [0, 0, 0.12, 0]}
  initial_estimate: [0, 0, 0, 0]
  runs: RUNS
  signals: {F: "INPUT", v: ["uniform(-0.001, 0.001)", "uniform(-0.001, 0.001)"]}
"""
BALANCED = "sat(3.16*x + 5.32*v + 33.57*theta + 6.11*omega, -20, 20)"


@pytest.mark.parametrize("runs", [1, 3])
def test_an_inverted_pendulum_is_balanced_while_it_is_observed(tmp_path: Path, runs: int) -> None:
    def made(u: str):
        (tmp_path / "cart.yaml").write_text(CART.replace("INPUT", u).replace("RUNS", str(runs)))
        spec = load(tmp_path / "cart.yaml")
        gain = {name: matrix for name, matrix in spec.observer.given().items() if matrix is not None}
        system = system_of(spec, Design("lpv_zoh", "given", spec.plant.sampling, gain))
        assert spec.simulation is not None
        return simulate(system, spec.simulation, spec.plant.sampling)

    balanced = made(BALANCED)
    for one in balanced.trajectories:
        assert np.abs(one.x[-1]).max() < 0.05
        assert np.ptp(one.inputs["F"]) > 3
    assert balanced.overall.departure is None and balanced.overall.error_final < 0.1
    fallen = made("0")
    assert fallen.overall.departure is not None
    assert fallen.overall.departure.what.removeprefix("the estimate of ") in ("theta", "omega")
    crossed = made(BALANCED.replace("33.57*theta", "-33.57*theta"))
    assert crossed.overall.left_domain
    by_angle = made("sat(3.16*y1 + 5.32*v + 33.57*y2 + 6.11*omega, -20, 20)")
    assert by_angle.overall.departure is None
    assert np.abs(by_angle.trajectories[0].x[-1]).max() < 0.05


SCALAR = """\
spec_version: 1
plant:
  states: [x]
  inputs: {u: {range: [-9, 9]}}
  dynamics: ["x + u"]
  output: ["x"]
  COORDINATES
measurement: {sampling: {period: 0.25}}
observer: {family: reachability, gain: {K: [[GAIN]]}}
simulation: {horizon: 2, initial_state: [1], initial_estimate: [0], signals: {u: "-2*x - y/4"}}
"""


def test_the_signal_stands_for_the_estimate_in_the_states_as_typed(tmp_path: Path) -> None:
    """The same run in x, 2 x and 3 x; the report shows the signal as it was typed."""
    last = []
    for number, coordinates in enumerate(
        ("", 'coordinates: {map: ["2*x"], inverse: ["x1/2"]}', 'coordinates: {map: ["3*x"], inverse: ["x1/3"]}')
    ):
        (tmp_path / "s.yaml").write_text(SCALAR.replace("COORDINATES", coordinates).replace("GAIN", str(number + 1)))
        folder = tmp_path / str(number)
        made = run(Job(tmp_path / "s.yaml", folder), STAGES, Settings(out=tmp_path, effort=0))
        assert made.status in ("ok", "finding") and made.simulation is not None
        with np.load(folder / "simulation.npz") as stored:
            last.append(float(stored["x"][-1, 0]) / (1, 2, 3)[number])
            assert "input.u" in stored
        text = (folder / "report.md").read_text()
        assert "The inputs, y being the last measurement:" in text
        shown = text.split("last measurement:")[1].split("final error")[0]
        assert r"\hat{x}" in shown and "x_{1}" not in shown
    assert last[1:] == pytest.approx([last[0]] * 2, rel=1e-9)


def test_a_changed_feedback_is_simulated_anew_and_designs_stand(tmp_path: Path) -> None:
    spec, folder = tmp_path / "s.yaml", tmp_path / "out"
    text = SCALAR.replace("COORDINATES", "").replace("GAIN", "1")
    spec.write_text(text)
    stages = ("synthesize", "simulate")
    run(Job(spec, folder), stages, Settings(effort=0))
    before = [json.loads((folder / f"{name}.json").read_text()) for name in ("design", "simulation")]
    spec.write_text(text.replace("-2*x - y/4", "-2*x - y/5"))
    run(Job(spec, folder), stages, Settings(effort=0))
    after = [json.loads((folder / f"{name}.json").read_text()) for name in ("design", "simulation")]
    assert after[0] == before[0] and after[1] != before[1]
