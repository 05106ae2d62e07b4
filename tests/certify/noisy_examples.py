"""Questions about errors under bounded disturbance and noise, for the tests of error bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from example_inclusions import canonical, periodic, plant

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
