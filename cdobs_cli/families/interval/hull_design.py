"""S and L for the hull predictor: where |S F(s) S^-1| contracts for every period of the law, no positivity asked.

Searched in floats over the rates of S = [C; T] and all entries of L; the majorant

    max over s of (|S F(s) S^-1| - I)/s,  entry by entry,

is a Metzler matrix, and contraction in one weighted norm follows from its abscissa being negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.interval.design import L_DIGITS, S_DIGITS, Array, Search, climb
from cdobs_cli.families.interval.hull import error_maps_at, find_hull, prove_hull
from cdobs_cli.plant import Plant, SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

_GROWTH = 1.25


def hull_design(
    family: Interval, plant: Plant, search: Search, effort: int
) -> tuple[dict[str, ExactMatrix], SamplingLaw, dict[str, Any]] | str:
    """Gain, law and details for the objective; or why there is none.

    `max_period` climbs from period to period while a contraction is found; the other objectives take the
    fastest contraction at the given one.
    """
    law = plant.sampling
    found = _at(plant, search, law, None, effort)
    if found is None:
        return f"no S and L were found for which the hull predictor contracts for periods up to {law.T_max}"
    if family.objective == "max_period":
        for _ in range(24):
            longer = law.with_period(Exact(decimal_text(float(law.T_max) * _GROWTH, 4)))
            better = _at(plant, search, longer, found[1], effort)
            if better is None:
                break
            found, law = better, longer
    return found[0], law, {}


def _at(plant: Plant, search: Search, law: SamplingLaw, before: Array | None, effort: int) -> tuple[dict[str, ExactMatrix], Array] | None:
    """Gain and parameters at one law, proved."""
    n, p = plant.n, plant.p
    high, low = float(law.T_max), float(law.T_min)
    periods = [high] if low == high else [max(low, high * 1e-3) + (high - max(low, high * 1e-3)) * k / 16 for k in range(17)]

    def parts(parameters: Array) -> tuple[Array, Array] | None:
        shape = search.shape(parameters[: -n * p])
        return None if shape is None else (shape.S, shape.R @ parameters[-n * p :].reshape(n, p))

    def value(parameters: Array) -> float:
        pair = parts(parameters)
        errors = None if pair is None else error_maps_at(search.A, search.C, pair[0], pair[1], periods)
        if errors is None:
            return -np.inf
        majorant = np.max([(np.abs(F) - np.eye(n)) / s for s, F in zip(periods, errors, strict=True)], axis=0)
        return -float(np.linalg.eigvals(majorant).real.max())

    if before is not None:
        starts = [before]
    else:
        first = np.concatenate([np.eye(p).reshape(-1), np.zeros((n - p) * p)])
        starts = [np.concatenate([start, first * rate]) for start in search.starts() for rate in (0.3 / high, 1 / high, 3 * search.scale)]
    parameters, rate = climb(value, starts, 0.5, effort)
    pair = parts(parameters)
    if pair is None or not rate > 0:
        return None
    T = ExactMatrix.from_floats(pair[0][p:], S_DIGITS).rows if n > p else ()
    S, L = ExactMatrix([*plant.C.rows, *T]), ExactMatrix.from_floats(pair[1], L_DIGITS[0])
    w = find_hull(plant.A.floats, plant.C.floats, S.floats, L.floats, law)
    try:
        R = S.balls().inverse()
    except ZeroDivisionError:
        return None
    if w is None or not prove_hull(plant.A.balls(), plant.C.balls(), S.balls(), R, L.balls(), w.balls(), law):
        return None
    return {"S": S, "L": L}, parameters
