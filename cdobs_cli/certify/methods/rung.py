"""A rung of the ladder: methods that answer the same question in different cases, the first that proves decides."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Protocol

from cdobs_cli import progress
from cdobs_cli.certify import search
from cdobs_cli.certify.linear import is_linear, is_linear_loop
from cdobs_cli.certify.methods import named
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock import edges
from cdobs_cli.certify.methods.clock.certificate import Clock
from cdobs_cli.certify.methods.common_quadratic import longest_aperiodic
from cdobs_cli.certify.methods.dead_beat import DeadBeat, resets
from cdobs_cli.certify.methods.named import Known
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass

_RATE_WIDTH = Fraction(1, 200)
_RATE_DIGITS = 6


class Rung(Protocol):
    """What is asked of a line of the ladder."""

    @property
    def name(self) -> str: ...

    def propose(self, question: Question) -> Method | None:
        """A proved certificate at the question's law and rate."""

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        """The certificate of the longest period found for the question's gain, at the question's rate and at least the
        rate `share` over the period."""

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        """The certificate of the largest rate found under the question's own law, to a relative width."""


@dataclass(frozen=True)
class One:
    """A rung of one method."""

    method: type[Method]

    @property
    def name(self) -> str:
        return self.method.rung

    def propose(self, question: Question) -> Method | None:
        return told(lambda: self.method.propose(question) if self._applies(question) else None, self.name, question)

    def _applies(self, question: Question) -> bool:
        return self.method.takes_law(question.law) and self.method.applies(question)

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        return longest_at(self, question, share) if share or question.rate else self.method.longest(question)

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        return fastest_at(self, question, width)


@dataclass(frozen=True)
class General:
    """The certificates that need no structure: a dead beat needs no search; a linear error system sampled
    periodically is decided by its spectral radius, under an interval of periods by forms of its sampled error; else
    the clock-dependent function."""

    name: str = "clock"
    methods: tuple[Known, ...] = named.GENERAL

    def propose(self, question: Question) -> Method | None:
        asked = (
            method
            for method in named.loaded(self.methods)
            if method.takes_law(question.law) and method.applies(question)
        )
        proposals = (method.propose(question) for method in asked)
        return told(lambda: next((one for one in proposals if one is not None), None), self.name, question)

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        if _is_left_to_the_clock(question):
            return edges.longest(question, share)
        if share or question.rate:
            return longest_at(self, question, share)
        if resets(question.inclusion) and question.law.is_bounded:
            return DeadBeat.longest(question)
        if is_linear(question.inclusion):
            return SpectralRadius.longest(question)
        if is_linear_loop(question) and question.inclusion.balls.jump.is_rational:
            return longest_aperiodic(self.propose, question)
        return longest_at(self, question)

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        if _is_left_to_the_clock(question):
            return edges.fastest(question, width) or self.propose(question.with_rate(Fraction(0)))
        return fastest_at(self, question, width)


def _is_left_to_the_clock(question: Question) -> bool:
    """Whether of the general certificates only the clock-dependent function can hold."""
    asked = Clock.takes_law(question.law) and Clock.applies(question)
    return asked and not is_linear_loop(question) and not resets(question.inclusion)


GENERAL = General()


def told(propose: Callable[[], Method | None], name: str, question: Question) -> Method | None:
    """What is proposed; whoever waits is told what is tried, and what is proved."""
    rate = f" at rate {float(question.rate):.4g}" if question.rate else ""
    words = f"{name}, T = {float(question.law.period):.6g}{rate}"
    progress.doing(words)
    method = propose()
    if method is not None:
        progress.proved(words)
    return method


def longest_at(rung: Rung, question: Question, share: float = 0.0, *, quick: bool = False) -> Method | None:
    """The certificate of the longest period found, at the question's rate and at least the rate `share` over the
    period; unless its proofs are quick, the walk is at effort 0."""

    def prove(about: Question) -> Callable[[Exact], Method | None]:
        return lambda T: rung.propose(about.at(T).with_rate(max(about.rate, rate_over(T, share))))

    glance = None if quick else prove(question.with_effort(0))
    width = search.tolerance(question.effort, quick=quick)
    return search.longest(prove(question), question.law.period, width, glance=glance)


def rate_over(T: Exact, share: float) -> Fraction:
    """The rate `share` over a period, in six digits."""
    return search.short(share / float(T), _RATE_DIGITS).rational or Fraction(0) if share else Fraction(0)


def fastest(rung: Rung, question: Question, width: Fraction = _RATE_WIDTH) -> Method | None:
    """The certificate of the largest rate found under the question's own law."""
    return rung.fastest(question, width)


def fastest_at(rung: Rung, question: Question, width: Fraction) -> Method | None:
    """By bisection, of proofs that a rung proposes."""
    at_rest = rung.propose(question.with_rate(Fraction(0)))
    if at_rest is None or float(at_rest.prove(question).rate) == float("inf"):
        return at_rest

    def prove(sigma: Exact) -> Method | None:
        return rung.propose(question.with_rate(sigma.rational or Fraction(0)))

    first = search.short(0.5 / float(question.law.T_max), _RATE_DIGITS)
    return search.longest(prove, first, width, digits=_RATE_DIGITS) or at_rest
