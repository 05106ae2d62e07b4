"""Period against rate: what the convex synthesis reaches over all gains, and what the gain found reaches."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import search
from cdobs_cli.certify.climb import GAIN_DIGITS
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import Clock
from cdobs_cli.certify.methods.rung import GENERAL, One, fastest
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis, size
from cdobs_cli.design import FrontPoint
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_RATE_WIDTH = Fraction(1, 50)
_POINTS = 6
_LARGEST = 700  # (n + p)^3 times corners: beyond that the points take too long


@dataclass(frozen=True)
class Point:
    """A rate proved at a period by a certificate: for the gain L, or for the design's own."""

    T: Exact
    rate: Exact
    method: Method
    gain: ExactMatrix | None


@dataclass(frozen=True)
class Curve:
    """Points by increasing period.

    any_gain: the convex synthesis with a gain of its own at each period, up to where it ends; this_gain: the
    design's L, by Wirtinger where that proves a rate, else by the clock certificate.
    """

    any_gain: tuple[Point, ...] = ()
    this_gain: tuple[Point, ...] = ()

    def document(self) -> dict[str, Any]:
        """What is kept of this gain for the report; the points of any gain are the front."""
        if not (self.any_gain or self.this_gain):
            return {}
        return {"curve": [{"period": str(one.T), "rate": str(one.rate)} for one in self.this_gain]}

    @property
    def front(self) -> tuple[FrontPoint, ...]:
        """Each period with a gain of its own."""
        met = ((one, one.gain) for one in self.any_gain)
        return tuple(FrontPoint(str(one.T), str(one.rate), {}, {"L": L}) for one, L in met if L is not None)

    @property
    def longest(self) -> tuple[Certificate, ...]:
        """The certificate of the longest period of some gain."""
        if not self.any_gain:
            return ()
        last = self.any_gain[-1]
        return (last.method.certificate(None if last.gain is None else {"L": last.gain}),)


def gain_curve(question: Question, own: Sequence[Method] = ()) -> Curve:
    """Points (period, rate) up to the question's period, each proved when it was found; empty for large plants. own:
    what is proved of the question's gain already."""
    plant, T, law = question.plant, float(question.law.T_max), question.law
    if size(plant) > _LARGEST:
        return Curve()
    shares = np.geomspace(0.15, 1.0, _POINTS)
    periods = [search.short(share * T, 6) for share in shares]
    this = [_rate_of_gain(question.at(period), own if period == periods[-1] else ()) for period in periods]
    synthesis = HeldSynthesis(plant)
    end, last = synthesis.longest(T, lambda T: 0.0)
    ends = [search.short(share * 0.999 * end, 6) for share in shares] if last.margin > 0 else []
    best = [_rate_of_synthesis(question.at(period), synthesis) for period in reversed(ends)]
    return Curve(running_maxima(ends, best[::-1], law), running_maxima(periods, this, law))


def running_maxima(periods: Sequence[Exact], points: Sequence[Point | None], law: SamplingLaw) -> tuple[Point, ...]:
    """The points by increasing period, each at the best rate that a proof for it or for a longer period gives.

    A proof for [T_min, T] is one for every [T_min, T'] inside, and one for all T_k <= T (Wirtinger) is one for every
    shorter period too; a proof for one constant period serves that period only.
    """
    kept: list[Point] = []
    met: list[Point] = []
    for T, point in sorted(zip(periods, points, strict=True), key=lambda pair: -float(pair[0])):
        met += [point] if point is not None else []
        serving = [one for one in met if one.method.covers.contains(law.with_period(T))]
        if serving:
            best = max(serving, key=lambda one: float(one.rate))
            kept.append(Point(T, best.rate, best.method, best.gain))
    return tuple(reversed(kept))


def _rate_of_gain(question: Question, known: Sequence[Method]) -> Point | None:
    """The largest rate proved for this gain under the question's law; by the clock certificate the one that is known,
    where there is one."""
    law = question.law
    clocks = [one for one in known if isinstance(one, Clock) and float(one.sigma) and one.covers.contains(law)]
    for rung in (One(Wirtinger), GENERAL):
        method: Method | None = max(clocks, key=lambda one: float(one.sigma), default=None) if rung is GENERAL else None
        method = method or fastest(rung, question.afresh(), _RATE_WIDTH)
        if method is not None:
            return Point(law.T_max, Exact(method.sigma), method, None)  # type: ignore[attr-defined]
    return None


def _rate_of_synthesis(question: Question, synthesis: HeldSynthesis) -> Point | None:
    """The largest rate the convex synthesis reaches under the question's law, with its rounded gain, proved."""
    rate, best = synthesis.fastest(float(question.law.T_max))
    L = ExactMatrix.from_floats(best.L, GAIN_DIGITS)
    for share in (0.99, 0.95, 0.8, 0.0):
        sigma = search.short(share * rate, 6) if share * rate > 0 else Exact(0)
        method = Wirtinger.propose(question.with_gain({"L": L}).with_rate(sigma.rational or Fraction(0)))
        if method is not None:
            return Point(question.law.T_max, sigma, method, L)
    return None
