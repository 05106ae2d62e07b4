"""Gains that stand in the objects of other libraries: arrays, and state spaces of python-control."""

from __future__ import annotations

from typing import Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.baselines.constant_gain import filter_gain
from cdobs_cli.plant import Plant

_SAME = 1e-9  # relative difference of two periods that are meant to be the same


def gain_rows(value: Any, plant: Plant) -> list[list[float]] | float:
    """Rows of a gain: of an array, or of an observer in state space form whose first inputs are the outputs y.

    A system in continuous time, x_hat' = (A - L C) x_hat + B u + L y, has L in its input matrix. One in discrete time
    whose output is the estimate just after a sample, x_hat+ = (I - K C) x_hat- + K y, has K in its feedthrough; without
    feedthrough it is a predictor of a linear plant, with exp(A T) K in its input matrix.

    Raises:
        ValueError: the shapes are not those of an observer of the plant, its step is not the sampling period, or a
            predictor is of a plant that is not linear.
    """
    if not all(hasattr(value, name) for name in ("A", "B", "D", "dt")):
        M = np.asarray(value, dtype=np.float64)
        if M.ndim == 0:
            return float(M)
        return _rows(M.reshape(-1, 1) if M.ndim == 1 and plant.p == 1 else M)
    n, p = plant.n, plant.p
    A, B, D = (np.asarray(getattr(value, name), dtype=np.float64) for name in ("A", "B", "D"))
    if A.shape != (n, n) or B.shape[1] < p:
        raise ValueError(
            f"the system has {len(A)} states and {B.shape[1]} inputs, an observer here {n} and {p} or more"
        )
    if not value.dt:
        return _rows(B[:, :p])
    period = _step(value.dt, plant)
    if np.any(D[:, :p]):
        if len(D) < n:
            raise ValueError(f"the system puts out {len(D)} numbers, the estimate has {n}")
        return _rows(D[:n, :p])
    if plant.slopes.entries or any(row.variables for row in plant.phi):
        raise ValueError("a predictor has exp(A T) K, and exp(A T) is that of a linear plant; give K itself")
    return _rows(filter_gain(plant.A.floats, B[:, :p], period))


def _step(dt: float | bool, plant: Plant) -> float:
    """The time step of a system in discrete time; True is the period, whatever it is. Raises: ValueError."""
    law = plant.sampling
    if dt is True:
        return float(law.period)
    if not float(law.T_min) * (1 - _SAME) <= dt <= float(law.T_max) * (1 + _SAME):
        raise ValueError(f"the system has the time step {dt:g}, and the plant is measured {law.text('')}".rstrip())
    return float(dt)


def _rows(M: Array) -> list[list[float]]:
    rows: list[list[float]] = M.tolist()
    return rows
