"""What is declared of noise and disturbance, and which questions about them are taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import is_small
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


def takes(question: Question) -> bool:
    """Whether samples come at periods that are bounded and bounded away from 0, and corners are few enough: noise of
    samples that follow at once adds up without end."""
    law, inclusion = question.law, question.inclusion
    apart = law.is_bounded and law.T_min.sign() == 1 and float(law.T_max) < 1e12
    return apart and inclusion.assemble_noise is not None and is_small(inclusion)


def noise_floats(plant: Plant) -> tuple[Array, Array]:
    """(R, Q), zeros where they are not declared."""
    R = np.zeros((plant.p, plant.p)) if plant.covariance is None else plant.covariance.floats
    Q = np.zeros((plant.n, plant.n)) if plant.intensity is None else plant.intensity.floats
    return R, Q


def bounded_floats(plant: Plant) -> tuple[Array, Array]:
    """(v_0, d_0) of bounded signals, zeros where there are none."""
    v_0 = np.zeros(plant.p) if plant.noise is None else np.array(plant.noise.float_sizes)
    d_0 = np.zeros(plant.n) if plant.disturbance is None else np.array(plant.disturbance.float_sizes)
    return v_0, d_0


def identity_on(n: int, N: int) -> Matrix:
    """diag(I, 0), I of size n."""
    return Matrix.from_rows([[int(i == j and i < n) for j in range(N)] for i in range(N)])
