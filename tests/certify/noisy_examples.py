"""Questions about errors under bounded disturbance and noise, for the tests of error bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from example_inclusions import aperiodic, canonical, periodic, plant
from scipy.linalg import expm

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw


def box(sizes: Sequence[Any]) -> Box:
    """|x_j| <= sizes_j."""
    ends = tuple(Exact(size) for size in sizes)
    return Box(tuple(-end for end in ends), ends)


def noisy(plant: Plant, d0: Sequence[Any] | None, v0: Sequence[Any] | None) -> Plant:
    return replace(plant, disturbance=d0 and box(d0), noise=v0 and box(v0))


def asked(card: Any, plant: Plant, gain: Any, effort: int = 1) -> Question:
    """The question that a design with this gain asks."""
    return card.question(plant, {card.letter: ExactMatrix(gain)}, effort)


def pendulum(T: Any, K: Any, effort: int = 1, law: SamplingLaw | None = None, c: Any = (1, 0)) -> Question:
    """theta' = omega, |d omega' / d theta| <= 1, theta measured; d0 = .05 on omega, v0 = .01."""
    made = canonical(list(c), law or periodic(T))
    return asked(Reachability(), noisy(made, [0, "0.05"], ["0.01"]), [[x] for x in K], effort)


def sine(T: Any, L: Any, effort: int = 1, law: SamplingLaw | None = None) -> Question:
    """The plant of `lpv_zoh_sine.yaml`, with noise."""
    made = plant([[0, 1], [0, 0]], [[0, 0], ["-0.3", 0]], [[0, 0], ["0.3", 0]], [[1, 0]], law or periodic(T))
    return asked(LpvZeroOrderHold(), noisy(made, [0, "0.05"], ["0.01"]), [[x] for x in L], effort)


def drawn(rng: Any, effort: int = 0) -> Question:
    """A random small plant with a random gain, law and noise, whose loop decays at the corners of its slopes."""
    while True:
        n = int(rng.integers(2, 4))
        A = rng.uniform(-1, 1, (n, n)).round(2)
        spread = np.where(rng.random((n, n)) < 1.5 / n**2, rng.uniform(0, 0.4, (n, n)), 0).round(2)
        p = int(rng.integers(1, 3))
        C = rng.uniform(-1, 1, (p, n)).round(1)
        T = round(float(rng.uniform(0.1, 0.8)), 2)
        share = rng.choice([1.0, 0.5, 0.1, 0.0])
        law = periodic(str(T)) if share == 1 else aperiodic(str(round(T * share, 3)), str(T))
        made = plant(texts(A), texts(-spread), texts(spread), texts(C), law)
        sides = [rng.uniform(0, 0.1, size).round(3) * (rng.random(size) < 0.7) for size in (n, p)]
        made = noisy(made, texts([sides[0]])[0], texts([sides[1]])[0])
        impulsive = rng.random() < 0.5
        K = np.linalg.pinv(C) * rng.uniform(0.4, 1.1) + rng.uniform(-0.2, 0.2, (n, p))
        if impulsive and law.from_zero and rng.random() < 0.7:  # only C K = I is proved from 0
            K = np.linalg.pinv(C).round(6) if p == n else np.linalg.pinv(C)
        card, gain = (Reachability(), K) if impulsive else (LpvZeroOrderHold(), K / T * 0.6)
        question = asked(card, made, texts(gain.round(3)), effort)
        maps = question.inclusion.floats
        radii = [
            np.abs(np.linalg.eigvals(maps.jump @ expm(flow * period))).max()
            for flow in maps.corners() for period in {T, max(float(law.T_min), T / 10)}
        ]  # fmt: skip
        if max(radii) < 0.97:
            return question


def texts(rows: Any) -> list[list[str]]:
    return [[f"{value:.6g}" for value in row] for row in rows]
