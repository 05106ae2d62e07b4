"""Period against rate: what the convex synthesis reaches over all gains, and what the gain found reaches."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import wirtinger
from cdobs_cli.families.lpv_zoh.climb import GAIN_DIGITS
from cdobs_cli.families.lpv_zoh.laws import at_period, largest, short
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.plant import Plant

_POINTS = 6
_LARGEST = 700  # (n + p)^3 times corners: beyond that the points take too long


def gain_curve(plant: Plant, L: ExactMatrix, T: Exact, effort: int) -> dict[str, list[dict[str, Any]]]:
    """Points (period, rate), each proved when it was found; empty for large plants.

    Returns:
        "any_gain": the convex synthesis with a gain of its own at each period, up to where it ends;
        "this_gain": this L, up to T, by Wirtinger where that proves a rate, else by the clock certificate.
    """
    import numpy as np

    if (plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.uncertain) > _LARGEST:
        return {}
    shares = np.geomspace(0.15, 1.0, _POINTS)
    own = [_rate_of_gain(at_period(plant, short(share * float(T))), L, effort) for share in shares]
    end = _synthesis_end(plant, float(T))
    best = [_rate_of_synthesis(at_period(plant, short(share * end))) for share in shares] if end is not None else []
    return {"any_gain": [point for point in best if point], "this_gain": [point for point in own if point]}


def _rate_of_gain(plant: Plant, L: ExactMatrix, effort: int) -> dict[str, Any] | None:
    """The largest rate proved for this gain under the plant's law."""
    T = plant.sampling.T_max

    def by_wirtinger(sigma: Exact) -> Certificate | None:
        return wirtinger.analyse(plant, L, T, sigma.rational or Fraction(0))

    def by_clock(sigma: Exact) -> Certificate | None:
        return clock.analyse(inclusion(plant, {"L": L}), effort, sigma.rational or Fraction(0))

    for prove in (by_wirtinger, by_clock):
        if prove(Exact(0)) is not None:
            found = largest(prove, short(0.5 / float(T)), Fraction(1, 50))
            return {"period": str(T), "rate": str(found[0]) if found else "0"}
    return None


def _synthesis_end(plant: Plant, T: float) -> float | None:
    """The longest period at which the convex synthesis has a gain, to a percent."""
    low, steps, best = T, 0, wirtinger.design(plant, T)
    while not best.margin > 0:
        low, steps = low / 1.3, steps + 1
        best = wirtinger.redesign(plant, low, 0.0, best.epsilon)
        if steps > 20:
            return None
    high = 1.3 * low
    while steps == 0 and (above := wirtinger.propose(plant, high, 0.0, best.epsilon)).margin > 0 and high < 100 * T:
        low, high, best = high, 1.3 * high, above
    while high - low > 0.005 * low:
        middle = (low + high) / 2
        low, high = (middle, high) if wirtinger.propose(plant, middle, 0.0, best.epsilon).margin > 0 else (low, middle)
    return 0.999 * low


def _rate_of_synthesis(plant: Plant) -> dict[str, Any] | None:
    """The largest rate the convex synthesis reaches under the plant's law, with its rounded gain, proved."""
    T = float(plant.sampling.T_max)
    rate, best = wirtinger.fastest(plant, T)
    L = ExactMatrix.from_floats(best.L, GAIN_DIGITS)
    for share in (0.99, 0.95, 0.8, 0.0):
        sigma = short(share * rate) if share * rate > 0 else Exact(0)
        if wirtinger.analyse(plant, L, plant.sampling.T_max, sigma.rational or Fraction(0)) is not None:
            return {"period": str(plant.sampling.T_max), "rate": str(sigma), "L": L.texts()}
    return None
