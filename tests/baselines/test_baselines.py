"""A constant gain against the eigenvalues of its sampled loop, and beside the Kalman filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from cdobs_cli.baselines.constant_gain import constant_gain, placed_gain
from cdobs_cli.baselines.kalman import extended_kalman_filter
from cdobs_cli.baselines.poles import linearised
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Input, Interval, Plant, Slopes
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
        K = placed_gain(plant.A.floats, plant.C.floats, 0.5, radius).floats
        closed = (np.eye(n) - K @ plant.C.floats) @ expm(0.5 * plant.A.floats)
        assert np.poly(closed) == pytest.approx(np.poly([radius] * n), abs=1e-9)


def test_poles_are_placed_for_one_output():
    two = replace(oscillator(), C=ExactMatrix([[1, 0], [0, 1]]))
    with pytest.raises(ValueError, match="one output"):
        placed_gain(two.A.floats, two.C.floats, 0.5, 0.5)


def test_the_linearisation_stands_at_the_estimate_amid_the_inputs():
    names = frozenset({"x1", "x2", "u"})
    phi = (parse("0", names), parse("u*sin(x1) - x2**3", names))
    plant = replace(oscillator(), inputs=(Input("u", Interval(Exact(1), Exact(3))),), phi=phi)
    A, C = linearised(plant, [0.5, -1.0])
    assert pytest.approx(np.array([[0, 1], [2 * np.cos(0.5), -3]])) == A and np.array_equal(C, [[1, 0]])
    with pytest.raises(ValueError, match="no linearisation"):
        linearised(replace(plant, phi=(parse("0", names), parse("log(x1)", names))), [0.0, 0.0])


def test_both_converge_on_the_linear_plant():
    plant = oscillator()
    plan = SimulationPlan(Exact(12), (Exact(1), Exact(0)), initial_estimate=(Exact(0), Exact(0)))
    one = ExactMatrix([[1, 0], [0, 1]])
    filtered = extended_kalman_filter(plant, one, ExactMatrix([["0.01"]]), one)
    for observer in (constant_gain(plant, placed_gain(plant.A.floats, plant.C.floats, 0.5, 0.3)), filtered):
        made = simulate(HybridSystem(plant, observer), plan, plant.sampling)
        assert made.overall.error_final is not None and made.overall.error_final < 1e-4
