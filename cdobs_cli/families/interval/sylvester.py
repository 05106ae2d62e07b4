"""S = [C; T] from the Sylvester equation T A - Lambda T = G C: how well its printed decimals solve it."""

from __future__ import annotations

import numpy as np

from cdobs_cli.certify.sylvester import residual
from cdobs_cli.families.interval.parts import Array
from cdobs_cli.families.interval.system import System


def residuals(system: System, rates: Array, directions: Array) -> tuple[float, float]:
    """How well the printed T solves its equation, and the printed L its own, S L = [diag(q); 0]: both relative."""
    p, plant, Q1 = system.plant.p, system.plant, system.floats.Q1
    wanted = np.zeros_like(Q1)
    wanted[:p, :p] = np.diag(np.diag(Q1)[:p])
    solved = residual(plant.A.floats, plant.C.floats, system.gain["S"].floats[p:], rates, directions)
    return solved, float(np.abs(Q1 - wanted).max()) / (float(np.abs(Q1).max()) or 1.0)
