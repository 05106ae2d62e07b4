"""Independent of the package's search: transition matrices of random slope histories, (13) written out."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm

from cdobs_cli.plant import Plant


def bounds(plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return plant.A.floats, plant.slopes.lower.floats, plant.slopes.upper.floats


def histories(plant: Plant, delta: float, count: int, seed: int = 0) -> np.ndarray:
    """Phi_V(delta) of random piecewise constant V, mostly at corners; shape (count, n, n)."""
    rng = np.random.default_rng(seed)
    A, low, up = bounds(plant)
    result = []
    for _ in range(count):
        pieces = rng.integers(1, 6)
        times = np.diff(np.concatenate([[0], np.sort(rng.uniform(0, delta, pieces - 1)), [delta]]))
        Phi = np.eye(len(A))
        for t in times:
            share = rng.integers(0, 2, A.shape) if rng.uniform() < 0.8 else rng.uniform(0, 1, A.shape)
            Phi = expm((A + low + share * (up - low)) * t) @ Phi
        result.append(Phi)
    return np.array(result)


def bang_bang(plant: Plant, delta: float, entry: tuple[int, int], steps: int) -> np.ndarray:
    """Phi_V(delta) for one slope at its ends with one switch, at `steps` places, both orders."""
    A, low, up = bounds(plant)
    i, j = entry
    one, two = A.copy(), A.copy()
    one[i, j] += low[i, j]
    two[i, j] += up[i, j]
    result = []
    for t in np.linspace(0, delta, steps):
        for first, second in ((one, two), (two, one)):
            result.append(expm(second * (delta - t)) @ expm(first * t))
    return np.array(result)


def inequality_13(P: Any, W: Any, M: Any, C: Any) -> np.ndarray:
    """(13) entry by entry, from the paper's page."""
    n = len(P)
    big = np.zeros((2 * n, 2 * n))
    PWC = P - W @ C
    for i in range(n):
        for j in range(n):
            big[i, j] = big[n + i, n + j] = P[i, j]
            big[n + i, j] = sum(PWC[i, k] * M[k, j] for k in range(n))
            big[j, n + i] = big[n + i, j]
    return big


def radius(matrix: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))
