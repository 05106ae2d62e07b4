"""Baselines against independent computations: eigenvalues of the sampled loop, a Kalman filter by matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from cdobs_cli.baselines.constant_gain import constant_gain, placed_gain
from cdobs_cli.baselines.kalman import extended_kalman_filter
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate


def oscillator(n: int = 2) -> Plant:
    A = ExactMatrix([[int(j == i + 1) for j in range(n)] for i in range(n)])
    zero = ExactMatrix([[0] * n] * n)
    states = tuple(f"x{i + 1}" for i in range(n))
    phi = tuple(parse("0" if i < n - 1 else "-x1", frozenset(states)) for i in range(n))
    C = ExactMatrix([[int(j == 0) for j in range(n)]])
    return Plant(states, (), A, phi, None, C, Slopes(zero, zero), SamplingLaw.periodic(Exact("0.5")))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_poles_are_where_they_were_asked_for(n):
    plant = oscillator(n)
    for radius in (0.0, 0.6):
        K = placed_gain(plant, 0.5, radius).floats
        closed = (np.eye(n) - K @ plant.C.floats) @ expm(0.5 * plant.A.floats)
        assert np.poly(closed) == pytest.approx(np.poly([radius] * n), abs=1e-9)


def test_two_outputs_are_refused():
    plant = oscillator()
    two = Plant(plant.states, (), plant.A, plant.phi, None, ExactMatrix([[1, 0], [0, 1]]), plant.slopes, plant.sampling)
    for make in (
        lambda: placed_gain(two, 0.5, 0.5),
        lambda: extended_kalman_filter(two, (Exact(1),) * 2, Exact(1), (Exact(1),) * 2),
    ):
        with pytest.raises(ValueError, match="one output"):
            make()


def test_the_filter_is_the_kalman_filter_on_a_linear_plant():
    plant = oscillator()
    observer = extended_kalman_filter(plant, (Exact("0.1"), Exact("0.2")), Exact("0.3"), (Exact(1), Exact(2)))
    flow = compile_floats(observer.flow, observer.states, arrays=False)
    jump = compile_floats(observer.jump, (*observer.states, "y.0"), arrays=False)
    F = np.array([[0.0, 1.0], [-1.0, 0.0]])
    x, P = np.array([0.3, -0.4]), np.array([[1.1, 0.2], [0.2, 0.7]])
    state = (*x, P[0, 0], P[0, 1], P[1, 1])
    rate = F @ P + P @ F.T + np.diag([0.1, 0.2])
    assert flow(*state) == pytest.approx([*(F @ x), rate[0, 0], rate[0, 1], rate[1, 1]])
    C = np.array([[1.0, 0.0]])
    G = P @ C.T / (P[0, 0] + 0.3)
    after = P - G @ C @ P
    assert jump(*state, 0.9) == pytest.approx([*(x + G[:, 0] * (0.9 - x[0])), after[0, 0], after[0, 1], after[1, 1]])


def test_both_converge_on_the_linear_plant():
    plant = oscillator()
    plan = SimulationPlan(Exact(12), (Exact(1), Exact(0)), initial_estimate=(Exact(0), Exact(0)))
    filtered = extended_kalman_filter(plant, (Exact(1), Exact(1)), Exact("0.01"), (Exact(1), Exact(1)))
    for observer in (constant_gain(plant, placed_gain(plant, 0.5, 0.3)), filtered):
        made = simulate(HybridSystem(plant, observer), plan, plant.sampling)
        assert made.overall.error_final is not None and made.overall.error_final < 1e-4
