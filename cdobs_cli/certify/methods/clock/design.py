"""Gains for a correction at samples, by the convex form of the clock certificate."""

from __future__ import annotations

from fractions import Fraction

from cdobs_cli.certify import search
from cdobs_cli.certify.gains import Candidate, GainSearch
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.exact.numbers import ExactMatrix

_FASTEST = 8  # over the period: a rate beyond any design


class ImpulsiveGain(GainSearch):
    """K of e+ = (I - K C) e, with a clock certificate."""

    def at(self, question: Question) -> Candidate | None:
        return _candidate(question, design_impulsive(question.afresh()), 0.0)

    def longest(self, question: Question) -> Candidate | None:
        question = question.afresh()
        glance = question.with_effort(0)
        met = search.longest(
            lambda T: design_impulsive(question.at(T)), question.law.T_max, search.tolerance(question.effort),
            glance=lambda T: design_impulsive(glance.at(T)),
        )  # fmt: skip
        return _candidate(question, met, None, question.rate)

    def fastest(self, question: Question) -> Candidate | None:
        """Bisection on sigma, the decay rate of the clock certificate."""
        best = self.at(question)
        T = question.law.T_max
        if best is None:
            return None
        period = T.rational if T.rational is not None else Fraction(float(T)).limit_denominator(10**6)
        low, high = Fraction(0), Fraction(_FASTEST)
        for _ in range(5 + 2 * question.effort):
            middle = Fraction(round((low + high) / 2 * 1024), 1024)
            sigma = middle / period
            trial = _candidate(question, design_impulsive(question.afresh().with_rate(sigma)), float(sigma), sigma)
            low, high, best = (low, middle, best) if trial is None else (middle, high, trial)
        return best


def _candidate(
    question: Question,
    met: tuple[ExactMatrix, Method] | None,
    merit: float | None = None,
    sigma: Fraction = Fraction(0),
) -> Candidate | None:
    """The gain with C K = I nearest to the one met, where that is proved too: such a gain loses nothing, and only one
    that keeps it exactly is reduced to ker C."""
    if met is None:
        return None
    K, certificate = met
    nearest = kernel(question.plant.C).nearest(K)
    about = question.with_gain({"K": nearest}).under(certificate.law).with_rate(sigma)
    kept = certificate if certificate.prove(about).holds else GENERAL.propose(about.afresh())
    if kept is not None:
        return Candidate.of((nearest, kept), merit)
    return Candidate.of(met, merit)
