"""Linear loops at one constant period: rho(J exp(A T)) < 1, exactly the condition of convergence.

Stability may be lost and regained as the period grows: `linear.stable_intervals` lists where it holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.certify.linear import is_linear, stable_interval
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.texts import rate_of
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import fraction_text


@dataclass(frozen=True)
class SpectralRadius(Method):
    """It holds the rate only: the proof is the spectral radius itself. Loads no solver."""

    sigma: str

    name: ClassVar[str] = "spectral_radius"
    rung: ClassVar[str] = "clock"
    source: ClassVar[str] = "spectral radius of the sampled error"
    how: ClassVar[str] = "powers of the map in balls"
    statement: ClassVar[str] = "The error of one period has a spectral radius below 1"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_linear(question.inclusion)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        radius = cls(question.law, fraction_text(question.rate))
        return radius if cls.applies(question) and radius.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        """rho(J exp(A T) exp(sigma T)) < 1."""
        sigma, law = rate_of(self.sigma), self.law
        if question.inclusion.quantities or not (law.is_periodic and law.is_bounded):
            return NOTHING
        maps = question.inclusion.balls
        Phi = (maps.base + Matrix.identity(maps.base.shape[0]) * sigma).exp(law.T_max.scalar)
        return Proof.of(has_spectral_radius_below(maps.jump @ Phi), sigma)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """At rate 0: the end of the proved interval of periods that holds the question's own, else of the first."""
        T = question.law.T_max
        chosen = stable_interval(question.inclusion, float(T), float(T) / 1000, float(T) * 20)
        return None if chosen is None else cls.propose(question.at(chosen.high))
