"""Errors that are gone after finitely many samples: proved without any function that decays.

1. J = 0 (I - K C = 0, n = rank C): the first sample sets e = 0 under every law and for every slope, and e = 0
   stays. No period is too long.
2. A linear loop with one constant rational period T and a nilpotent flow F (a chain of integrators): exp(F T) is
   a polynomial in T, so M = J exp(F T) is rational, and M^N = 0 is decided exactly.
"""

from __future__ import annotations

from typing import ClassVar, Self

from flint import arb

from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.sylvester import is_observable
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw


@dataclass(frozen=True)
class DeadBeat(Method):
    """It holds no data: the exact matrices are the proof. Loads no solver."""

    name: ClassVar[str] = "dead_beat"
    rung: ClassVar[str] = "dead_beat"
    source: ClassVar[str] = "exact rational arithmetic"
    how: ClassVar[str] = "exact matrices"
    statement: ClassVar[str] = "Every error is 0 after finitely many samples"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        gone = cls(question.law)
        return gone if gone.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        inclusion, law = question.inclusion, self.law
        return Proof.of(law.is_bounded and (resets(inclusion) or _is_nilpotent_at(inclusion, law)), arb("inf"))

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """Under the question's own law: where one sample erases every error no period is too long."""
        return cls.propose(question)


@dataclass(frozen=True)
class EveryPeriod(Method):
    """A chain of integrators without slopes: F^n = 0, so exp(F T) has the eigenvalue 1 alone, and where (F, C) is
    observable so is (exp(F T), C) for every T > 0: at every constant period some gain makes the error 0 after n
    samples.
    It holds no data. Loads no solver."""

    name: ClassVar[str] = "every_period"
    rung: ClassVar[str] = "dead_beat"
    source: ClassVar[str] = "exact rational arithmetic"
    how: ClassVar[str] = "exact matrices"
    statement: ClassVar[str] = "Every constant period has a gain that ends the error after n samples"
    reach: ClassVar[Reach] = "some gain"
    endless: ClassVar[bool] = True

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        chain = cls(question.law)
        return chain if chain.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        view, n = question.inclusion.view_balls, question.plant.n
        if view.quantities or not self.law.is_periodic or not self.law.is_bounded or not view.A.is_rational:
            return NOTHING
        power = view.A
        for _ in range(n - 1):
            power = power @ view.A
        return Proof.of(_is_zero(power) and is_observable(view.A, view.C) is True, arb("inf"))


def resets(inclusion: HybridInclusion) -> bool:
    """Whether one sample erases every error: J = 0 exactly."""
    J = inclusion.balls.jump
    return not inclusion.outputs and J.is_rational and _is_zero(J)


def _is_nilpotent_at(inclusion: HybridInclusion, law: SamplingLaw) -> bool:
    T = law.T_max.rational
    if inclusion.quantities or inclusion.outputs or not law.is_periodic or T is None:
        return False
    maps = inclusion.balls
    if not (maps.base.is_rational and maps.jump.is_rational):
        return False
    N = maps.base.shape[0]
    term = total = Matrix.identity(N)
    for k in range(1, N + 1):
        term = term @ maps.base * T / k
        total = total + term
    if not _is_zero(term):  # F^N = 0: the series ends
        return False
    M = maps.jump @ total
    power = M
    for _ in range(N - 1):
        power = power @ M
    return _is_zero(power)


def _is_zero(M: Matrix) -> bool:
    return all(value == 0 for row in M.tolist() for value in row)
