"""The signals that the error is bounded against: |d_j| <= d0_j, |v_j| <= v0_j, and the columns through which they act.

A box that is not symmetric lies in the symmetric one of its larger ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box

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
    return Signals(
        maps.drive[:, d], maps.kick[:, v], tuple(_size(plant.disturbance, j) for j in d),
        tuple(_size(plant.noise, j) for j in v),
    )  # fmt: skip


def acting(box: Box | None) -> list[int]:
    """The signals of a box that are not 0."""
    ends = () if box is None else zip(box.lower, box.upper, strict=True)
    return [j for j, (low, high) in enumerate(ends) if not low.sign() == high.sign() == 0]


def _size(box: Box | None, j: int) -> Any:
    assert box is not None
    return magnitude(box.lower[j], box.upper[j])


def magnitude(low: Exact, high: Exact) -> Any:
    """max(|low|, |high|): a rational where both are, else a ball."""
    if low.rational is not None and high.rational is not None:
        return max(abs(low.scalar), abs(high.scalar))
    return abs(low.ball()).max(abs(high.ball()))
