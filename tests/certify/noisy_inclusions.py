"""Error inclusions with noise and disturbance declared, and the filter that is best for linear ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from example_inclusions import Rows, held, impulsive, periodic, plant
from scipy.linalg import expm, solve_discrete_are

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh.theorems import noise_maps
from cdobs_cli.hybrid import HybridInclusion, corrected_copy_noise
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw

R, Q = [["1/30000"]], [[0, 0], [0, "0.00025"]]


def white(made: Plant, R: Rows | None = None, Q: Rows | None = None) -> Plant:
    """Noise of covariance R, a white disturbance of intensity Q."""
    covariance, intensity = (None if rows is None else ExactMatrix(rows) for rows in (R, Q))
    return replace(made, covariance=covariance, intensity=intensity)


def bounded(made: Plant, v: list[Any] | None = None, d: list[Any] | None = None) -> Plant:
    """|v_j| <= v[j], |d_j| <= d[j]."""
    boxes = (
        None if ends is None else Box(tuple(-Exact(x) for x in ends), tuple(Exact(x) for x in ends)) for ends in (v, d)
    )
    noise, disturbance = boxes
    return replace(made, noise=noise, disturbance=disturbance)


def pendulum(law: SamplingLaw, c: Any = 1) -> Plant:
    """A double integrator with |d phi_2 / d x_1| <= c, the first state measured."""
    return plant([[0, 1], [0, 0]], [[0, 0], [-Exact(c), 0]], [[0, 0], [c, 0]], [[1, 0]], law)


def corrected(made: Plant, K: Rows) -> HybridInclusion:
    """The impulsive error with its noise."""
    return replace(impulsive(made, K), assemble_noise=corrected_copy_noise)


def held_error(made: Plant, L: Rows) -> HybridInclusion:
    """The held error with its noise."""
    return replace(held(made, L), assemble_noise=noise_maps)


def drifted(A: Any, Q: Any, T: float) -> tuple[Any, Any]:
    """exp(A T), and the covariance that a disturbance of intensity Q adds over T."""
    n = len(A)
    F = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * T)
    Phi = F[n:, n:].T
    return Phi, Phi @ F[:n, n:]


def kalman(A: Any, C: Any, Q: Any, R: Any, T: float) -> tuple[Any, float, Any]:
    """The periodic Kalman filter: gain, time average of the trace of its covariance, largest variances over time."""
    Phi, spread = drifted(A, Q, T)
    before = solve_discrete_are(Phi.T, C.T, spread, R)
    K = before @ C.T @ np.linalg.inv(C @ before @ C.T + R)
    return K, *moments(A, np.eye(len(A)) - K @ C, K, np.eye(len(A)), Q, R, T, len(A))


def moments(A: Any, J: Any, G: Any, B: Any, Q: Any, R: Any, T: float, n: int) -> tuple[float, Any]:
    """Of the linear error edot = A e + B d, e+ = J e + G v: the time average of the first n variances, and the largest
    of each over time."""
    Phi, spread = drifted(A, B @ Q @ B.T, T)
    after, M = G @ R @ G.T + J @ spread @ J.T, J @ Phi
    for _ in range(40):
        after, M = after + M @ after @ M.T, M @ M
    points, weights = np.polynomial.legendre.leggauss(14)

    def at(s: float) -> Any:
        step, added = drifted(A, B @ Q @ B.T, s)
        return np.diag(step @ after @ step.T + added)[:n]

    average = sum(w / 2 * np.sum(at((x + 1) / 2 * T)) for x, w in zip(points, weights, strict=True))
    most = np.max([at(s) for s in np.linspace(0, T, 41)], axis=0)
    return float(average), most


def linear_moments(inclusion: HybridInclusion) -> tuple[float, Any]:
    """`moments` of an inclusion without slopes that vary."""
    maps, noise, plant = inclusion.floats, inclusion.noise_floats, inclusion.plant
    R = np.zeros((plant.p, plant.p)) if plant.covariance is None else plant.covariance.floats
    Q = np.zeros((plant.n, plant.n)) if plant.intensity is None else plant.intensity.floats
    return moments(maps.base, maps.jump, noise.kick, noise.drive, Q, R, float(inclusion.sampling.T_max), plant.n)


def texts(M: Any) -> list[list[str]]:
    """An array as exact decimals."""
    return [[str(float(value)) for value in row] for row in M]


def random_plant(seed: int, n: int, p: int, T: str) -> tuple[Plant, Any, Any, Any, Any]:
    """A linear plant with noise and disturbance in all directions, and A, C, Q, R."""
    random = np.random.default_rng(seed)
    A, C = np.round(0.7 * random.normal(size=(n, n)), 3), np.round(random.normal(size=(p, n)), 3)
    G, H = random.normal(size=(n, n)), random.normal(size=(p, p))
    Q, R = np.round(0.1 * G @ G.T + 0.05 * np.eye(n), 4), np.round(0.02 * H @ H.T + 0.01 * np.eye(p), 4)
    zero = [[0] * n] * n
    return white(plant(texts(A), zero, zero, texts(C), periodic(T)), texts(R), texts(Q)), A, C, Q, R


def double_integrator(T: Any) -> Plant:
    return white(pendulum(periodic(T), 0), R, Q)
