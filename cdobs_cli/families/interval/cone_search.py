"""Search in floats for a cone of errors that E(s) keeps: of the rows that are pulled below zero, the largest share
that the others can carry.

    e_i <= sum_j c_ij e_j,    c_ij = min over s of E_ij(s) / -E_ii(s)  where E_ii(s) < 0

With c no larger, E(s) e >= 0 on each ray e_j + c_ij e_i; a little less leaves the proof room.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.certify.falsify import exponentials
from cdobs_cli.certify.lmi import Program, diagonal, full
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.cone import Cone, ErrorSystem
from cdobs_cli.sampling import SamplingLaw

Array = NDArray[np.float64]

_PHASES, _PERIODS = 64, 24
_SHARES = (0.99999, 0.999, 0.98, 0.9, 0.7)
_DIGITS = 8
_LARGEST_EXPONENT = 200.0
_ROUNDING = 1e-10  # an entry of E(s) that small is rounding


def error_maps(errors: ErrorSystem, times: Array) -> Array | None:
    """E(s) for each s, shape (len(times), 2n, 2n); None where floats overflow."""
    M, N1 = errors.M.floats, errors.N1.floats
    size = len(M)
    flow = np.block([[M, np.eye(size)], [np.zeros((size, 2 * size))]])
    if not (np.all(np.isfinite(flow)) and np.all(np.isfinite(N1))) or np.abs(flow).sum(axis=1).max() * times.max() > _LARGEST_EXPONENT:
        return None
    parts = exponentials(flow[None] * times[:, None, None])
    maps: Array = parts[:, :size, :size] + parts[:, :size, size:] @ N1
    return maps if np.all(np.isfinite(maps)) else None


def find_cone(errors: ErrorSystem, law: SamplingLaw, effort: int = 1) -> Cone | None:
    """A cone that is proved to enclose the errors under the law, with the weights of its size where they are proved
    too; None where none was found."""
    for cone in likely_cones(errors, law):
        if cone.proves_enclosure(errors, law, effort):
            return _with_shrinking(errors, cone, law, effort)
    return None


def likely_cones(errors: ErrorSystem, law: SamplingLaw) -> Iterator[Cone]:
    """Cones that floats find to hold the errors at some times, largest first."""
    T = float(law.T_max)
    times = np.concatenate([[T * 1e-4], T * np.arange(1, _PHASES + 1) / _PHASES])
    E = error_maps(errors, times)
    rows = None if E is None else carried_rows(errors, E)
    if rows is None or E is None:
        return
    sampled = times >= float(law.T_min) * (1 - 1e-12)
    for share in _SHARES:
        cone = Cone(ExactMatrix.from_floats(rows * np.where(rows > 0, share, 1.0), _DIGITS))
        if cone.rays is None or (cone.H.floats @ errors.start.floats).min() < 0:
            continue
        after, H = E @ cone.rays.floats, cone.H.floats
        slack = _ROUNDING * np.abs(after).max()
        if after.min() >= -slack and (H @ after[sampled]).min() >= -slack * np.abs(H).max():
            yield cone


def _with_shrinking(errors: ErrorSystem, cone: Cone, law: SamplingLaw, effort: int) -> Cone:
    """The cone with what proves the errors in it bounded, where that is found: u first, it needs no solver."""
    shrinking = replace(cone, unit=find_unit(errors))
    if shrinking.proves_boundedness(errors, law, effort):
        return shrinking
    weighed = replace(cone, omega=find_weights(errors, cone, law))
    return weighed if weighed.proves_boundedness(errors, law, effort) else cone


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


def find_weights(errors: ErrorSystem, cone: Cone, law: SamplingLaw) -> ExactMatrix | None:
    """omega of `Cone.proves_boundedness`: a linear program over the rays and some periods, largest common rate."""
    if cone.rays is None:
        return None
    G, n = cone.rays.floats, errors.size
    low, high = float(law.T_min), float(law.T_max)
    times = np.unique(np.linspace(max(low, high * 1e-3), high, _PERIODS))
    E = error_maps(errors, times)
    if E is None:
        return None
    slopes = [(E_s - np.eye(n)) @ G / s for s, E_s in zip(times, E, strict=True)]
    if low == 0:
        slopes.append((errors.M.floats + errors.N1.floats) @ G)
    program = Program({"w": diagonal(n), "t": full(1, 1)})
    for slope in slopes:
        scale = 1 / max(float(np.abs(slope).max()), 1e-12)
        for column in slope.T * scale:
            program.require(lambda x, c=column: (-np.diag(x["w"]) @ c - x["t"][0, 0]).reshape(1, 1))  # type: ignore[misc]
    for i in range(n):
        program.require(lambda x, i=i: (x["w"][i, i] - x["t"][0, 0]).reshape(1, 1))  # type: ignore[misc]
    program.equate(lambda x: np.trace(x["w"]).reshape(1, 1) - n)
    program.maximise(lambda x: x["t"])
    solution = program.solve()
    if not solution.values["t"][0, 0] > 0:
        return None
    return ExactMatrix.from_floats(np.diag(solution.values["w"]).reshape(-1, 1), _DIGITS)
