"""What the certificates of Theorem 2 and Theorem 2' share: the numbers that run, P, and a claim for each condition."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Claim, status_of
from cdobs_cli.certify.ball import has_spectral_radius_at_least
from cdobs_cli.certify.methods.base import Method, Proof, Question
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, upper_text
from cdobs_cli.families.updated_sampling import SCALARS
from cdobs_cli.families.updated_sampling.period import Timing
from cdobs_cli.families.updated_sampling.theorems import Chain, is_definite, one_step_map
from cdobs_cli.records import dataclass

Gain = Mapping[str, ExactMatrix]
EVALUATIONS = (20, 60, 120, 240)  # of a search, by effort
_DIGITS = 10


@dataclass(frozen=True)
class Numbers(Timing):
    """alpha, a_1, a_2, a_3 and K (n, 1) as they run: rationals where they are, else balls."""

    K: Matrix

    @staticmethod
    def of(gain: Gain) -> Numbers:
        """Raises: KeyError where the design holds no such gain."""
        alpha, a_1, a_2, a_3 = (gain[name][0, 0].scalar for name in SCALARS)
        return Numbers(alpha, a_1, a_2, a_3, gain["K"].balls())


@dataclass(frozen=True)
class Conditions(Proof):
    """A proof that is the conditions of its theorem, one claim each: it holds where all are proved."""

    conditions: tuple[Claim, ...] = ()

    @staticmethod
    def all_of(*conditions: Claim) -> Conditions:
        return Conditions(all(one.status == "proved" for one in conditions), conditions=conditions)


@dataclass(frozen=True)
class Theorem(Method):
    """P of a theorem, and its claims: those on the conditions, as they were proved. The question's card says which
    slopes the class has (`variant`)."""

    P: list[list[str]]

    # What is asked of a certificate, and what is said where a search ends without a gain.
    wanted: ClassVar[str]
    missing: ClassVar[str]

    @classmethod
    def applies(cls, question: Question) -> bool:
        """Whether Q(alpha) of the question's gain may have its spectrum inside the unit circle."""
        numbers = Numbers.of(question.inclusion.gain)
        Q = one_step_map(Chain.exact(question.plant.n), numbers.K, numbers.alpha)
        return bool(np.all(np.isfinite(numbers.K.floats))) and not has_spectral_radius_at_least(Q)

    @classmethod
    @abstractmethod
    def guess(cls, question: Question) -> Self | None:
        """A certificate for the question's gain, proved or not: its claims say which conditions hold."""

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        guessed = cls.guess(question)
        return guessed if guessed is not None and guessed.prove(question).holds else None

    @classmethod
    @abstractmethod
    def designs(cls, question: Question, c: float) -> Iterator[tuple[Gain, Self]]:
        """Gains with a long guaranteed period while c(x_hat, u) <= c, the longest first, each with a certificate that
        is proved but for rounding. alpha is that of the card, where it has one."""

    def claims(self, question: Question, proof: Proof) -> list[Claim]:
        return list(proof.conditions) if isinstance(proof, Conditions) else []

    def condition(self, what: str, holds: Any, statement: str, source: str, **more: Any) -> Claim:
        return Claim(f"{self.name}.{what}", "certificate", status_of(bool(holds)), f"{statement}.", source, **more)

    def matrix(self, n: int) -> Matrix | None:
        """P (n, n), where it is symmetric and P > 0 is proved."""
        P = ExactMatrix(self.P).balls()
        return P if P.shape == (n, n) and P.T.data == P.data and is_definite(P) else None


def gain_of(K: ExactMatrix, *scalars: Exact | str) -> Gain:
    """K (n, 1) and alpha, a_1, a_2, a_3 as a design holds them."""
    return {"K": K} | {name: ExactMatrix([[value]]) for name, value in zip(SCALARS, scalars, strict=True)}


def symmetric_texts(P: Array) -> list[list[str]]:
    """(P + P') / 2, rounded."""
    return ExactMatrix.from_floats((P + P.T) / 2, _DIGITS).texts()


def down(value: float, digits: int) -> str:
    return lower_text(arb(value), digits)


def up(value: float, digits: int) -> str:
    return upper_text(arb(value), digits)
