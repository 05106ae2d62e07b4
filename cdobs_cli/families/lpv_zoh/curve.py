"""Period against rate: what the convex synthesis reaches over all gains, and what the gain found reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import wirtinger
from cdobs_cli.families.lpv_zoh.climb import GAIN_DIGITS
from cdobs_cli.families.lpv_zoh.laws import at_period, covers, largest, short
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

_POINTS = 6
_LARGEST = 700  # (n + p)^3 times corners: beyond that the points take too long


@dataclass(frozen=True)
class Point:
    """A rate proved at a period by a certificate: for the design's gain, or for the L that it names."""

    T: Exact
    rate: Exact
    certificate: Certificate

    def document(self) -> dict[str, Any]:
        more = {"L": self.certificate.data["L"]} if "L" in self.certificate.data else {}
        return {"period": str(self.T), "rate": str(self.rate), **more}


@dataclass(frozen=True)
class Curve:
    """Points by increasing period.

    any_gain: the convex synthesis with a gain of its own at each period, up to where it ends; this_gain: the
    design's L, by Wirtinger where that proves a rate, else by the clock certificate.
    """

    any_gain: tuple[Point, ...] = ()
    this_gain: tuple[Point, ...] = ()

    def document(self) -> dict[str, list[dict[str, Any]]]:
        return {"any_gain": [p.document() for p in self.any_gain], "this_gain": [p.document() for p in self.this_gain]}

    @property
    def longest(self) -> tuple[Certificate, ...]:
        """The certificate of the longest period of some gain."""
        return (self.any_gain[-1].certificate,) if self.any_gain else ()


def gain_curve(plant: Plant, L: ExactMatrix, T: Exact, effort: int) -> Curve:
    """Points (period, rate), each proved when it was found; empty for large plants."""
    import numpy as np

    if (plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.uncertain) > _LARGEST:
        return Curve()
    shares = np.geomspace(0.15, 1.0, _POINTS)
    periods = [short(share * float(T)) for share in shares]
    own = [_rate_of_gain(at_period(plant, period), L, effort) for period in periods]
    end = _synthesis_end(plant, float(T))
    ends = [short(share * end) for share in shares] if end is not None else []
    best = [_rate_of_synthesis(at_period(plant, period)) for period in ends]
    law = plant.sampling
    return Curve(running_maxima(ends, best, law), running_maxima(periods, own, law))


def running_maxima(periods: Sequence[Exact], points: Sequence[Point | None], law: SamplingLaw) -> tuple[Point, ...]:
    """The points by increasing period, each at the best rate that a proof for it or for a longer period gives.

    A proof for [T_min, T] is one for every [T_min, T'] inside, and one for all T_k <= T (Wirtinger) is one for every
    shorter period too; a proof for one constant period serves that period only.
    """
    kept: list[Point] = []
    met: list[Point] = []
    for T, point in sorted(zip(periods, points, strict=True), key=lambda pair: -float(pair[0])):
        met += [point] if point is not None else []
        serving = [one for one in met if covers(one.certificate, law.with_period(T))]
        if serving:
            best = max(serving, key=lambda one: float(one.rate))
            kept.append(Point(T, best.rate, best.certificate))
    return tuple(reversed(kept))


def _rate_of_gain(plant: Plant, L: ExactMatrix, effort: int) -> Point | None:
    """The largest rate proved for this gain under the plant's law."""
    T = plant.sampling.T_max

    def by_wirtinger(sigma: Exact) -> Certificate | None:
        return wirtinger.analyse(plant, L, T, sigma.rational or Fraction(0))

    def by_clock(sigma: Exact) -> Certificate | None:
        return clock.analyse(inclusion(plant, {"L": L}), effort, sigma.rational or Fraction(0))

    for prove in (by_wirtinger, by_clock):
        at_rest = prove(Exact(0))
        if at_rest is not None:
            found = largest(prove, short(0.5 / float(T)), Fraction(1, 50))
            return Point(T, found[0], found[1]) if found else Point(T, Exact(0), at_rest)
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


def _rate_of_synthesis(plant: Plant) -> Point | None:
    """The largest rate the convex synthesis reaches under the plant's law, with its rounded gain, proved."""
    T = float(plant.sampling.T_max)
    rate, best = wirtinger.fastest(plant, T)
    L = ExactMatrix.from_floats(best.L, GAIN_DIGITS)
    for share in (0.99, 0.95, 0.8, 0.0):
        sigma = short(share * rate) if share * rate > 0 else Exact(0)
        proof = wirtinger.analyse(plant, L, plant.sampling.T_max, sigma.rational or Fraction(0))
        if proof is not None:
            return Point(plant.sampling.T_max, sigma, replace(proof, data={**proof.data, "L": L.texts()}))
    return None
