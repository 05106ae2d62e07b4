"""The signals that the error is bounded against: |d_j| <= d0_j, |v_j| <= v0_j, and the columns through which they act.

A box that is not symmetric lies in the symmetric one of its larger ends.
"""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

M = TypeVar("M")


@dataclass(frozen=True)
class Signals(Generic[M]):
    """B and G without the columns of signals that are 0, and the sizes of the others.

    Shapes: B (N, q), G (N, p'); d0 (q,), v0 (p',).
    """

    B: M
    G: M
    d0: tuple[Any, ...]
    v0: tuple[Any, ...]


def exact_signals(inclusion: HybridInclusion) -> Signals[Any]:
    """Rational where the data are rational, balls otherwise."""
    plant, maps = inclusion.plant, inclusion.noise_balls
    d, v = acting(plant.disturbance), acting(plant.noise)
    return Signals(maps.drive[:, d], maps.kick[:, v], acting_sizes(plant.disturbance), acting_sizes(plant.noise))


def acting(box: Box | None) -> list[int]:
    """The signals of a box that are not 0."""
    ends = () if box is None else zip(box.lower, box.upper, strict=True)
    return [j for j, (low, high) in enumerate(ends) if not low.sign() == high.sign() == 0]


def acting_sizes(box: Box | None) -> tuple[Any, ...]:
    """How large those are at most."""
    return () if box is None else tuple(box.sizes[j] for j in acting(box))
