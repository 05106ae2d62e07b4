"""The extended Kalman filter as equations against a filter by matrices, written apart from it, and against Riccati."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from cdobs_cli.baselines.kalman import extended_kalman_filter
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Input, Plant, Slopes
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate

LAW = SamplingLaw.periodic(Exact("0.3"))
Q = ExactMatrix([["0.02", "0.01"], ["0.01", "0.05"]])
R = ExactMatrix([["0.04", "0.01"], ["0.01", "0.09"]])
P_0 = ExactMatrix([["0.5", "0.1"], ["0.1", "2"]])


def nonlinear(**declared) -> Plant:
    """xdot = (y, -sin x - y/5 + u), measured (x^2 + y u + x, cos y + 2 x)."""
    states, zero = ("x", "y"), ExactMatrix([[0, 0], [0, 0]])
    names = frozenset((*states, "u"))
    phi = (parse("0", names), parse("-sin(x) + u", names))
    h = (parse("x**2 + y*u + x", names), parse("cos(y) + 2*x", names))
    A = ExactMatrix([[0, 1], [0, "-0.2"]])
    C = ExactMatrix([[1, 0], [2, 0]])
    return Plant(states, (Input("u"),), A, phi, None, C, Slopes(zero, zero), LAW, h=h, **declared)


def f(x, u):
    return np.array([x[1], -np.sin(x[0]) - 0.2 * x[1] + u])


def jacobian(x):
    return np.array([[0.0, 1.0], [-np.cos(x[0]), -0.2]])


def measured(x, u):
    return np.array([x[0] ** 2 + x[1] * u + x[0], np.cos(x[1]) + 2 * x[0]])


def output_jacobian(x, u):
    return np.array([[2 * x[0] + 1, u], [2.0, -np.sin(x[1])]])


def unpacked(state, n, scales):
    P = np.zeros((n, n))
    P[np.triu_indices(n)] = state[n:]
    P = P + P.T - np.diag(np.diag(P))
    return np.array(state[:n]), P * np.outer(scales, scales)


def packed(x, P, scales):
    scaled = P / np.outer(scales, scales)
    return (*x, *scaled[np.triu_indices(len(x))])


@pytest.mark.parametrize("scale", [1, 1000])
def test_flow_and_jump_of_two_nonlinear_outputs_are_those_of_matrices(scale):
    start = ExactMatrix([[entry * Exact(scale**2) for entry in row] for row in P_0.rows])
    observer = extended_kalman_filter(nonlinear(), Q, R, start)
    scales = np.full(2, float(scale))
    flow = compile_floats(observer.flow, (*observer.states, "u"), arrays=False)
    jump = compile_floats(observer.jump, (*observer.states, "y.0", "y.1", "u"), arrays=False)
    x, P, u, y = np.array([0.3, -0.4]), np.array([[1.1, 0.2], [0.2, 0.7]]), 0.35, np.array([0.9, 1.4])
    F, H = jacobian(x), output_jacobian(x, u)
    rate = F @ P + P @ F.T + Q.floats
    assert flow(*packed(x, P, scales), u) == pytest.approx(packed(f(x, u), rate, scales), rel=1e-12)
    G = P @ H.T @ np.linalg.inv(H @ P @ H.T + R.floats)
    after = packed(x + G @ (y - measured(x, u)), (np.eye(2) - G @ H) @ P, scales)
    assert jump(*packed(x, P, scales), *y, u) == pytest.approx(after, rel=1e-11)


def test_a_run_on_a_nonlinear_plant_is_that_of_matrices():
    """Along a noisy run of 40 samples: the filter by matrices on its measurements, integrated by another code."""
    model = nonlinear(covariance=R, intensity=ExactMatrix([["0.001", 0], [0, "0.002"]]))
    u = parse("0.3*cos(2*t)", frozenset({"t"}))
    plan = SimulationPlan(Exact(12), (Exact("0.4"), Exact(0)), initial_estimate=(Exact(0), Exact(0)), signals={"u": u})
    run = simulate(HybridSystem(model, extended_kalman_filter(model, Q, R, P_0)), plan, LAW).trajectories[0]
    x, P, t = np.zeros(2), P_0.floats, 0.0

    def rates(t, z):
        x, P = z[:2], z[2:].reshape(2, 2)
        F = jacobian(x)
        return np.concatenate([f(x, 0.3 * np.cos(2 * t)), (F @ P + P @ F.T + Q.floats).ravel()])

    for t_k, y in zip(run.t_k, run.y_k, strict=True):
        if t_k > t:
            z = solve_ivp(rates, (t, t_k), np.concatenate([x, P.ravel()]), rtol=1e-10, atol=1e-12).y[:, -1]
            x, P, t = z[:2], z[2:].reshape(2, 2), t_k
        u_k = 0.3 * np.cos(2 * t_k)
        H = output_jacobian(x, u_k)
        G = P @ H.T @ np.linalg.inv(H @ P @ H.T + R.floats)
        x, P = x + G @ (y - measured(x, u_k)), (np.eye(2) - G @ H) @ P
        after = run.estimates["x_hat"][np.flatnonzero(np.abs(run.t - t_k) < 1e-12)[-1]]
        assert after == pytest.approx(x, abs=1e-7)


def linear(C, period="0.3") -> Plant:
    zero = ExactMatrix([[0, 0], [0, 0]])
    phi = (parse("0", frozenset()), parse("0", frozenset()))
    A = ExactMatrix([[0, 1], ["-1", "-0.4"]])
    return Plant(("x", "y"), (), A, phi, None, ExactMatrix(C), Slopes(zero, zero), SamplingLaw.periodic(Exact(period)))


def final_covariance(plant: Plant, observer: Observer, samples: int = 200) -> np.ndarray:
    """After the last of many updates."""
    flow = compile_floats(observer.flow, observer.states, arrays=False)
    jump = compile_floats(observer.jump, (*observer.states, *(f"y.{k}" for k in range(plant.p))), arrays=False)
    start = compile_floats(observer.start, tuple(f"initial.{name}" for name in plant.states), arrays=False)
    state = np.array(start(0.0, 0.0), dtype=float)
    T = float(plant.sampling.T_max)
    for k in range(samples):
        if k:
            state = solve_ivp(lambda t, z: flow(*z), (0, T), state, rtol=1e-10, atol=1e-13).y[:, -1]
        state = np.array(jump(*state, *[0.0] * plant.p), dtype=float)
    return unpacked(state, plant.n, np.ones(plant.n))[1]


def van_loan(A, Q, T):
    n = len(A)
    M = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * T)
    return M[n:, n:].T @ M[:n, n:]


@pytest.mark.parametrize("C", [[[1, 0]], [[1, 0], [1, 1]], [[1, 0], [0, 1], [1, -1]]])
def test_a_linear_plant_ends_in_the_steady_state_of_riccati(C):
    plant, p = linear(C), len(C)
    noise = ExactMatrix([[("0.04" if i == j else "0.01") for j in range(p)] for i in range(p)])
    found = final_covariance(plant, extended_kalman_filter(plant, Q, noise, ExactMatrix([[1, 0], [0, 1]])))
    A, H = plant.A.floats, plant.C.floats
    before = solve_discrete_are(expm(A * 0.3).T, H.T, van_loan(A, Q.floats, 0.3), noise.floats)
    G = before @ H.T @ np.linalg.inv(H @ before @ H.T + noise.floats)
    assert found == pytest.approx((np.eye(2) - G @ H) @ before, rel=1e-7, abs=1e-10)


def test_tiny_noise_leaves_the_covariance_positive():
    """R is 1e-24 of P: without Joseph's form the variance left over would be rounding, of either sign."""
    plant = linear([[1, 0], [0, 1]])
    small = ExactMatrix([["1e-24", 0], [0, "1e-24"]])
    observer = extended_kalman_filter(plant, Q, small, ExactMatrix([[1, "0.5"], ["0.5", 1]]))
    jump = compile_floats(observer.jump, (*observer.states, "y.0", "y.1"), arrays=False)
    _, P = unpacked(jump(0.0, 0.0, 1.0, 0.5, 1.0, 0.1, 0.2), 2, np.ones(2))
    assert np.linalg.eigvalsh(P).min() > 0 and P[0, 0] == pytest.approx(1e-24, rel=1e-6)


def test_what_it_does_not_take_is_a_sentence():
    plant, one = linear([[1, 0], [0, 1]]), ExactMatrix([[1, 0], [0, 1]])
    with pytest.raises(ValueError, match="no noise"):
        extended_kalman_filter(plant, Q, ExactMatrix([[1, 1], [1, 1]]), one)
    with pytest.raises(ValueError, match="no noise"):
        extended_kalman_filter(plant, Q, ExactMatrix([[1, 0], [0, 0]]), one)
    with pytest.raises(ValueError, match="for each output"):
        extended_kalman_filter(plant, Q, ExactMatrix([[1]]), one)
    five = linear([[1, 0]] * 5)
    eye = ExactMatrix([[int(i == j) for j in range(5)] for i in range(5)])
    with pytest.raises(ValueError, match="up to 4 outputs, not 5"):
        extended_kalman_filter(five, Q, eye, one)
