"""The objectives, once for every family with a constant gain: the gain, its law, and a certificate for each thing
worth proving of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, ClassVar, Protocol

import numpy as np

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import accuracy, judge
from cdobs_cli.certify.gains import Candidate, GainSearch, NoDesignError
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.dead_beat import DeadBeat, EveryPeriod, resets
from cdobs_cli.certify.methods.open_loop import OpenLoop
from cdobs_cli.certify.methods.rung import Rung, fastest
from cdobs_cli.certify.reasons import costliest
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw


class Card(judge.Card, Protocol):
    """What is asked of a family's card.

    rate_share: under max_period the rate is at least this over the period. with_rates: whether the certificate kept
    for the law is the fastest that is found.
    """

    objective: Any
    rate_share: ClassVar[float]
    with_rates: ClassVar[bool]

    @property
    def name(self) -> str: ...

    @property
    def wanted_rate(self) -> Fraction:
        """What the longest period is searched at, per time unit."""

    def given(self) -> Mapping[str, ExactMatrix | None]: ...

    def gain_searches(self, question: Question) -> Sequence[GainSearch]: ...

    def rungs(self, question: Question) -> Sequence[Rung]:
        """The lines of the ladder that are asked for a certificate."""

    def refuses(self, plant: Plant) -> str | None:
        """Why no gain is looked for."""

    def why_nothing(self, question: Question) -> str:
        """Why a search found no gain."""

    def beyond(self, question: Question, own: Sequence[Method]) -> tuple[list[Certificate], dict[str, Any]]:
        """What else is worth keeping: certificates of other gains, laws that no gain survives, the report's details."""


def synthesize(card: Card, plant: Plant, effort: int) -> Design:
    """The given gain or one found for the objective, with its certificates; outcome `none` with a reason where no gain
    is found. Uses the solver."""
    with np.errstate(all="ignore"):  # what overflows in a search is no guess
        return _Synthesis(card, plant, effort).run()


def started(card: Card, plant: Plant, design: Design, start: Box, effort: int) -> Design:
    """The design with bounds of its errors for all time from these before the first sample. Uses the solver."""
    if not plant.has_bounded_signals or card.letter not in design.gain:
        return design
    with np.errstate(all="ignore"):
        question = card.question(replace(plant, sampling=design.sampling), design.gain, effort).started(start)
        return replace(design, certificates=(*design.certificates, *accuracy.certificates(question)))


class _Synthesis:
    def __init__(self, card: Card, plant: Plant, effort: int) -> None:
        self.card, self.plant = card, plant
        self.given = card.given()[card.letter]
        self.question = card.question(plant, {card.letter: self.given} if self.given is not None else {}, effort)
        self.objective: str = card.objective
        self.asked = self.question.with_rate(card.wanted_rate) if card.objective == "max_period" else self.question
        self.searches: Sequence[GainSearch] = ()

    def run(self) -> Design:
        hidden = unseen(self.plant)
        if self.given is not None:
            if hidden is not None and hidden.period is None:  # no period to look for
                return self._design("given", self.plant.sampling, self.given)
            law = self._longest_law() if self.objective == "max_period" else self.plant.sampling
            return self._certified("given", Candidate(self.given, law), ())
        if hidden is not None:
            return self._design("none", self.plant.sampling, None, reason=hidden.sentence(self.plant))
        reason = self.card.refuses(self.plant)
        return self._designed() if reason is None else self._without(reason)

    def _designed(self) -> Design:
        endless = self._endless() if self.objective == "max_period" else None
        if endless is not None:  # no period is too long: the best gain for the law that was typed
            self.objective = "given_period"
        self.searches = self.card.gain_searches(self.asked)
        try:
            candidates, reason = self._candidates(), self.card.why_nothing(self.asked)
        except NoDesignError as none:
            candidates, reason = [], str(none)
        law = self.plant.sampling
        serving = [one for one in candidates if law.T_max.is_at_most(one.law.T_max)]
        if serving:
            best = max(serving, key=lambda candidate: candidate.merit)
            design = self._certified("found", best, [one for one in serving if one is not best])
        else:
            design = self._short(candidates, reason)
        if endless is None:
            return design
        return replace(design, certificates=(*design.certificates, endless))

    def _endless(self) -> Certificate | None:
        """Why no period is too long: the error decays without samples, or every period has a gain of its own."""
        alone = OpenLoop.propose(self.asked.afresh())
        if alone is not None:
            return alone.certificate()
        chain = EveryPeriod.propose(self.asked)
        return chain.certificate() if chain is not None else None

    def _candidates(self) -> list[Candidate]:
        """Under given_period the first gain found, else one from each search."""
        if self.objective == "max_period":
            return [one for one in (way.longest(self.asked) for way in self.searches) if one is not None]
        if self.objective == "decay_rate":
            return [one for one in (way.fastest(self.question) for way in self.searches) if one is not None]
        first = next((met for met in (way.at(self.question) for way in self.searches) if met is not None), None)
        return [] if first is None else [first]

    def _short(self, candidates: list[Candidate], reason: str) -> Design:
        """The gain of the longest period met below the one asked for, under the law that was asked for."""
        law = self.plant.sampling
        if not candidates:
            nearest = (way.nearest(self.asked.afresh()) for way in self.searches)
            candidates = [one for one in nearest if one is not None]
        best = max(candidates, key=lambda candidate: float(candidate.law.T_max), default=None)
        if best is None:
            return self._without(reason)
        told = f"{reason}; the longest period met with a proof is {best.law.T_max}, whose gain is kept"
        costly = costliest(self.plant, self._quickly)
        advice = f"; {costly}" if costly is not None else ""
        return self._certified("short", replace(best, law=law), (), f"{told}{advice}")

    def _quickly(self, plant: Plant) -> float:
        """The longest period that a search at effort 0 reaches."""
        question = self.card.question(plant, {}, 0).with_rate(self.asked.rate)
        searches = self.card.gain_searches(question)[:1]
        met = (way.nearest(question) for way in searches)
        return max((float(one.law.T_max) for one in met if one is not None), default=0.0)

    def _without(self, reason: str) -> Design:
        beyond, details = self.card.beyond(self.question, ())
        return self._design("none", self.plant.sampling, None, beyond, details, reason)

    def _longest_law(self) -> SamplingLaw:
        """The longest law proved for the given gain at the rate asked for, the typed one at least."""
        law = self.plant.sampling
        if resets(self.asked.inclusion):
            return law
        laws = [law]
        for rung in self.card.rungs(self.asked):
            longest = rung.longest(self.asked.afresh(), self.card.rate_share)
            laws += [law.with_period(longest.law.T_max)] if longest is not None else []
        return max(laws, key=lambda one: float(one.T_max))

    def _certified(
        self, outcome: Outcome, best: Candidate, others: Iterable[Candidate], reason: str | None = None
    ) -> Design:
        letter = self.card.letter
        question = self.question.with_gain({letter: best.gain}).under(best.law)
        own = [best.method] if best.method is not None else []
        done = best.method.rung if best.method is not None else ""
        for rung in self.card.rungs(question):
            if rung.name != done:
                about = question.afresh()
                here = fastest(rung, about) if self.card.with_rates else rung.propose(about)
                own += [here] if here is not None else []
        if not (resets(question.inclusion) and any(isinstance(method, DeadBeat) for method in own)):
            for rung in self.card.rungs(question):
                if rung.name != done or self.objective != "max_period":
                    longest = rung.longest(question.afresh())
                    own += [longest] if longest is not None else []
        if (
            outcome != "short"
            and self.asked.rate
            and not any(method.prove(question).rate >= fraction_ball(self.asked.rate) for method in own)
        ):
            at_rate = question.with_rate(self.asked.rate)
            proposals = (rung.propose(at_rate.afresh()) for rung in self.card.rungs(at_rate))
            at_rate_proved = next((one for one in proposals if one is not None), None)
            own += [at_rate_proved] if at_rate_proved is not None else []
        certificates = [method.certificate() for method in own]
        certificates += [one.method.certificate({letter: one.gain}) for one in others if one.method is not None]
        certificates += accuracy.certificates(question)
        beyond, details = self.card.beyond(question, own)
        return self._design(outcome, best.law, best.gain, [*certificates, *beyond], details, reason)

    def _design(
        self,
        outcome: Outcome,
        law: SamplingLaw,
        gain: ExactMatrix | None,
        certificates: Iterable[Certificate] = (),
        details: Mapping[str, Any] | None = None,
        reason: str | None = None,
    ) -> Design:
        letter = self.card.letter
        kept: dict[str, Certificate] = {}
        for certificate in certificates:
            about = tuple(certificate.data.get(name) for name in (letter, "sigma", "state"))
            kept.setdefault(f"{certificate.method} {certificate.sampling} {about}", certificate)
        held = {} if gain is None else {letter: gain}
        return Design(self.card.name, outcome, law, held, tuple(kept.values()), None, reason, details=details or {})
