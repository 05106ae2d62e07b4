"""The output predictor: poles where they were asked for, exact between the samples of its own model, and its limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from test_baselines import oscillator

from cdobs_cli.baselines.output_predictor import output_predictor, predictor_gain
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Plant
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate


@pytest.mark.parametrize("n", [1, 2, 3])
def test_poles_are_where_they_were_asked_for(n: int) -> None:
    plant = oscillator(n)
    L = predictor_gain(plant.A.floats, plant.C.floats, 1.5).floats
    assert np.poly(plant.A.floats - L @ plant.C.floats) == pytest.approx(np.poly([-1.5] * n), abs=1e-9)
    with pytest.raises(ValueError, match="one output"):
        predictor_gain(plant.A.floats, np.ones((2, n)), 1.0)


def simulated(plant: Plant, L: ExactMatrix, horizon: str) -> float:
    n = plant.n
    plan = SimulationPlan(Exact(horizon), (Exact(1),) * n, initial_estimate=(Exact(0),) * n)
    made = simulate(HybridSystem(plant, output_predictor(plant, L)), plan, plant.sampling)
    return made.overall.error_final or 0.0


def monodromy(plant: Plant, L: ExactMatrix, period: float) -> np.ndarray:
    """Of the error e = x_hat - x and the held w - h(x): e' = F e + L (w - C x - C e), w' - C x' = C F e."""
    F = plant.A.floats + np.array([[0.0, 0.0], [-1.0, 0.0]])
    C, gain = plant.C.floats, L.floats
    flow = np.block([[F - gain @ C, gain], [C @ F, np.zeros((1, 1))]])
    return expm(flow * period) @ np.diag([1.0, 1.0, 0.0])


@pytest.mark.parametrize(("period", "converges"), [("0.2", True), ("0.5", True), ("2.2", False)])
def test_it_runs_as_its_sampled_error_does(period: str, converges: bool) -> None:
    plant = replace(oscillator(), sampling=SamplingLaw.periodic(Exact(period)))
    L = predictor_gain(plant.A.floats, plant.C.floats, 1.5)
    M = monodromy(plant, L, float(period))
    assert (max(abs(np.linalg.eigvals(M))) < 1) == converges
    samples = 10
    expected = np.linalg.matrix_power(M, samples) @ np.array([-1.0, -1.0, 0.0])
    found = simulated(plant, L, str(float(period) * samples))
    assert found == pytest.approx(np.linalg.norm(expected[:2]), rel=1e-4, abs=1e-9)
