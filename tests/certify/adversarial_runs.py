"""Runs of an error system under signals that switch between the ends of what is declared: written apart from the tool's
own adversary, with scipy's exponentials."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import expm

from cdobs_cli.certify.methods.base import Question

SLOTS = 4


def largest_errors(question: Question, runs: int, periods: int, rng: np.random.Generator, start: Any = None) -> Any:
    """(n,): the largest |e_i| met at ends of slots and on both sides of samples, over random bang-bang V, d, v and
    periods; from e = 0, or from corners of a box just before the first sample."""
    inclusion, plant = question.inclusion, question.plant
    maps, noise = inclusion.floats, inclusion.noise_floats
    N, n = noise.drive.shape
    law = question.law
    shortest = max(float(law.T_min), float(law.T_max) * 1e-3)
    lengths = (
        [float(law.T_max), shortest, *rng.uniform(shortest, float(law.T_max), 2)]
        if not law.is_periodic
        else [float(law.T_max)]
    )
    corners = list(product(*zip(maps.lower, maps.upper, strict=True)))
    E = np.zeros((len(lengths), len(corners), N, N + n))
    for a, T in enumerate(lengths):
        for b, v in enumerate(corners):
            augmented = np.zeros((N + n, N + n))
            augmented[:N, :N], augmented[:N, N:] = maps.flow(v), noise.drive
            E[a, b] = expm(augmented * T / SLOTS)[:N]
    jumps = np.array(list(maps.jumps()))
    e, largest = np.zeros((runs, N)), np.zeros(n)
    if start is not None:
        e[:, :n] = chosen(start, n, runs, rng)
        largest = np.abs(e[:, :n]).max(axis=0)
    # Signals that often keep an end, or go with the error's sign, do more harm than coins.
    steady = rng.random(runs) < 0.5
    held_d, held_v = chosen(plant.disturbance, n, runs, rng), chosen(plant.noise, plant.p, runs, rng)
    for _ in range(periods):
        v = np.where(steady[:, None], held_v, chosen(plant.noise, plant.p, runs, rng))
        e = np.einsum("rij,rj->ri", jumps[rng.integers(len(jumps), size=runs)], e) + v @ noise.kick.T
        largest = np.maximum(largest, np.abs(e[:, :n]).max(axis=0))
        a = rng.integers(len(lengths), size=runs)
        for _ in range(SLOTS):
            d = np.where(steady[:, None], held_d, chosen(plant.disturbance, n, runs, rng))
            step = E[a, rng.integers(len(corners), size=runs)]
            e = np.einsum("rij,rj->ri", step, np.concatenate([e, d], axis=1))
            largest = np.maximum(largest, np.abs(e[:, :n]).max(axis=0))
    return largest


def chosen(box: Any, size: int, runs: int, rng: np.random.Generator) -> Any:
    """Corners of a box at random, (runs, size)."""
    if box is None:
        return np.zeros((runs, size))
    low, high = (np.array([float(end) for end in side]) for side in (box.lower, box.upper))
    return np.where(rng.random((runs, size)) < 0.5, low, high)
