"""Search in floats for a cone of errors that E(s) keeps: of the rows that are pulled below zero, the largest share
that the others can carry.

    e_i <= sum_j c_ij e_j,    c_ij = min over s of E_ij(s) / -E_ii(s)  where E_ii(s) < 0

With c no larger, E(s) e >= 0 on each ray e_j + c_ij e_i; a little less leaves the proof room.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.cone import Cone, rays_of
from cdobs_cli.families.interval.errors import ErrorSystem
from cdobs_cli.families.interval.hull import falling_weights
from cdobs_cli.sampling import SamplingLaw

C = TypeVar("C", bound=Cone)
_PHASES, _PERIODS = 64, 24
_SHARES = (0.99999, 0.999, 0.98, 0.9, 0.7)
_DIGITS = 8
_ROUNDING = 1e-10  # an entry of E(s) that small is rounding


def likely_cones(errors: ErrorSystem, law: SamplingLaw) -> Iterator[ExactMatrix]:
    """Cones H that floats find to hold the errors at some times, largest first."""
    T = float(law.T_max)
    times = np.concatenate([[T * 1e-4], T * np.arange(1, _PHASES + 1) / _PHASES])
    maps = errors.maps(times)
    rows = None if maps is None else carried_rows(errors, maps[0])
    if rows is None or maps is None:
        return
    sampled = times >= float(law.T_min) * (1 - 1e-12)
    for share in _SHARES:
        exact = ExactMatrix.from_floats(rows * np.where(rows > 0, share, 1.0), _DIGITS)
        H, G = exact.floats, rays_of(exact)
        if G is None or (H @ errors.start.floats).min() < 0:
            continue
        after = maps[0] @ G.floats
        slack = _ROUNDING * np.abs(after).max()
        if after.min() >= -slack and (H @ after[sampled]).min() >= -slack * np.abs(H).max():
            yield exact


def with_shrinking(errors: ErrorSystem, cone: C) -> C:
    """The cone with what proves the errors in it bounded, where that is found: u first, it needs no solver."""
    shrinking = replace(cone, unit=find_unit(errors))
    if shrinking.shrinks(errors):
        return shrinking
    weighed = replace(cone, omega=find_weights(errors, cone))
    return weighed if weighed.shrinks(errors) else cone


def find_unit(errors: ErrorSystem) -> ExactMatrix | None:
    """u = -(M + N1)^-1 g, g the sum of the errors that boxes start: then -Phi(s) u is the mean of exp(M r) g over
    [0, s]."""
    g = errors.start.floats.sum(axis=1)
    try:
        u = np.linalg.solve(-(errors.M.floats + errors.N1.floats), g)
    except np.linalg.LinAlgError:
        return None
    if not np.all(np.isfinite(u)) or not np.all(u > 0):
        return None
    return ExactMatrix.from_floats(u.reshape(-1, 1) / u.max(), _DIGITS)


def carried_rows(errors: ErrorSystem, E: Array) -> Array | None:
    """The rows of H: c_i with -1 at i, for each i whose E_ii loses its sign; None where there is none.

    Args:
        E: E(s) at some s, shape (times, 2n, 2n).
    """
    rows = []
    for i in range(errors.size):
        pulled = E[:, i, i] < 0
        if not pulled.any():
            continue
        row = (E[pulled, i, :] / -E[pulled, i, i][:, None]).min(axis=0)
        row = np.where(row > _ROUNDING, row, 0.0)
        row[list(errors.cut)] = 0.0
        row[i] = -1.0
        rows.append(row)
    return np.array(rows) if rows else None


def find_weights(errors: ErrorSystem, cone: Cone) -> ExactMatrix | None:
    """omega of `Cone.shrinks`: a linear program over the rays and some periods, largest common rate."""
    low, high = float(cone.law.T_min), float(cone.law.T_max)
    times = np.unique(np.linspace(max(low, high * 1e-3), high, _PERIODS))
    maps = errors.maps(times)
    if maps is None or cone.rays is None:
        return None
    G, identity = cone.rays.floats, np.eye(errors.size)
    falls = [((identity - E_s) @ G).T / s for s, E_s in zip(times, maps[0], strict=True)]
    if low == 0:
        falls.append(-((errors.M.floats + errors.N1.floats) @ G).T)
    return falling_weights(falls, errors.size)
