"""The sine pendulum with white noise and disturbance: a constant correction beside the extended Kalman filter."""

from __future__ import annotations

from typing import Any

import numpy as np

_STEPS = 10  # of a period


def _flow(x: Any, h: float) -> Any:
    """Runge and Kutta's step of theta' = omega, omega' = sin theta; states in columns."""

    def f(z: Any) -> Any:
        return np.stack([z[1], np.sin(z[0])])

    a = f(x)
    b = f(x + h / 2 * a)
    c = f(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c))


def root_mean_squares(K: Any, T: float, R: float, Q: float, runs: int, periods: int, seed: int) -> tuple[float, float]:
    """Of |e| over time: with the constant gain, and with the filter; the same noise for both."""
    random, h = np.random.default_rng(seed), T / _STEPS
    x = random.uniform(-3, 3, size=(2, runs))
    ours = x + 0.01 * random.normal(size=x.shape)
    theirs = ours.copy()
    P = np.tile(np.diag([1e-4, 1e-4])[:, :, None], runs)
    sums = np.zeros(2)
    for k in range(periods):
        y = x[0] + np.sqrt(R) * random.normal(size=runs)
        ours = ours + np.outer(np.ravel(K), y - ours[0])
        G = P[:, 0] / (P[0, 0] + R)
        theirs = theirs + G * (y - theirs[0])
        P = P - G[:, None] * P[0][None]
        for _ in range(_STEPS):
            if k > periods // 5:
                sums += [np.sum((z - x) ** 2) for z in (ours, theirs)]
            c = np.cos(theirs[0])
            M = np.array([[1 + c * h**2 / 2, np.full(runs, h)], [c * h, 1 + c * h**2 / 2]])
            P = np.einsum("ijr,jkr,lkr->ilr", M, P, M)
            P[1, 1] += Q * h
            x, ours, theirs = (_flow(z, h) for z in (x, ours, theirs))
            x[1] += np.sqrt(Q * h) * random.normal(size=runs)
    counted = (periods - 1 - periods // 5) * _STEPS * runs
    return tuple(np.sqrt(sums / counted))
