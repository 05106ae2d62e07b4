"""The error bound of one state under bounded disturbance and noise, for laws with T_min > 0: chains of quadratic
functions of the last sampling intervals, one for each window of the time since the last sample."""

from __future__ import annotations

from dataclasses import field
from fractions import Fraction
from typing import Any, ClassVar, Self

from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.peak.chain import Chain
from cdobs_cli.certify.methods.peak.signals import exact_signals
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.certify.methods.peak.state import (
    PeakOfState,
    before_first_sample,
    number_of,
    start_box,
    start_texts,
    unit,
)
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Peak(PeakOfState):
    """chains: their windows cover all times between samples."""

    state: str
    chains: list[Chain]
    start: list[list[str]] | None = field(default=None, metadata={OPTIONAL: True})

    name: ClassVar[str] = "peak"
    source: ClassVar[str] = "clock-dependent Lyapunov functions of the last intervals"
    nonlinear_outputs: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        return cls.takes(question) and question.law.T_min.sign() == 1

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound found for the error of the question's state. The memory keeps rho of the tail."""
        if question.state is None or not cls.applies(question):
            return None
        from cdobs_cli.certify.methods.peak.proposal import chains_of

        chains = chains_of(question, question.state)
        if chains is None:
            return None
        proposal = cls(question.law, str(question.state), chains, start_texts(question.start))
        return proposal if proposal.prove(question).holds else None

    @classmethod
    def error_guess(cls, question: Question) -> float | None:
        from cdobs_cli.certify.methods.peak.proposal import guess_of

        return None if question.state is None or not cls.applies(question) else guess_of(question, question.state)

    def _prove(self, question: Question) -> Proof:
        inclusion = question.inclusion
        if not self.applies(question) or not _covers([chain.shares for chain in self.chains]):
            return NOTHING
        maps, signals = inclusion.balls, exact_signals(inclusion)
        i, start = number_of(self.state, question.plant), start_box(self.start, question.plant)
        first = None if start is None else first_vertices(maps, signals, start)
        if start is not None and first is None:
            return NOTHING
        largest, z = arb(0), unit(maps.base.shape[0], i)
        for chain in self.chains:
            squared = chain.bound_squared(maps, signals, z, self.law, first)
            if squared is None:
                return NOTHING
            largest = largest.max(squared)
        error = largest.sqrt()
        return Proof(True, error=error if start is None else error.max(before_first_sample(start, i)))

    def certificate(self, gain: Any = None) -> Certificate:
        written = super().certificate(gain)
        plain = {"chains": [chain.document() for chain in self.chains]}
        return Certificate(written.method, written.sampling, written.data | plain)


def _covers(windows: list[tuple[Fraction, Fraction]]) -> bool:
    """Whether windows fill [0, 1]."""
    reached = Fraction(0)
    for low, high in sorted(windows):
        if low > reached:
            return False
        reached = max(reached, high)
    return reached >= 1
