"""Gains for sensors with periods of their own, by the convex form of the certificate over a cycle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.gains import Candidate, GainSearch
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import GAIN_DIGITS
from cdobs_cli.certify.methods.clock.cycle import ClockCycle, shapes
from cdobs_cli.certify.methods.clock.cycle_search import free_gains, in_common, pose
from cdobs_cli.certify.methods.clock.form import CycleShape
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.numbers import Exact, ExactMatrix

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_RATE_WIDTH, _RATE_DIGITS = Fraction(1, 100), 6


def design_cycle(question: Question, letter: str = "K") -> tuple[ExactMatrix, Method] | None:
    """Gains of all samples side by side for the jumps e+ = (I - K_q C_q) e, with a proved certificate, or None.

    They come rounded to GAIN_DIGITS significant digits, and what is proved is about these. Uses the solver."""
    for shape in shapes(question):
        for gains in _guesses(question, shape):
            rounded = ExactMatrix.from_floats(np.hstack(gains), GAIN_DIGITS)
            closed = question.with_gain({letter: rounded})
            certificate = SpectralRadius.propose(closed) or _certificate(closed, shape)
            if certificate is not None and certificate.prove(closed).holds:
                return rounded, certificate
    return None


def _guesses(question: Question, shape: CycleShape) -> Iterator[list[Array]]:
    """Of each sample the gain that the solver proposes. Where samples have one gain in common, which is sufficient
    only, then what is alike of the gains that each would have for itself."""
    law = question.law
    yield from _proposed(question, shape)
    if any(gain.is_shared for gain in free_gains(law, 1)):
        apart = question.under(replace(law, gains="by_phase"))
        for gains in _proposed(apart, shape):
            yield from in_common(gains, law)


def _proposed(question: Question, shape: CycleShape) -> Iterator[list[Array]]:
    posed = pose(question, shape, given=False)
    solution = None if posed is None else posed.solve(question)
    gains = [] if posed is None or solution is None else posed.gains(solution)
    if gains:
        yield gains


def _certificate(closed: Question, shape: CycleShape) -> Method | None:
    return ClockCycle.guess(closed, shape) if ClockCycle.applies(closed) else None


class CycleGain(GainSearch):
    """K_q of e+ = (I - K_q C_q) e at the samples of a hyperperiod."""

    def at(self, question: Question) -> Candidate | None:
        return Candidate.of(design_cycle(question.afresh()), 0.0)

    def longest(self, question: Question) -> Candidate | None:
        question = question.afresh()
        glance = question.with_effort(0)
        return Candidate.of(
            search.longest(
                lambda T: design_cycle(question.at(T)), question.law.period, search.tolerance(question.effort),
                glance=lambda T: design_cycle(glance.at(T)),
            )
        )  # fmt: skip

    def fastest(self, question: Question) -> Candidate | None:
        """By bisection on the rate."""
        first = search.short(0.5 / float(question.law.T_max), _RATE_DIGITS)

        def at_rate(sigma: Exact) -> Candidate | None:
            about = question.afresh().with_rate(sigma.rational or Fraction(0))
            return Candidate.of(design_cycle(about), float(sigma))

        return search.longest(at_rate, first, _RATE_WIDTH, digits=_RATE_DIGITS) or self.at(question)
