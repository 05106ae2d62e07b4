"""The mean square of one error at every time where samples may follow one another as fast as one likes: from the error
bound for such laws.

That bound holds along every path: with x the error without what noise has left in it, s_k,

    d/dt x'P x <= sum_j mu_j d_j^2 + sum_j mu_j s_kj^2 - 2 sigma x'P x,    x'P x does not grow at samples,
    (z'e)^2 <= x'P x + sum_j nu_j s_kj^2,

so it holds in expectation, with sqrt(R_jj) for the largest |v_j|: E v_j^2 <= R_jj, and the root mean square of a sum is
at most the sum of those of its parts. That takes periods which do not depend on the noise. A white disturbance of
intensity Q is no input of the flow: it adds tr(P B Q B') to d/dt E x'P x, and

    E (z'e)^2 <= b^2 + max_tau tr(P(tau) B Q B') / (2 sigma),    b the bound without it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Self

from flint import arb

from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.mean_square.subject import MeanSquareOfState
from cdobs_cli.certify.methods.peak.from_zero import PeakFromZero
from cdobs_cli.certify.methods.peak.signals import acting
from cdobs_cli.certify.texts import rate_of, rationals, symmetric_from_upper
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

# What stands for a white disturbance in the search: one whose square over T_max is so much of the intensity.
_LIKE_WHITE = (1.0, 5.0, 0.2)
_TRIED = (1, 2, 3, 3)  # of them, by effort
_DIGITS = 6


@dataclass(frozen=True)
class MeanSquareFromZero(MeanSquareOfState):
    """As `PeakFromZero`, for signals of the sizes that noise has in mean square, without a white disturbance."""

    state: str
    degree: str
    elevated: str
    pieces: list[str]
    sigma: str
    basis: list[list[str]]
    P: list[list[list[str]]]
    mu: list[list[str]]
    nu: list[str]

    name: ClassVar[str] = "mean_square_from_zero"
    rung: ClassVar[str] = "mean_square_from_zero"
    source: ClassVar[str] = "clock-dependent quadratic function, the noise as an input of the flow"
    statement: ClassVar[str] = "e'P(tau)e bounds E e_i^2 at every time"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.plant.has_white and PeakFromZero.applies(_without_white(question))

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound found for the error of the question's state."""
        if question.state is None or not cls.applies(question):
            return None
        met = [(one, one.prove(question).error) for one in cls._proposals(question)]
        proved = [(one, error) for one, error in met if error is not None]
        return min(proved, key=lambda pair: float(pair[1].upper()), default=(None, None))[0]

    @classmethod
    def _proposals(cls, question: Question) -> Iterator[Self]:
        for like in _LIKE_WHITE[: _TRIED[question.level] if question.plant.intensity is not None else 1]:
            asked = _like_bounded(question, like)
            peak = PeakFromZero.propose(asked)
            if peak is not None:
                dropped = len(acting(asked.plant.disturbance)) if question.plant.intensity is not None else 0
                yield cls(
                    peak.law, peak.state, peak.degree, peak.elevated, peak.pieces, peak.sigma, peak.basis, peak.P,
                    [piece[: len(piece) - dropped] for piece in peak.mu], peak.nu,
                )  # fmt: skip

    def _prove(self, question: Question) -> Proof:
        if not self.applies(question):
            return NOTHING
        peak = PeakFromZero(
            self.law, self.state, self.degree, self.elevated, self.pieces, self.sigma, self.basis, self.P, self.mu,
            self.nu,
        )  # fmt: skip
        proof = peak.prove(_without_white(question))
        if not proof.holds or proof.error is None:
            return NOTHING
        error = (proof.error**2 + self._drifted(question)).sqrt().upper()
        return Proof(True, error=error) if error.is_finite() else NOTHING

    def _drifted(self, question: Question) -> arb:
        """max tr(P B Q B') / (2 sigma) over the error's part of P: it lies in the hull of its coefficients."""
        Q = question.plant.intensity
        if Q is None:
            return arb(0)
        B = rationals(self.basis).inverse() @ question.inclusion.noise_balls.drive
        spread, most = B @ Q.balls() @ B.T, arb(0)
        for rows in self.P:
            P = symmetric_from_upper(rows)
            most = most.max(arb((P[: len(self.basis), : len(self.basis)] @ spread).trace()))
        return most / (2 * fraction_ball(rate_of(self.sigma)))


def _without_white(question: Question) -> Question:
    """Bounded noise of the size that the white one has in mean square, no white disturbance."""
    return _about(question, question.plant.disturbance)


def _like_bounded(question: Question, like: float) -> Question:
    """The same with a bounded disturbance of about the effect of the white one."""
    plant, T = question.plant, float(question.law.T_max)
    if plant.intensity is None:
        return _without_white(question)
    sizes = [Exact(decimal_text((like * float(plant.intensity[j, j]) / T) ** 0.5, _DIGITS)) for j in range(plant.n)]
    return _about(question, Box(tuple(-size for size in sizes), tuple(sizes)))


def _about(question: Question, disturbance: Box | None) -> Question:
    plant, noise = question.plant, question.plant.noise
    if plant.covariance is not None:
        sizes = [Exact(f"sqrt({plant.covariance[k, k]})") for k in range(plant.p)]
        noise = Box(tuple(-size for size in sizes), tuple(sizes))
    elif noise is None:
        noise = Box((Exact(0),) * plant.p, (Exact(0),) * plant.p)
    bounded = replace(plant, noise=noise, disturbance=disturbance, covariance=None, intensity=None)
    return replace(question, inclusion=replace(question.inclusion, plant=bounded))
