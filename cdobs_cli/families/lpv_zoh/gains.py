"""The search for a gain: the convex synthesis, and climbs from it with a method's own proof as objective."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from math import inf
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.climb import GAIN_DIGITS, Climb
from cdobs_cli.certify.gains import Candidate, GainSearch, Merit, NoDesignError
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock import climbs
from cdobs_cli.certify.methods.rung import Rung, fastest, rate_over
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis, size
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold, accurate
from cdobs_cli.families.lpv_zoh.search_plan import CLOCK, WIRTINGER, ClockRung, headline
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# A design on the edge converges never.
RATE_SHARE = LpvZeroOrderHold.rate_share

# Periods over the one asked for, and parts of their gains, where slopes of the outputs that vary leave less.
_SLOWER = {1: (1.0, 0.5, 0.35, 0.25, 0.1), 4: (1.0, 0.3), 20: (1.0, 0.3), 100: (1.0,), 1000: (1.0,)}
_COMPROMISE = (0.5, 0.25, 0.0)  # parts of the largest rate that are tried
_NEAR = Fraction(1, 20)
_SPARE = 1.01  # of a period to be served, for what the rounding of a gain takes
_FROM_ZERO = (
    "no certificate is known for an innovation that is held over periods from 0 on where the outputs are not linear: "
    "give min_period, or use family reachability"
)


def short(value: float) -> Exact:
    """A period or rate of six digits."""
    return search.short(value, 6)


def about(question: Question, L: ExactMatrix) -> Question:
    """The question about another gain."""
    return question.with_gain({"L": L})


class HeldGain(GainSearch):
    """L of the convex synthesis. proves: what its gains are proved by."""

    proves: ClassVar[Rung] = WIRTINGER

    def at(self, question: Question) -> Candidate | None:
        """At half the largest rate that it reaches: a compromise of speed and margin."""
        return self._at(question, _COMPROMISE)

    def fastest(self, question: Question) -> Candidate | None:
        return self._at(question, (0.99, 0.97, 0.9, 0.5))

    def quietest(self, question: Question) -> Candidate | None:
        """From a gain of the convex synthesis, where it has one."""
        if not accurate.is_tried(question):
            return None
        try:
            start = self._at(question, _COMPROMISE)
        except NoDesignError:
            return None
        method = fastest(self.proves, about(question, start.gain).afresh(), _NEAR)
        if method is None:
            return None
        rate = float(method.prove(about(question, start.gain)).rate.lower())
        return accurate.quietest(question, start, rate, self.proves)

    def least_error(
        self, question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None,
        near: ExactMatrix | None = None,
    ) -> Candidate | None:  # fmt: skip
        start = near
        if start is None:
            at = self.at(question)
            assert at is not None
            start = at.gain
        return accurate.least_error(question, start, self.proves, merit, weights)

    def _faster_start(self, question: Question) -> tuple[Candidate, float]:
        """Of the convex synthesis at half its fastest rate and close to it, the gain whose proved rate is larger."""
        met = []
        for way in (self.at, partial(HeldGain.fastest, self)):
            try:
                candidate = way(question)
            except NoDesignError:
                continue
            method = None if candidate is None else fastest(self.proves, about(question, candidate.gain).afresh())
            if candidate is not None and method is not None:
                met.append((candidate, float(method.prove(about(question, candidate.gain)).rate.lower())))
        if not met:
            candidate = self.at(question)
            assert candidate is not None
            return candidate, 0.0
        return max(met, key=lambda pair: pair[1])

    def _at(self, question: Question, shares: tuple[float, ...]) -> Candidate:
        T, synthesis = question.law.T_max, HeldSynthesis(question.plant)
        sigma, best = synthesis.fastest(float(T))
        if not best.margin > 0:
            raise NoDesignError(f"no gain was proved for T_k up to {T}")
        for share in shares:
            synthesis.epsilon = best.epsilon
            proposal = synthesis.redesign(float(T), share * sigma)
            L = ExactMatrix.from_floats(proposal.L, GAIN_DIGITS)
            if proposal.margin > 0 and Wirtinger.propose(about(question, L)) is not None:
                return Candidate(L, question.law)
        raise NoDesignError(f"no rounded gain could be proved at the period {T}")

    def longest(self, question: Question) -> Candidate | None:
        """At the question's rate, and at least the rate floor."""
        synthesis = HeldSynthesis(question.plant)
        wanted = float(question.rate)
        low, best = synthesis.longest(float(question.law.T_max), lambda T: max(wanted, RATE_SHARE / T))
        if not best.margin > 0:
            raise NoDesignError(f"no gain was proved, down to the period {short(low)}")
        for share in (1.0, 0.9995, 0.998, 0.99, 0.95, 0.9):
            T = short(share * low)
            sigma = max(question.rate, rate_over(T, RATE_SHARE))
            L = ExactMatrix.from_floats(synthesis.redesign(float(T), float(sigma)).L, GAIN_DIGITS)
            if Wirtinger.propose(about(question.at(T), L).with_rate(sigma)) is not None:
                return Candidate(L, question.law.with_period(T), float(T))
        raise NoDesignError(f"no rounded gain could be proved at periods up to {short(low)}")

    def nearest(self, question: Question) -> Candidate | None:
        try:
            return self.longest(question)
        except NoDesignError:
            return None


@dataclass(frozen=True)
class PeriodClimb(GainSearch):
    """L by climbing in the period with one rung's proof; it starts from the convex synthesis, at the period that this
    reaches."""

    rung: Rung

    def at(self, question: Question) -> Candidate | None:
        T = question.law.T_max
        L, longest = self._climb(question, 0.0, float(T))
        return Candidate(L, question.law if longest >= float(T) else question.law.with_period(short(longest)))

    def longest(self, question: Question) -> Candidate | None:
        L, T = self._climb(question, RATE_SHARE, float("inf"))
        further = self.rung.longest(about(question.at(short(T)), L).afresh(), RATE_SHARE)
        law = question.law.with_period(short(T)) if further is None else further.law
        return Candidate(L, law, float(law.T_max))

    def _climb(self, question: Question, share: float, goal: float) -> tuple[ExactMatrix, float]:
        starts, T = self._starts(question)
        shortest = 0.0 if question.law.is_periodic else float(question.law.T_min)

        def passes(L: ExactMatrix, T: float) -> bool:
            period = short(T)
            return (
                self.rung.propose(
                    about(question.at(period), L).with_rate(max(question.rate, rate_over(period, share))).afresh()
                )
                is not None
            )

        for _ in range(search.STEPS):
            if shortest >= T:
                break
            first = next((L for L in starts if passes(L, T)), None)
            if first is not None:
                budget = 48 * (1 + question.effort)
                return Climb(passes, _unit(question.plant, T), budget, goal).run(first.floats, T)
            T /= search.FACTOR
        raise NoDesignError(f"no gain was proved by {self.rung.name}, down to the period {short(max(T, shortest))}")

    def _starts(self, question: Question) -> tuple[list[ExactMatrix], float]:
        """Gains to start from, and the period that they are for."""
        start = HeldGain().longest(question)
        assert start is not None
        T = float(start.law.T_max)
        return [start.gain, *_stiffer_gains(question.plant, T)], T


@dataclass(frozen=True)
class PeriodAscent(GainSearch):
    """L by an ascent of the period at which the margin of the clock certificate ends; from the convex synthesis, at the
    period that this reaches."""

    def at(self, question: Question) -> Candidate | None:
        T = question.law.T_max
        L, _ = self._ascended(question, 0.0, float(T) * _SPARE)
        if CLOCK.propose(about(question, L).afresh()) is not None:
            return Candidate(L, question.law)
        reached = CLOCK.longest(about(question, L).afresh())
        if reached is None:
            raise _unproved(question)
        return Candidate(L, question.law if T.is_at_most(reached.law.T_max) else reached.law)

    def longest(self, question: Question) -> Candidate | None:
        L, T = self._ascended(question, RATE_SHARE, inf)
        reached = CLOCK.longest(about(headline(question).at(short(T)), L).afresh(), RATE_SHARE)
        if reached is None:
            raise _unproved(question)
        return Candidate(L, reached.law, float(reached.law.T_max))

    def _ascended(self, question: Question, share: float, goal: float) -> tuple[ExactMatrix, float]:
        """The gain met of the longest period, and about its end: from the first start that serves the question's
        period, else from the best."""
        starts, T = self._starts(question)
        enough, best = min(goal, T), None
        asked, unit = ClockRung.taken(question.at(short(T))).afresh(), _unit(question.plant, T)
        for start in starts:
            met = climbs.longest(asked, "L", start.floats, unit, _steps(question), share, goal)
            best = met if best is None or (met is not None and met[1] > best[1]) else best
            if best is not None and best[1] >= enough:
                break
        if best is None:
            raise _unproved(question)
        return ExactMatrix.from_floats(best[0], GAIN_DIGITS), best[1]

    def _starts(self, question: Question) -> tuple[list[ExactMatrix], float]:
        """Gains to start from, and the period that they are for."""
        start = HeldGain().longest(question)
        assert start is not None
        return [start.gain], float(start.law.T_max)


def _unproved(question: Question) -> NoDesignError:
    return NoDesignError(f"no gain was proved by {CLOCK.name} at periods near {question.law.T_max} or shorter")


def _stiffer_gains(plant: Plant, T: float) -> list[ExactMatrix]:
    """Gains of the convex synthesis for shorter periods: Theorem 1 asks for faster error dynamics than the
    longest period leaves."""
    synthesis = HeldSynthesis(plant)
    proposals = [synthesis.design(shorter * T, RATE_SHARE / T) for shorter in (0.8, 0.6, 0.4, 0.25)]
    return [ExactMatrix.from_floats(one.L, GAIN_DIGITS) for one in proposals if one.margin > 0]


class ClockGain(HeldGain):
    """The convex synthesis where it has a gain, else a climb in the period; for the rate a climb in the rate that the
    clock certificate proves."""

    proves: ClassVar[Rung] = CLOCK

    def at(self, question: Question) -> Candidate | None:
        try:
            return super().at(question)
        except NoDesignError:
            return PeriodAscent().at(question)

    def longest(self, question: Question) -> Candidate | None:
        return PeriodAscent().longest(question)

    def nearest(self, question: Question) -> Candidate | None:
        return HeldGain().nearest(question)

    def fastest(self, question: Question) -> Candidate | None:
        start, rate = self._faster_start(question)
        unit = _unit(question.plant, float(question.law.T_max))
        asked = ClockRung.taken(question).afresh()
        met = climbs.fastest(asked, "L", start.gain.floats, unit, _steps(question), rate) if rate > 0 else None
        return start if met is None else Candidate(ExactMatrix.from_floats(met[0], GAIN_DIGITS), question.law)


@dataclass(frozen=True)
class MiddleAscent(PeriodAscent):
    """The same where outputs have slopes that vary: from the convex synthesis for their middle, at the period asked for
    and at longer ones (slower gains leave more room), and from parts of its gains."""

    def _starts(self, question: Question) -> tuple[list[ExactMatrix], float]:
        plant, T = replace(question.plant, h=None, H=None), float(question.law.T_max)
        middle = replace(question, inclusion=replace(question.inclusion, plant=plant))
        gains = []
        for longer, parts in _SLOWER.items():
            try:
                met = HeldGain().at(middle.at(short(longer * T)))
            except NoDesignError:
                break
            assert met is not None
            gains += [ExactMatrix.from_floats(part * met.gain.floats, GAIN_DIGITS) for part in parts]
        if not gains:
            raise NoDesignError(f"no gain was found for the middle of the outputs' slopes at the period {short(T)}")
        return gains, T


class MiddleGain(ClockGain):
    """Where outputs have slopes that vary: climbs with the clock certificate, which takes them all."""

    def at(self, question: Question) -> Candidate | None:
        return self._ascent(question).at(question)

    def longest(self, question: Question) -> Candidate | None:
        return self._ascent(question).longest(question)

    nearest = GainSearch.nearest

    @staticmethod
    def _ascent(question: Question) -> MiddleAscent:
        if question.law.from_zero:
            raise NoDesignError(_FROM_ZERO)
        return MiddleAscent()


def _unit(plant: Plant, T: float) -> Array:
    return Units.of(PlantView.floats(plant, {}), T).gain_out(np.ones((plant.n, plant.p)))


def _steps(question: Question) -> int:
    """How many programs an ascent may solve: fewer where each one is large."""
    return max(12, min(40, 20000 // size(question.plant))) * (1 + question.effort) // 2
