"""S and L for the hull predictor: where |S F(s) S^-1| contracts for every period of the law, no positivity asked.

Searched in floats over all entries of S and L; the majorant

    max over s of (|S F(s) S^-1| - I)/s,  entry by entry,

is a Metzler matrix, and contraction in one weighted norm follows from its abscissa being negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.interval.design import S_DIGITS, Array, Search, climb
from cdobs_cli.families.interval.hull import error_maps_at, find_hull, prove_hull
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

_GROWTH = (1.25, 1.08, 1.03)  # coarse to fine steps of the period under `max_period`
_STEPS = 16
_SHORTEST = 1e-3  # of the largest period: where the grid of the search begins
_CONDITION = 1e5


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
        for factor in _GROWTH:
            for _ in range(_STEPS):
                longer = law.with_period(Exact(decimal_text(float(law.T_max) * factor, 4)))
                better = _at(plant, search, longer, found[1], effort)
                if better is None:
                    break
                found, law = better, longer
    return found[0], law, {}


def _at(plant: Plant, search: Search, law: SamplingLaw, before: Array | None, effort: int) -> tuple[dict[str, ExactMatrix], Array] | None:
    """Gain and parameters (entries of S, then of L) at one law, proved."""
    n, p = plant.n, plant.p
    high, low = float(law.T_max), float(law.T_min)
    low = max(low, _SHORTEST * high)
    periods = [high] if law.is_periodic else [low + (high - low) * k / 16 for k in range(17)]

    def parts(parameters: Array) -> tuple[Array, Array] | None:
        S = parameters[: n * n].reshape(n, n)
        lengths = np.linalg.norm(S, axis=1, keepdims=True)
        if not np.all(np.isfinite(parameters)) or not np.all(lengths > 0) or np.linalg.cond(S / lengths) > _CONDITION:
            return None
        return S / lengths, parameters[n * n :].reshape(n, p)

    def value(parameters: Array) -> float:
        pair = parts(parameters)
        errors = None if pair is None else error_maps_at(search.A, search.C, pair[0], pair[1], periods)
        if errors is None:
            return -np.inf
        majorant = np.max([(np.abs(F) - np.eye(n)) / s for s, F in zip(periods, errors, strict=True)], axis=0)
        return -float(np.linalg.eigvals(majorant).real.max())

    fresh = sorted(_starts(search, high, effort), key=value, reverse=True)[: 1 + (4 if n <= 2 else 1) * effort]
    parameters, rate = fresh[0], -np.inf
    for start in fresh if before is None else [before, *fresh]:
        parameters, rate = climb(value, [start], 0.3, effort + 1)
        if rate > 0:
            break
    pair = parts(parameters)
    if pair is None or not rate > 0:
        return None
    S, L = ExactMatrix.from_floats(pair[0], S_DIGITS), ExactMatrix.from_floats(pair[1], S_DIGITS)
    w = find_hull(plant.A.floats, plant.C.floats, S.floats, L.floats, law)
    try:
        R = S.balls().inverse()
    except ZeroDivisionError:
        return None
    if w is None or not prove_hull(plant.A.balls(), plant.C.balls(), S.balls(), R, L.balls(), w.balls(), law):
        return None
    return {"S": S, "L": L}, parameters


def _starts(search: Search, high: float, effort: int) -> Iterator[Array]:
    """S from the Sylvester equation and at random (always the same), with injections of several strengths."""
    n = len(search.A)
    random = np.random.default_rng(0)
    shapes = [shape.S for shape in (search.shape(start) for start in search.starts()) if shape is not None]
    shapes += [random.normal(size=(n, n)) for _ in range(8 * (1 + effort))]
    for S in shapes:
        S = S / np.linalg.norm(S, axis=1, keepdims=True)
        for rate in (0.3 / high, 1 / high):
            yield np.concatenate([S.reshape(-1), rate * np.linalg.pinv(search.C).reshape(-1)])
