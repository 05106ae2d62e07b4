"""What a gain is to be best for: weights of the errors, and the second moments of noise and disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.mean_square.setting import units
from cdobs_cli.certify.methods.mean_square.signals import bounded_floats, noise_floats
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_UNIFORM = 3.0  # the variance of what is uniform in [-1, 1] is 1 / 3


@dataclass(frozen=True)
class Aim:
    """Z (n, n), weights of the errors; R (p, p), the covariance of the noise; Q (n, n), the intensity of the
    disturbance; sigma, the rate to be kept."""

    Z: Array
    R: Array
    Q: Array
    sigma: float

    @staticmethod
    def quiet(question: Question, sigma: float) -> Aim:
        """R = I, Q = 0, errors weighted by 1 / scale^2: how much noise a gain lets through."""
        n, p = question.plant.n, question.plant.p
        return Aim(weights_of(question, None), np.eye(p), np.zeros((n, n)), sigma)

    @staticmethod
    def declared(question: Question, weights: Sequence[float] | None, sigma: float) -> Aim:
        """The covariance and intensity declared; bounded signals as if uniform, a disturbance constant over T_max."""
        plant = question.plant
        R, Q = noise_floats(plant)
        v_0, d_0 = bounded_floats(plant)
        spread, drift = np.diag(v_0**2), np.diag(d_0**2) * float(question.law.T_max)
        return Aim(weights_of(question, weights), R + spread / _UNIFORM, Q + drift / _UNIFORM, sigma)


def weights_of(question: Question, weights: Sequence[float] | None) -> Array:
    """diag of the weights, 1 / scale^2 where they are not said."""
    return np.diag(scales(question) ** -2.0 if weights is None else np.asarray(weights, dtype=float))


def scales(question: Question) -> Array:
    """How far each state moves: the width of its domain's side, else what the clock certificate counts in, in
    proportion to the sides that are known; shape (n,)."""
    plant = question.plant
    size = units(question.inclusion)[: plant.n]
    known = {}
    for i, name in enumerate(plant.states):
        side = plant.domain.box.get(name)
        if side is not None and side.lower is not None and side.upper is not None:
            known[i] = float(side.upper) - float(side.lower)
    known = {i: width for i, width in known.items() if width > 0}
    ratio = float(np.median([width / size[i] for i, width in known.items()])) if known else 1.0
    return np.array([known.get(i, ratio * size[i]) for i in range(plant.n)])
