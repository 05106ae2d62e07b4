"""The objectives, once for every family with a constant gain: the gain, its law, and a certificate for each thing
worth proving of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from itertools import islice
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from flint import arb

from cdobs_cli import progress
from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import accuracy, judge, search
from cdobs_cli.certify.front import front
from cdobs_cli.certify.gains import Candidate, GainSearch, NoDesignError
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.dead_beat import DeadBeat, EveryPeriod, resets
from cdobs_cli.certify.methods.mean_square.aim import scales
from cdobs_cli.certify.methods.open_loop import OpenLoop, Uncorrected
from cdobs_cli.certify.methods.rung import Rung, fastest
from cdobs_cli.certify.reasons import costliest, unreachable
from cdobs_cli.certify.refutations import refutations
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.design import Design, FrontPoint, Outcome
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text, upper_text
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

_COARSE = Fraction(1, 20)
# `Question.work` up to which a gain of less error is looked for near by, by effort.
_CLOSER = (0, 200, 1_000, 10_000)


class Beyond(NamedTuple):
    """What a design keeps besides its own: certificates of other gains and laws that no gain survives, the report's
    details, the front where a family has one of its own."""

    certificates: Sequence[Certificate] = ()
    details: Mapping[str, Any] = MappingProxyType({})
    front: tuple[FrontPoint, ...] = ()


class Card(judge.Card, Protocol):
    """What is asked of a family's card.

    rate_share: under max_period the rate is at least this over the period. with_rates: whether the certificate kept
    for the law is the fastest that is found. error_at_most: by state, what is asked of its error under noise. weights:
    by state, of its error; all where none is typed.
    """

    objective: Any
    rate_share: ClassVar[float]
    with_rates: ClassVar[bool]

    error_at_most: Any
    weights: Any

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

    def beyond(self, question: Question, own: Sequence[Method]) -> Beyond:
        """What else is worth keeping."""


def synthesize(card: Card, plant: Plant, effort: int) -> Design:
    """The given gain or one found for the objective, with its certificates; outcome `none` with a reason where no gain
    is found. Uses the solver."""
    with np.errstate(all="ignore"):  # what overflows in a search is no guess
        made = _Synthesis(card, plant, effort)
        try:
            with progress.searching():
                return made.run()
        except progress.TimeIsUp:
            return made.best_so_far()


def finished(card: Card, plant: Plant, design: Design, effort: int) -> Design:
    """A design with what is worth knowing of it, once it is the one that is kept: certificates of how large its error
    stays under the declared noise and disturbance, what is refuted of it, and the front. Uses the solver."""
    with np.errstate(all="ignore"):
        made = _Synthesis(card, plant, effort)
        made.design = design
        with suppress(progress.TimeIsUp), progress.searching():
            made.finish()
        return made.design


_TIME = "the time for searches ended (--time-limit)"


class _Synthesis:
    def __init__(self, card: Card, plant: Plant, effort: int) -> None:
        self.card, self.plant = card, plant
        self.given = card.given()[card.letter]
        self.question = card.question(plant, {card.letter: self.given} if self.given is not None else {}, effort)
        self.objective: str = card.objective
        keeps_rate = card.objective in ("max_period", "min_error")
        self.asked = self.question.with_rate(card.wanted_rate) if keeps_rate else self.question
        self.searches: Sequence[GainSearch] = ()
        # What there is by now: candidates met, certificates of the gain that is kept, and the design to be finished.
        self.met: list[Candidate] = []
        self.own: list[Method] = []
        self.design: Design | None = None

    def best_so_far(self) -> Design:
        """Where the time for searches is over: the best candidate that was met, with the certificates found for it."""
        longest = self.plant.sampling.period
        serving = [one for one in self.met if longest.is_at_most(one.law.period)]
        best = max(serving or self.met, key=lambda one: one.merit, default=None)
        if best is None and self.given is not None:
            return self._design("given", self.plant.sampling, self.given, [one.certificate() for one in self.own])
        if best is None:
            return self._design("none", self.plant.sampling, None, reason=_TIME)
        if not self.own:
            self.own = [best.method] if best.method is not None else self._proofs(best)
        certificates = [method.certificate() for method in self.own]
        if self.given is not None:
            return self._design("given", best.law, best.gain, certificates)
        law = best.law if serving else self.plant.sampling
        return self._design("found" if serving else "short", law, best.gain, certificates, reason=_TIME)

    def _quick_candidates(self) -> list[Candidate]:
        """A gain found with little effort, at the law asked for or a shorter one; none where there is none."""
        question = self.asked.with_effort(0).afresh()
        for way in self.card.gain_searches(question):
            for find in (way.at, way.nearest):
                with suppress(NoDesignError):
                    candidate = find(question)
                    if candidate is not None:
                        return [candidate]
        return []

    def _proofs(self, best: Candidate) -> list[Method]:
        question = self.question.with_gain({self.card.letter: best.gain}).under(best.law)
        proposals = (rung.propose(question) for rung in self.card.rungs(question))
        return list(islice((one for one in proposals if one is not None), 1))

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
        slow = unreachable(self.plant, float(self.asked.rate))
        if slow is not None:
            self.asked = self.question
        self.searches = self.card.gain_searches(self.asked)
        if progress.is_limited():  # first of all something, then something good
            self.met = self._quick_candidates()
        serving, shorter, reason = self._met()
        if not (serving or shorter) and self.asked.rate:
            slow, self.asked = f"{reason}, at the rate {fraction_text(self.asked.rate)}", self.question
            serving, shorter, reason = self._met()
        if not (serving or shorter):
            serving = self._uncorrected()
        if serving:
            best = max(serving, key=lambda candidate: candidate.merit)
            others = [one for one in serving if one is not best]
            told = None if slow is None else f"{slow}; the gain kept is the one of the longest period at any rate"
            design = self._certified("found" if slow is None else "short", best, others, told)
        else:
            design = self._short(shorter, reason if slow is None else f"{slow}; {reason}")
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
        """One from each search; under given_period where none of them weighs noise the first gain found."""
        if self.objective == "max_period":
            longest = self._longest_within if self.card.error_at_most else lambda way: way.longest(self.asked)
            return self._found(longest)
        if self.objective == "decay_rate":
            return self._found(lambda way: way.fastest(self.question))
        return self._found(lambda way: self._quiet(way, self.asked)) or self._found(lambda way: way.at(self.asked))[:1]

    def _found(self, make: Callable[[GainSearch], Candidate | None]) -> list[Candidate]:
        """One from each search that finds one."""
        found = []
        progress.doing(f"looking for a gain, sampling {self.asked.law.words}")
        for way in self.searches:
            candidate = make(way)
            if candidate is not None:
                found.append(candidate)
                self.met.append(candidate)
        return found

    def _quiet(self, way: GainSearch, question: Question, near: ExactMatrix | None = None) -> Candidate | None:
        """The gain of least error under what is declared, else the one that amplifies noise least."""
        if not self.plant.is_perturbed:
            return way.quietest(question)
        # White signals have their least mean square by a convex search; of bounded ones a gain near by is better.
        closer = self.plant.has_only_bounded and question.work <= _CLOSER[question.level]
        return way.least_error(question, accuracy.merit(self._weights) if closer else None, self._weights, near)

    @cached_property
    def _weights(self) -> tuple[float, ...]:
        """Of each state: as typed, else 1 / scale^2 under the law that was typed, so that periods are weighed alike."""
        typed = self.card.weights
        if typed is None:
            return tuple(1 / float(scale) ** 2 for scale in scales(self.question))
        return tuple(float(typed.get(name, 0)) for name in self.plant.states)

    def _longest_within(self, way: GainSearch) -> Candidate | None:
        """The gain of the longest period whose least error is small enough."""

        def within(T: Exact) -> Candidate | None:
            candidate = self._quiet(way, self.asked.at(T))
            if candidate is None:
                return None
            about = self.asked.at(T).with_gain({self.card.letter: candidate.gain})
            return None if self._exceeded(accuracy.of_states(about)) else replace(candidate, merit=float(T))

        return search.longest(within, self.plant.sampling.period, search.tolerance(self.question.effort))

    def _exceeded(self, proved: Mapping[str, arb]) -> str | None:
        """What is above `error_at_most`, or not proved, by the bounds of the states' errors; None where nothing is."""
        told = []
        for state, most in (self.card.error_at_most or {}).items():
            least = proved.get(state)
            if least is None or not least <= most.ball():
                by = "none is proved" if least is None else f"{upper_text(least, 6)} is proved"
                told.append(f"|e_{state}| <= {most} was asked for and {by}")
        return "; ".join(told) or None

    def _met(self) -> tuple[list[Candidate], list[Candidate], str]:
        """The candidates that serve the law asked for; where there are none, those for shorter periods, and why."""
        try:
            candidates, reason = self._candidates(), self.card.why_nothing(self.asked)
        except NoDesignError as none:
            candidates, reason = [], str(none)
        longest = self.plant.sampling.period
        serving = [one for one in candidates if longest.is_at_most(one.law.period)]
        if not candidates:
            candidates = self._found(lambda way: way.nearest(self.asked.afresh()))
        return serving, [] if serving else candidates, reason

    def _uncorrected(self) -> list[Candidate]:
        """The gain 0, where the error decays by itself and no other gain was found."""
        rows, columns = self.plant.gain_shape
        zero = ExactMatrix([[0] * columns for _ in range(rows)])
        method = Uncorrected.propose(self.asked.with_gain({self.card.letter: zero}).afresh())
        return [] if method is None else [Candidate(zero, self.plant.sampling, 0.0, method)]

    def _short(self, shorter: list[Candidate], reason: str) -> Design:
        """The gain of the longest period met below the one asked for, under the law that was asked for."""
        law = self.plant.sampling
        best = max(shorter, key=lambda candidate: float(candidate.law.period), default=None)
        if best is None:
            return self._without(reason)
        told = f"{reason}; the longest period met with a proof is {best.law.period}, whose gain is kept"
        costly = costliest(self.plant, self._quickly)
        advice = f"; {costly}" if costly is not None else ""
        return self._certified("short", replace(best, law=law), (), f"{told}{advice}")

    def _quickly(self, plant: Plant) -> float:
        """The longest period that a search at effort 0 reaches."""
        question = self.card.question(plant, {}, 0).with_rate(self.asked.rate)
        searches = self.card.gain_searches(question)[:1]
        met = (way.nearest(question) for way in searches)
        return max((float(one.law.period) for one in met if one is not None), default=0.0)

    def _without(self, reason: str) -> Design:
        beyond = self.card.beyond(self.question, ())
        return self._design("none", self.plant.sampling, None, beyond.certificates, beyond.details, reason)

    def _longest_law(self) -> SamplingLaw:
        """The longest law proved for the given gain at the rate asked for, the typed one at least."""
        law = self.plant.sampling
        if resets(self.asked.inclusion):
            return law
        laws = [law]
        for rung in self.card.rungs(self.asked):
            longest = rung.longest(self.asked.afresh(), self.card.rate_share)
            laws += [law.with_period(longest.law.period)] if longest is not None else []
        return max(laws, key=lambda one: float(one.period))

    def _certified(
        self, outcome: Outcome, best: Candidate, others: Iterable[Candidate], reason: str | None = None
    ) -> Design:
        letter = self.card.letter
        question = self.question.with_gain({letter: best.gain}).under(best.law)
        self.met = [best]
        self.own = own = [best.method] if best.method is not None else []
        done = best.method.rung if best.method is not None else ""
        at_rest = best.method is not None and not best.method.prove(question).rate > 0
        for rung in self.card.rungs(question):
            if rung.name == done and at_rest:  # of a gain for little noise some rate is worth knowing
                decaying = fastest(rung, question.afresh(), _COARSE)
                own[:] = [decaying] if decaying is not None else own
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
        return self._design(outcome, best.law, best.gain, certificates, reason=reason)

    def finish(self) -> None:
        """With what else is worth keeping, how large the error stays under what is declared, what is refuted, and what
        other periods are worth."""
        design, letter = self.design, self.card.letter
        if design is None or design.outcome == "none" or letter not in design.gain or progress.is_late():
            return
        question = self.question.with_gain({letter: design.gain[letter]}).under(design.sampling)
        known = judge.judgement_of(self.card, self.plant, design, question.effort)
        beyond = self.card.beyond(question, [item.method for item in known.converging if item.own and item.proof.holds])
        kept = self._distinct([*design.certificates, *beyond.certificates])
        self.design = replace(design, certificates=kept, details=beyond.details, front=beyond.front)
        sizes = accuracy.sized(question)
        self._keep(*(sized.method for sized in sizes))
        exceeded = self._exceeded(accuracy.by_state(sizes)) if self.given is None else None
        if exceeded is not None:
            reason = exceeded if design.reason is None else f"{design.reason}; {exceeded}"
            self.design = replace(self._kept, outcome="short", reason=reason)
        for method in refutations(judge.judgement_of(self.card, self.plant, self._kept, question.effort)):
            self._keep(method)
        if not beyond.front and question.level:
            self.searches = self.card.gain_searches(self.asked)
            self.design = replace(self._kept, front=self._front(question, design.gain[letter]))

    @property
    def _kept(self) -> Design:
        assert self.design is not None
        return self.design

    def _keep(self, *methods: Method) -> None:
        certificates = (*self._kept.certificates, *(method.certificate() for method in methods))
        self.design = replace(self._kept, certificates=certificates)

    def _front(self, question: Question, own: ExactMatrix) -> tuple[FrontPoint, ...]:
        """Where a gain was looked for, and periods, rates or errors are what it is about."""
        if self.plant.sampling.is_on_change:  # there is no period to choose
            return ()
        if self.given is not None or not (self.plant.is_perturbed or self.objective in ("max_period", "decay_rate")):
            return ()

        def find(about: Question) -> Candidate | None:
            ways = (
                self._quiet(way, about, own) if self.plant.is_perturbed else way.fastest(about) for way in self.searches
            )
            return next((one for one in ways if one is not None), None)

        return front(question, self.card.letter, find, own)

    def _design(
        self,
        outcome: Outcome,
        law: SamplingLaw,
        gain: ExactMatrix | None,
        certificates: Iterable[Certificate] = (),
        details: Mapping[str, Any] | None = None,
        reason: str | None = None,
    ) -> Design:
        held = {} if gain is None else {self.card.letter: gain}
        kept = self._distinct(certificates)
        return Design(self.card.name, outcome, law, held, kept, None, reason, details=details or {})

    def _distinct(self, certificates: Iterable[Certificate]) -> tuple[Certificate, ...]:
        """Of each method, law, gain, rate and state the first."""
        kept: dict[str, Certificate] = {}
        for certificate in certificates:
            about = tuple(certificate.data.get(name) for name in (self.card.letter, "sigma", "state"))
            kept.setdefault(f"{certificate.method} {certificate.sampling} {about}", certificate)
        return tuple(kept.values())
