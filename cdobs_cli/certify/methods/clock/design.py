"""Gains for a correction at samples, by the convex form of the clock certificate."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import inf

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.climb import Climb
from cdobs_cli.certify.gains import Candidate, GainSearch, Merit
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.quiet_gains import least_error, quietest
from cdobs_cli.certify.methods.rung import GENERAL, fastest
from cdobs_cli.exact.numbers import ExactMatrix

_FASTEST = 8  # over the period: a rate beyond any design
_BISECTIONS = 14
_CLOSE = Fraction(1, 1000)
_BUDGET = 200  # proofs of a climb


class ImpulsiveGain(GainSearch):
    """K of e+ = (I - K C) e, with a clock certificate."""

    def at(self, question: Question) -> Candidate | None:
        return _candidate(question, design_impulsive(question.afresh()), 0.0)

    def longest(self, question: Question) -> Candidate | None:
        question = question.afresh()
        glance = question.with_effort(0)
        met = search.longest(
            lambda T: design_impulsive(question.at(T)), question.law.period, search.tolerance(question.effort),
            glance=lambda T: design_impulsive(glance.at(T)),
        )  # fmt: skip
        return _candidate(question, met, None, question.rate)

    def fastest(self, question: Question) -> Candidate | None:
        """Bisection on sigma, the decay rate of the clock certificate; then a climb from the gain found, by whatever
        proves its rate."""
        best = self.at(question)
        if best is None:
            return None
        T = question.law.T_max
        period = T.rational if T.rational is not None else Fraction(float(T)).limit_denominator(10**6)
        low, high = Fraction(0), Fraction(_FASTEST)
        for _ in range(_BISECTIONS):
            if high - low <= high * _CLOSE:
                break
            middle = Fraction(round((low + high) / 2 * 8192), 8192)
            sigma = middle / period
            trial = _candidate(question, design_impulsive(question.afresh().with_rate(sigma)), float(sigma), sigma)
            low, high, best = (low, middle, best) if trial is None else (middle, high, trial)
        return self._climbed(question, best)

    def quietest(self, question: Question) -> Candidate | None:
        return quietest(question)

    def least_error(
        self, question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None,
        near: ExactMatrix | None = None,
    ) -> Candidate | None:  # fmt: skip
        return least_error(question, merit, weights)

    def _climbed(self, question: Question, best: Candidate) -> Candidate:
        """A faster gain near by, where its proofs are quick (linear loops)."""
        if question.inclusion.quantities:
            return best

        def proof(K: ExactMatrix, sigma: float) -> Method | None:
            rate = search.short(sigma, 6).rational or Fraction(0)
            return GENERAL.propose(question.with_gain({"K": K}).with_rate(rate).afresh())

        method = fastest(GENERAL, question.with_gain({"K": best.gain}).afresh(), _CLOSE)
        if method is None or float(method.prove(question.with_gain({"K": best.gain})).rate) == inf:
            return best
        start = float(method.prove(question.with_gain({"K": best.gain})).rate.lower()) * 0.9999
        if not start > 0:
            return best
        size = np.abs(best.gain.floats)
        climb = Climb(lambda K, sigma: proof(K, sigma) is not None, np.full(size.shape, size.max()), _BUDGET)
        K, sigma = climb.run(best.gain.floats, start)
        final = proof(K, sigma)
        return best if final is None else Candidate(K, final.law, sigma, final)


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
