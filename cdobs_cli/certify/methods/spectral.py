"""Linear loops at one constant period: rho(J exp(A T)) < 1, exactly the condition of convergence; of sensors with
periods of their own the same of the map over a hyperperiod.

Stability may be lost and regained as the period grows: `linear.stable_intervals` lists where it holds.
"""

from __future__ import annotations

from typing import ClassVar, Self

from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.certify.linear import is_linear, product, stable_ends, stable_interval
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.texts import rate_of
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import fraction_text
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class SpectralRadius(Method):
    """It holds the rate only: the proof is the spectral radius itself. Loads no solver."""

    sigma: str

    name: ClassVar[str] = "spectral_radius"
    rung: ClassVar[str] = "clock"
    source: ClassVar[str] = "spectral radius of the sampled error"
    how: ClassVar[str] = "powers of the map in balls"
    statement: ClassVar[str] = "The error of one period has a spectral radius below 1"
    multirate: ClassVar[bool] = True

    @property
    def sentence(self) -> str:
        return self.statement.replace("one period", "one hyperperiod") if self.law.is_multirate else self.statement

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_linear(question.inclusion)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        radius = cls(question.law, fraction_text(question.rate))
        return radius if cls.applies(question) and radius.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        """rho(J exp(A T) exp(sigma T)) < 1; over a hyperperiod rho(J_0 Phi_(Q-1) .. J_1 Phi_0) < 1 of these Phi."""
        sigma, law = rate_of(self.sigma), self.law
        if not is_linear(question.inclusion) or law.T_max.sign() != 1:
            return NOTHING
        phases = question.inclusion.phases_balls
        shifted = phases[0].base + Matrix.identity(phases[0].base.shape[0]) * sigma
        gaps = law.gaps or (law.T_max,)
        Phi = {gap: shifted.exp(gap.scalar) for gap in dict.fromkeys(gaps)}
        M = product((Phi[gap] for gap in gaps), [maps.jump for maps in phases])
        return Proof.of(has_spectral_radius_below(M), sigma)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """At rate 0: the end of the interval of periods that holds the question's own, else of the first; of one period
        for all outputs of an interval that is proved as a whole."""
        T = float(question.law.period)
        if question.law.is_multirate:
            ends = stable_ends(question.inclusion, T, T / 1000, T * 20)
            return next((one for end in ends if (one := cls.propose(question.at(end))) is not None), None)
        chosen = stable_interval(question.inclusion, T, T / 1000, T * 20)
        return None if chosen is None else cls.propose(question.at(chosen.high))
