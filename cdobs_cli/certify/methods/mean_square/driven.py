"""Noise and disturbance as the searches read them: bounded ones of size 1, over unit time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.mean_square.setting import Setting
from cdobs_cli.certify.methods.mean_square.signals import bounded_floats, noise_floats
from cdobs_cli.certify.methods.peak.signals import acting
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


@dataclass(frozen=True)
class Driven:
    """B (N, r), G (N, q): what bounded signals that are not 0 do, of size 1, over `unit`; d_0 (r,), v_0 (q,): their
    sizes. spread (N, N), drift (N, N): what white ones add at a sample and in unit time, over unit^2."""

    B: Array
    G: Array
    spread: Array
    drift: Array
    d_0: Array
    v_0: Array
    unit: float
    T: float

    @staticmethod
    def of(setting: Setting, plant: Plant) -> Driven:
        d, v = acting(plant.disturbance), acting(plant.noise)
        v_0, d_0 = bounded_floats(plant)
        v_0, d_0 = v_0[v], d_0[d]
        B, G = setting.drive[:, d] * d_0, setting.kick[:, v] * v_0
        R, Q = noise_floats(plant)
        spread, drift = setting.kick @ R @ setting.kick.T, setting.drive @ Q @ setting.drive.T / setting.T
        largest = [*np.sum(B**2, axis=0), *np.sum(G**2, axis=0), np.trace(spread), np.trace(drift)]
        unit = float(np.sqrt(max(largest))) or 1.0  # so that prices are about 1
        return Driven(B / unit, G / unit, spread / unit**2, drift / unit**2, d_0, v_0, unit, setting.T)

    def flow_prices(self, mu: Array) -> Array:
        """Of the disturbances, (.., r), in the user's units."""
        value: Array = mu * (self.unit / self.d_0) ** 2 / self.T
        return value

    def kick_prices(self, nu: Array) -> Array:
        """Of the noises, (.., q), in the user's units."""
        value: Array = nu * (self.unit / self.v_0) ** 2
        return value
