"""Gains for sensors with periods of their own, by the convex form of the certificate over a timed graph."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from math import log
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.gains import Candidate, GainSearch, Merit
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import GAIN_DIGITS
from cdobs_cli.certify.methods.clock.form import GraphShape
from cdobs_cli.certify.methods.clock.graph import ClockGraph, shapes
from cdobs_cli.certify.methods.clock.graph_aim import GraphAim, aimed
from cdobs_cli.certify.methods.clock.graph_search import free_gains, in_common, pose
from cdobs_cli.certify.methods.mean_square.aim import Aim
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.numbers import Exact, ExactMatrix

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_RATE_WIDTH, _RATE_DIGITS = Fraction(1, 100), 6
_QUICK_WIDTH, _SPAN = Fraction(1, 10), 1000  # of the search for the rate half of which is asked for
_PARTS = (Fraction(1, 4), Fraction(1, 2))
_SLOW = 50  # longest periods in which the error falls to 1 % at least, where no disturbance keeps a gain from vanishing


def design_graph(question: Question, letter: str = "K") -> tuple[ExactMatrix, Method] | None:
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


def _guesses(question: Question, shape: GraphShape) -> Iterator[list[Array]]:
    """Of each sample the gain that the solver proposes. Where samples have one gain in common, which is sufficient
    only, then what is alike of the gains that each would have for itself."""
    law = question.law
    yield from _proposed(question, shape)
    if any(len(gain.readings) > 1 for gain in free_gains(law, 1)):
        apart = question.under(replace(law, gains="by_phase"))
        for gains in _proposed(apart, shape):
            yield from in_common(gains, law)


def _proposed(question: Question, shape: GraphShape) -> Iterator[list[Array]]:
    posed = pose(question, shape, given=False)
    solution = None if posed is None else posed.solve(question)
    gains = [] if posed is None or solution is None else posed.gains(solution)
    if gains:
        yield gains


def _certificate(closed: Question, shape: GraphShape) -> Method | None:
    return ClockGraph.guess(closed, shape) if ClockGraph.applies(closed) else None


def quiet_graph(question: Question, aim: GraphAim, letter: str = "K") -> tuple[ExactMatrix, Method] | None:
    """Gains that let least through, at the question's rate, rounded, with a certificate; or None. Uses the solver."""
    for shape in list(shapes(question))[-2:]:
        posed = aimed(question, shape, aim, given=False)
        solution = None if posed is None else posed.solve(question)
        gains = [] if posed is None or solution is None else posed.gains(solution)
        if gains:
            rounded = ExactMatrix.from_floats(np.hstack(gains), GAIN_DIGITS)
            closed = question.with_gain({letter: rounded})
            certificate = SpectralRadius.propose(closed) or ClockGraph.propose(closed)
            if certificate is not None:
                return rounded, certificate
    return None


class GraphGain(GainSearch):
    """K of e+ = (I - K C) e at what is read on each edge of a timed graph."""

    def at(self, question: Question) -> Candidate | None:
        return Candidate.of(design_graph(question.afresh()), 0.0)

    def longest(self, question: Question) -> Candidate | None:
        question = question.afresh()
        glance = question.with_effort(0)
        return Candidate.of(
            search.longest(
                lambda T: design_graph(question.at(T)), question.law.period, search.tolerance(question.effort),
                glance=lambda T: design_graph(glance.at(T)),
            )
        )  # fmt: skip

    def fastest(self, question: Question) -> Candidate | None:
        """By bisection on the rate."""
        first = search.short(0.5 / float(question.law.T_max), _RATE_DIGITS)

        def at_rate(sigma: Exact) -> Candidate | None:
            about = question.afresh().with_rate(sigma.rational or Fraction(0))
            return Candidate.of(design_graph(about), float(sigma))

        return search.longest(at_rate, first, _RATE_WIDTH, digits=_RATE_DIGITS) or self.at(question)

    def quietest(self, question: Question) -> Candidate | None:
        """Of white noise R = I, errors weighted by 1 / scale^2, at half of the fastest rate that is found, at most that
        of an error that falls to 1 % in n of the longest periods."""
        found = self._half_of_fastest(question)
        if found is None:
            return None
        half = max(question.rate, found)
        aim = Aim.quiet(question, float(half))
        return self._quiet(question.with_rate(half), aim)

    def least_error(
        self, question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None,
        near: ExactMatrix | None = None,
    ) -> Candidate | None:  # fmt: skip
        """The gain of least mean square over time under what is declared, bounded signals as if uniform; where no
        disturbance keeps a gain from vanishing at a slow rate. By a merit the best of these at rates up to parts of the
        fastest: bounds of bounded signals are closer at fast rates."""
        aim = Aim.declared(question, weights, float(question.rate))
        if not (aim.R.any() or aim.Q.any()):
            return None
        H = float(question.law.base) * float(max(one.every for one in question.law.sensors))
        slow = search.short(log(100) / (_SLOW * H), _RATE_DIGITS).rational or Fraction(0)
        rates = (question.rate,) if aim.Q.any() else (max(question.rate, slow), question.rate)
        made = (self._quiet(question.with_rate(sigma), aim) for sigma in rates)
        first = next((one for one in made if one is not None), None)
        if merit is None:
            return first
        fastest = self._half_of_fastest(question)
        further = [2 * fastest * part for part in _PARTS if fastest and 2 * fastest * part > question.rate]
        candidates = [first, *(self._quiet(question.with_rate(sigma), aim) for sigma in further)]
        weighed = [
            (size, number, one)
            for number, one in enumerate(candidates)
            if one is not None and (size := merit(question.with_gain({"K": one.gain}))) is not None
        ]
        return min(weighed)[2] if weighed else first

    def _half_of_fastest(self, question: Question) -> Fraction | None:
        """Half of the fastest rate that is found, at most that of an error that falls to 1 % in n of the longest
        periods."""
        plant, H = question.plant, float(question.law.base) * float(max(one.longest for one in question.law.sensors))
        cap = search.short(log(100) / (plant.n * H), _RATE_DIGITS)
        quick = question.with_effort(0).afresh()
        low = search.short(float(cap) / _SPAN, _RATE_DIGITS)
        met = search.between(lambda sigma: self._at_rate(quick, sigma), low, cap, _QUICK_WIDTH, _RATE_DIGITS)
        return None if met is None else (met[0].rational or Fraction(0)) / 2

    def _at_rate(self, question: Question, sigma: Exact) -> Candidate | None:
        return Candidate.of(design_graph(question.with_rate(sigma.rational or Fraction(0))), 0.0)

    def _quiet(self, question: Question, aim: Aim) -> Candidate | None:
        of_flow = GraphAim(aim.R, aim.Q, aim.Z, np.zeros_like(aim.Z))
        return Candidate.of(quiet_graph(question.afresh(), of_flow), 0.0)
