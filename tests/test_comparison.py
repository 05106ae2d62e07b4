"""The observer beside the Kalman filter: on the same measurements, in simulation.json, within a counted budget."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest
from command import made
from scipy.linalg import expm, solve_discrete_are

from cdobs_cli import comparison
from cdobs_cli.comparison import beside, compared, filter_of
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Box, Plant, Slopes, weighted
from cdobs_cli.run import Compared, Run, SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.agreement import agrees
from cdobs_cli.simulate.archive import from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate

SPEC = """\
spec_version: 1
plant:
  states: {{theta: rad, omega: rad/s}}
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
  {disturbance}
measurement: {{C: [[1, 0]], sampling: {{period: 0.6}}{noise}}}
observer: {{family: reachability, gain: {{K: [[0.9], [1.3]]}}}}
simulation: {{horizon: 30, initial_state: [1, 0], initial_estimate: [0, 0]{more}}}
"""
BOXES = {
    "disturbance": "disturbance: {lower: [0, -0.05], upper: [0, 0.05]}",
    "noise": ", noise: {lower: [-0.01], upper: [0.01]}",
}
WHITE = {"disturbance": "disturbance: {intensity: [[0, 0], [0, 2.5e-4]]}", "noise": ", noise: {std: [0.01]}"}
LAW = SamplingLaw.periodic(Exact("0.2"))


def simulated(folder: Path, **parts: str) -> dict[str, Any]:
    filled = {"disturbance": "", "noise": "", "more": ""} | parts
    document = made(folder, SPEC.format(**filled), ("synthesize", "simulate")).simulation
    assert document is not None
    return document


@pytest.mark.parametrize("parts", [BOXES, WHITE])
def test_it_stands_in_the_document_and_repeats_to_the_byte(tmp_path: Path, parts: dict[str, str]) -> None:
    first = simulated(tmp_path, **parts)
    found = first["comparison"]
    assert found["reason"] is None and 2 <= found["seeds"] <= 8 and list(found["states"]) == ["theta", "omega"]
    for figures in found["states"].values():
        assert 0 < figures["rmse_ekf"] < figures["rmse"] < 3 * figures["rmse_ekf"]
    written = {name: (tmp_path / "out" / name).read_bytes() for name in ("simulation.json", "simulation.npz")}
    other = tmp_path / "other"
    other.mkdir()
    simulated(other, **parts)
    again = {name: (other / "out" / name).read_bytes() for name in written}
    assert written == again
    arrays = np.load(tmp_path / "out" / "simulation.npz")
    assert arrays["filter.error"].shape == (len(arrays["filter.t"]), 2)


def test_there_is_none_where_nothing_is_declared_or_there_is_no_point_estimate(tmp_path: Path) -> None:
    assert "comparison" not in simulated(tmp_path)
    interval = """\
spec_version: 1
plant: {states: [x], A: [[-1]], phi: ["0"], lipschitz: [[0]]}
measurement: {C: [[1]], sampling: {period: 0.1}, noise: {lower: [-0.1], upper: [0.1]}}
observer: {family: interval, gain: {S: [[1]], L: [[1]]}}
simulation: {horizon: 1, initial_box: {lower: [0], upper: [1]}}
"""
    document = made(tmp_path, interval, ("synthesize", "simulate")).simulation
    assert document is not None and "comparison" not in document and not (document["overall"]["inclusion_margin"] < 0)


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"disturbance": BOXES["disturbance"]}, "no noise is declared of y, so that R is singular"),
        ({"noise": ", noise: {lower: [0], upper: [0]}"}, "no noise is declared of y, so that R is singular"),
        ({"noise": ", noise: {std: [0]}"}, "no noise is declared of y, so that R is singular"),
    ],
)
def test_without_noise_on_an_output_it_says_so(tmp_path: Path, parts: dict[str, str], told: str) -> None:
    document = simulated(tmp_path, **parts)
    found = document["comparison"]
    assert told in found["reason"] and found["seeds"] == 1
    late = document["overall"]["rmse_after_transient"]
    assert found["states"] == {name: {"rmse": late[name], "rmse_ekf": None} for name in ("theta", "omega")}


def test_expectations_can_name_it(tmp_path: Path) -> None:
    text = SPEC.format(**BOXES, more="") + (
        "expect:\n  - {quantity: simulation.comparison.states.theta.rmse_ekf, at_most: 0.02}\n"
        "  - {quantity: simulation.overall.rmse_after_transient.omega, at_most: 0.0001}\n"
    )
    told = [one.text for one in made(tmp_path, text, ("synthesize", "simulate")).messages if one.severity == "error"]
    assert len(told) == 1 and "rmse_after_transient.omega" in told[0]


# ---------------------------------------------------------------- in code


def plant(A: Any, C: Any, law: SamplingLaw = LAW, **declared: Any) -> Plant:
    n = len(A)
    names, zero = tuple(f"x{i + 1}" for i in range(n)), ExactMatrix([[0] * n] * n)
    phi = declared.pop("phi", ["0"] * n)
    trees = tuple(parse(one, frozenset(names)) for one in phi)
    return Plant(names, (), ExactMatrix(A), trees, None, ExactMatrix(C), Slopes(zero, zero), law, **declared)


def loop(model: Plant, K: Any) -> HybridSystem:
    """The copy of a plant with the gain K, shape (n, p)."""
    gain, hat = ExactMatrix(K), [Variable(f"hat.{name}") for name in model.states]
    left = [Variable(f"y.{k}") - row for k, row in enumerate(model.outputs("hat."))]
    jump = tuple(sum(weighted(gain, i, left), one) for i, one in enumerate(hat))
    start = tuple(Variable(f"initial.{name}") for name in model.states)
    observer = Observer(
        tuple(f"hat.{name}" for name in model.states), start, model.right_hand_side("hat."), jump, {"x_hat": tuple(hat)}
    )
    return HybridSystem(model, observer)


def plan(horizon: str, n: int = 2, **further: Any) -> SimulationPlan:
    return SimulationPlan(Exact(horizon), (Exact(1),) * n, initial_estimate=(Exact(0),) * n, **further)


def run_of(system: HybridSystem, asked: SimulationPlan) -> Run:
    law = system.plant.sampling
    return compared(simulate(system, asked, law), system, asked, law)


OSCILLATOR = [[0, 1], ["-1", "-0.4"]]
R1 = ExactMatrix([["0.01"]])
Q = ExactMatrix([["0.02", "0.01"], ["0.01", "0.05"]])


def average_of_riccati(A: np.ndarray, C: np.ndarray, Q: np.ndarray, R: np.ndarray, T: float) -> np.ndarray:
    """The mean over a period of the filter's steady variances."""

    def moved(P: np.ndarray, s: float) -> np.ndarray:
        n = len(A)
        M = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * s)
        F = M[n:, n:].T
        return F @ P @ F.T + F @ M[:n, n:]

    before = solve_discrete_are(expm(A * T).T, C.T, moved(np.zeros_like(Q), T), R)
    G = before @ C.T @ np.linalg.inv(C @ before @ C.T + R)
    after = (np.eye(len(A)) - G @ C) @ before
    return np.mean([np.diag(moved(after, s)) for s in np.linspace(0, T, 201)], axis=0)


def test_on_a_linear_plant_the_filter_errs_as_riccati_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "BUDGET", 10**8)
    system = loop(plant(OSCILLATOR, [[1, 0]], intensity=Q, covariance=R1), [["0.5"], ["0.3"]])
    found = run_of(system, plan("80")).comparison
    assert found is not None and found.seeds == comparison.SEEDS
    A = np.array(OSCILLATOR, dtype=float)
    expected = np.sqrt(average_of_riccati(A, np.array([[1.0, 0.0]]), Q.floats, R1.floats, 0.2))
    assert [found.states[name].rmse_ekf for name in ("x1", "x2")] == pytest.approx(expected, rel=0.05)


def test_a_bounded_disturbance_away_from_zero_is_known_in_the_mean() -> None:
    """d within 0.5 of 2 and v within 0.1 of 1: the filter knows the middles, the observer does not."""
    boxes = {"disturbance": Box((Exact("1.5"),), (Exact("2.5"),)), "noise": Box((Exact("0.9"),), (Exact("1.1"),))}
    system = loop(plant([["-1"]], [[1]], **boxes), [["0.5"]])
    found = run_of(system, plan("60", 1)).comparison
    assert found is not None
    figures = found.states["x1"]
    # Uniform and held: the filter for Q = 0.5^2/3 T, R = 0.1^2/3.
    q, r = np.array([[0.25 / 3 * 0.2]]), np.array([[0.01 / 3]])
    expected = float(np.sqrt(average_of_riccati(np.array([[-1.0]]), np.array([[1.0]]), q, r, 0.2))[0])
    assert figures.rmse_ekf == pytest.approx(expected, rel=0.15) and figures.rmse > 0.3


def test_both_see_the_same_plant_and_measurements() -> None:
    law = SamplingLaw("aperiodic", Exact("0.05"), Exact("0.3"))
    R = ExactMatrix([["0.01", "0.005"], ["0.005", "0.04"]])
    system = loop(plant(OSCILLATOR, [[1, 0], [1, 1]], law, intensity=Q, covariance=R), [["0.4", 0], [0, "0.2"]])
    asked = plan("6", seed=9)
    alone = simulate(system, asked, law)
    both = simulate(beside(system, filter_of(system.plant, alone, asked)), asked, law)
    one, other = alone.trajectories[0], both.trajectories[0]
    assert np.array_equal(one.t_k, other.t_k)
    assert np.abs(one.y_k - other.y_k).max() < 1e-8 and np.abs(one.x[-1] - other.x[-1]).max() < 1e-8
    assert np.abs(one.estimates["x_hat"][-1] - other.estimates["x_hat"][-1]).max() < 1e-8
    numbered = [simulate(system, replace(asked, runs=1), law, first=r).trajectories[0] for r in (0, 2)]
    many = simulate(system, replace(asked, runs=3), law)
    for r, single in zip((0, 2), numbered, strict=True):
        assert np.abs(single.y_k - many.trajectories[r].y_k).max() < 1e-8


def test_runs_from_a_box_are_the_runs_of_the_comparison() -> None:
    system = loop(plant(OSCILLATOR, [[1, 0]], covariance=R1), [["0.5"], ["0.3"]])
    box = Box((Exact(-1), Exact(-1)), (Exact(1), Exact(1)))
    asked = SimulationPlan(Exact(10), initial_box=box, runs=3)
    made_of = run_of(system, asked)
    assert made_of.comparison is not None and made_of.filtered is not None
    start = made_of.filtered.error[0]
    assert start == pytest.approx(made_of.trajectories[0].estimates["x_hat"][0] - made_of.trajectories[0].x[0])


def test_the_number_of_runs_is_counted_and_not_timed() -> None:
    system = loop(plant(OSCILLATOR, [[1, 0]], covariance=R1), [["0.5"], ["0.3"]])
    seeds = [run_of(system, plan(horizon)).comparison for horizon in ("5", "100", "300")]
    assert [one.seeds for one in seeds if one is not None] == [8, 6, 2]
    long = run_of(system, plan("2500")).comparison
    assert long is not None and "too many samples or steps" in str(long.reason)
    assert long.states["x1"].rmse_ekf is None and long.states["x1"].rmse > 0


@pytest.mark.parametrize("intensity", [None, Q])
def test_it_is_cheap(intensity: ExactMatrix | None) -> None:
    """The budget holds, with room for a slow machine: 1.2 seconds are meant."""
    system = loop(plant(OSCILLATOR, [[1, 0]], intensity=intensity, covariance=R1), [["0.5"], ["0.3"]])
    asked = plan("100" if intensity is None else "20")
    alone = simulate(system, asked, LAW)
    start = process_time()
    compared(alone, system, asked, LAW)
    assert process_time() - start < 6


def test_a_run_that_ends_early_or_a_plant_that_is_large_is_compared_with_nothing() -> None:
    diverging = loop(plant([["40"]], [[1]], covariance=R1), [["0"]])
    found = run_of(diverging, plan("10", 1)).comparison
    assert found is not None and found.reason == "The filter is not run beside a run that ends early."
    chain = [[int(j == i + 1) for j in range(9)] for i in range(9)]
    large = loop(plant(chain, [[1] + [0] * 8], covariance=R1), [["0.1"]] * 9)
    found = run_of(large, plan("0.4", 9)).comparison
    assert found is not None and "up to 8 states" in str(found.reason)


def test_a_filter_that_does_not_come_to_the_end_is_told_and_spoils_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    system = loop(plant(OSCILLATOR, [[1, 0]], covariance=R1), [["0.5"], ["0.3"]])
    one: Expression = Variable("ekf.a")
    wild = Observer(("ekf.a",), (parse("1", frozenset()),), (one * one * one,), (one,), {"x_hat": (one, one)})
    monkeypatch.setattr(comparison, "filter_of", lambda *_: wild)
    run = run_of(system, plan("5"))
    assert run.overall.stopped is None and run.filtered is None and run.comparison is not None
    assert "With the filter beside it run 1 does not come to its end" in str(run.comparison.reason)


def test_noise_that_leaves_its_box_in_a_later_run_is_told_and_no_mistake_of_the_spec() -> None:
    """normal(0.3) stays within 1 in run 0 of this seed, and not in all of the eight."""
    model = plant(OSCILLATOR, [[1, 0]], noise=Box((Exact(-1),), (Exact(1),)))
    typed = {"v.0": parse("normal(0.3)", frozenset(), {}, {"normal": (1,)})}
    for seed in range(20):
        asked = plan("10", signals=typed, seed=seed)
        try:
            run = run_of(loop(model, [["0.5"], ["0.3"]]), asked)
        except SpecError:
            continue
        assert run.comparison is not None
        if run.comparison.reason is not None:
            assert "cannot be had: the signal leaves its declared interval" in run.comparison.reason
            return
    pytest.fail("no seed whose first run stays")


@pytest.mark.parametrize("size", ["1e-6", "1e6"])
@pytest.mark.parametrize("kind", ["box", "moments"])
def test_sizes_far_from_one(size: str, kind: str) -> None:
    """Scaling noise, disturbance and start scales the errors: nothing depends on units."""

    def figures(s: Exact) -> list[float]:
        square = s * s
        if kind == "box":
            declared: dict[str, Any] = {"noise": Box((-s,), (s,)), "disturbance": Box((-s, -s), (s, s))}
        else:
            scaled = ExactMatrix([[entry * square for entry in row] for row in Q.rows])
            declared = {"covariance": ExactMatrix([[square]]), "intensity": scaled}
        asked = SimulationPlan(Exact(10), (s, s), initial_estimate=(Exact(0), Exact(0)))
        found = run_of(loop(plant(OSCILLATOR, [[1, 0]], **declared), [["0.5"], ["0.3"]]), asked).comparison
        assert found is not None and found.reason is None
        return [one.rmse_ekf / float(s) for one in found.states.values() if one.rmse_ekf is not None]

    assert figures(Exact(size)) == pytest.approx(figures(Exact(1)), rel=1e-5)


def test_a_comparison_that_says_better_than_its_run_is_refused() -> None:
    system = loop(plant(OSCILLATOR, [[1, 0]], covariance=R1, intensity=Q), [["0.5"], ["0.3"]])
    run = run_of(system, plan("6"))
    assert run.comparison is not None
    again = from_bytes(to_bytes(run), run.document())
    assert agrees(run, system) and agrees(again, system) and again.comparison == run.comparison
    assert np.array_equal(again.filtered.error, run.filtered.error)  # type: ignore[union-attr]
    states = run.comparison.states
    for better in (Compared(1e-9, states["x1"].rmse_ekf), Compared(states["x1"].rmse, 1e-9)):
        told = replace(run.comparison, states={**states, "x1": better})
        assert not agrees(replace(run, comparison=told), system)
    assert not agrees(replace(run, comparison=None), system)
    assert not agrees(replace(run, filtered=None), system)
    assert not agrees(replace(run, comparison=replace(run.comparison, seeds=0)), system)
    assert not agrees(replace(run, comparison=replace(run.comparison, states={**states, "z": states["x1"]})), system)


def test_feedback_sees_the_observer_and_not_the_filter(tmp_path: Path) -> None:
    text = """\
spec_version: 1
plant:
  states: [x, y]
  inputs: {u: {range: [-50, 50]}}
  dynamics: ["y", "sin(x) + u"]
  output: [x]
measurement: {sampling: {period: 0.1}, noise: {std: [0.01]}}
observer: {family: reachability, gain: {K: [[0.7], [2]]}}
simulation: {horizon: 10, initial_state: [0.3, 0], initial_estimate: [0, 0], signals: {u: "-3*x - 2*y"}}
"""
    document = made(tmp_path, text, ("synthesize", "simulate")).simulation
    assert document is not None
    found = document["comparison"]
    assert found["reason"] is None and 0 < found["states"]["y"]["rmse_ekf"] < found["states"]["y"]["rmse"]


def test_json_holds_plain_numbers(tmp_path: Path) -> None:
    simulated(tmp_path, **BOXES)
    text = (tmp_path / "out" / "simulation.json").read_text()
    assert "NaN" not in text and "Infinity" not in text and json.loads(text)["comparison"]["seeds"] == 8
