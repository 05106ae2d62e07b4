"""Measurements that arrive late: after the last arrival the estimate is that of an observer that had all at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdobs_cli.design import Design
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.agreement import agrees
from cdobs_cli.simulate.archive import from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import system_of

# The last gap is longer than any delay: before its end everything is there.
TIMES = '"0.3 + 1.7*max(0, min(1, 100*(t_k - 4)))"'
ONE = """\
spec_version: 1
plant:
  states: [theta, omega]
  inputs: {u: {}}
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  B: [[0], [1]]
  lipschitz: [[0, 0], [1, 0]]
  disturbance: {lower: [0, -0.5], upper: [0, 0.5]}
measurement: {C: [[1, 0]], sampling: {min_period: 0.3, max_period: 2}, delay: [0, 1.6], noise: {lower: [-0.1], upper: [0.1]}}
observer: {family: FAMILY, gain: {GAIN}}
simulation:
  horizon: 6.1
  initial_box: {lower: [-1, -1], upper: [1, 1]}
  signals: {u: "sin(3*t)"}
  sampling_times: TIMES
"""  # noqa: E501
TWO = """\
spec_version: 1
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
  disturbance: {intensity: [[0, 0], [0, 0.01]]}
measurement:
  sensors:
    gyro: {C: [[0, 1]], period: 0.5, noise: {std: [0.1]}}
    camera: {C: [[1, 0]], period: 2, noise: {std: [0.1]}, delay: [0.1, 0.45]}
  gains: one
observer: {family: reachability, gain: {K: [[0.3, 0.4], [0.5, 0.2]]}}
simulation: {horizon: 6.49, initial_box: {lower: [-1, -1], upper: [1, 1]}}
"""


def loop(tmp_path: Path, text: str) -> tuple[HybridSystem, SimulationPlan, SamplingLaw]:
    path = tmp_path / "spec.yaml"
    path.write_text(text)
    spec = load(path)
    gain: Any = {letter: matrix for letter, matrix in spec.observer.given().items() if matrix is not None}
    design = Design(spec.observer.name, "given", spec.plant.sampling, gain)
    assert spec.simulation is not None
    return system_of(spec, design), spec.simulation, spec.plant.sampling


def one(family: str = "reachability", gain: str = "K: [[0.9], [1.2]]") -> str:
    return ONE.replace("FAMILY", family).replace("GAIN", gain).replace("TIMES", TIMES)


def at_once(system: HybridSystem) -> HybridSystem:
    return replace(system, plant=replace(system.plant, delays=()))


@pytest.mark.parametrize(
    ("text", "runs"),
    [(one(), 1000), (one("lpv_zoh", "L: [[0.9], [0.8]]"), 200), (TWO, 200), (one(), 1)],
    ids=["jumps", "held", "two sensors", "one run"],
)
def test_orders_of_arrival_come_to_the_same_estimate(tmp_path: Path, text: str, runs: int) -> None:
    system, plan, law = loop(tmp_path, text)
    plan = replace(plan, runs=runs)
    late, free = simulate(system, plan, law), simulate(at_once(system), plan, law)
    overtaken = apart = 0
    for ours, theirs in zip(late.trajectories, free.trajectories, strict=True):
        arrivals = ours.arrival_k
        assert arrivals is not None and theirs.arrival_k is None and np.nanmax(arrivals) <= ours.t[-1]
        overtaken += bool(np.any(np.diff(arrivals[:, 0]) < 0))
        assert np.array_equal(ours.t_k, theirs.t_k)
        estimate, expected = ours.estimates["x_hat"], theirs.estimates["x_hat"]
        assert np.allclose(ours.x[-1], theirs.x[-1], rtol=0, atol=1e-9)
        assert np.allclose(estimate[-1], expected[-1], rtol=0, atol=1e-9 * np.abs(expected).max())
        at_one = (np.interp(1.05, t, rows[:, 0]) for t, rows in ((ours.t, estimate), (theirs.t, expected)))
        apart += abs(np.diff(list(at_one))[0]) > 1e-3
    assert text == TWO or (overtaken >= 0.9 * runs and apart >= 0.5 * runs)


def test_an_estimate_knows_what_has_arrived_and_no_more(tmp_path: Path) -> None:
    system, plan, law = loop(tmp_path, one().replace("delay: [0, 1.6]", "delay: [0.2, 0.7]"))
    run = simulate(system, replace(plan, latest=True, signals={}), law).trajectories[0]
    assert run.arrival_k is not None and np.allclose(run.arrival_k[:, 0], run.t_k + 0.7)
    estimate, first = run.estimates["x_hat"], run.t < 0.7
    # Without a correction the start, the middle of the box, is an equilibrium of the model.
    assert np.abs(estimate[first]).max() == 0 and np.abs(estimate[~first]).max() > 0.01
    jumps = run.t[1:][np.diff(run.t) == 0]
    at = np.searchsorted(run.t, jumps)
    moved = jumps[np.abs(estimate[at + 1] - estimate[at]).max(axis=1) > 1e-12]
    assert np.allclose(np.unique(moved), run.arrival_k[run.arrival_k[:, 0] < run.t[-1], 0], atol=1e-12)


def test_delays_change_nothing_else_of_a_run(tmp_path: Path) -> None:
    system, plan, law = loop(tmp_path, TWO)
    late, free = (simulate(one, plan, law).trajectories[0] for one in (system, at_once(system)))
    assert np.allclose(late.y_k, free.y_k, rtol=0, atol=1e-9, equal_nan=True)
    grid = np.linspace(0, 6.4, 50)
    for j in range(2):
        assert np.allclose(np.interp(grid, late.t, late.x[:, j]), np.interp(grid, free.t, free.x[:, j]), atol=1e-4)


def test_of_several_sensors_each_has_its_own_delay(tmp_path: Path) -> None:
    system, plan, law = loop(tmp_path, TWO)
    run = simulate(system, replace(plan, runs=3), law).trajectories[2]
    assert run.arrival_k is not None
    gyro, camera = run.arrival_k.T - run.t_k
    assert np.all(gyro == 0)
    read = ~np.isnan(run.y_k[:, 1])
    assert np.array_equal(read, ~np.isnan(camera)) and read.sum() < len(read)
    assert np.all((camera[read] >= 0.1 - 1e-12) & (camera[read] <= 0.45 + 1e-12)) and np.ptp(camera[read]) > 0.01


def test_arrivals_are_stored_and_read(tmp_path: Path) -> None:
    system, plan, law = loop(tmp_path, TWO)
    run = replace(simulate(system, replace(plan, runs=2), law), digests={"key": "k"})
    again = from_bytes(to_bytes(run), run.document())
    for ours, theirs in zip(run.trajectories, again.trajectories, strict=True):
        assert np.array_equal(ours.arrival_k, theirs.arrival_k, equal_nan=True)
    at_once_run = replace(again, trajectories=tuple(replace(one, arrival_k=None) for one in again.trajectories))
    assert not agrees(at_once_run, system)
