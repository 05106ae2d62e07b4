"""A method that the tool does not know: one norm of the error, what it grows by and what it falls by."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from typing import Any, ClassVar, Self

from flint import arb

from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.texts import rational
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text


@dataclass(frozen=True)
class MaximumNorm(Method):
    """|e| = max |e_i| grows by exp(mu T) at most between samples and falls by |J| at each; mu >= 0 is stored."""

    mu: str

    name: ClassVar[str] = "maximum_norm"
    rung: ClassVar[str] = "maximum_norm"
    source: ClassVar[str] = "logarithmic norm"
    how: ClassVar[str] = "rational arithmetic and balls"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        mu = max(0.0, *(float(arb(_measure(A)).upper()) for A in question.inclusion.balls.corners()))
        norm = cls(question.law, decimal_text(Fraction(mu) * (1 + Fraction(1, 10**6)), 9))
        proof = norm.prove(question)
        return norm if proof.holds and proof.rate >= fraction_ball(question.rate) else None

    def _prove(self, question: Question) -> Proof:
        maps, mu, T = question.inclusion.balls, rational(self.mu), self.law.T_max.ball()
        size = _rows(maps.jump)
        if mu < 0 or not self.law.is_bounded or not all(_measure(A) <= fraction_ball(mu) for A in maps.corners()):
            return NOTHING
        factor = size * (fraction_ball(mu) * T).exp()
        return Proof.of(bool(factor < 1), -factor.log() / T if factor < 1 and factor > 0 else 0)


def _rows(M: Matrix) -> arb:
    """max_i sum_j |m_ij|."""
    return _most([sum((abs(arb(value)) for value in row), arb(0)) for row in M.tolist()])


def _measure(A: Matrix) -> arb:
    """max_i (a_ii + sum_(j != i) |a_ij|), the logarithmic norm."""
    rows: list[list[Any]] = A.tolist()
    return _most(
        [arb(row[i]) - abs(arb(row[i])) + sum((abs(arb(v)) for v in row), arb(0)) for i, row in enumerate(rows)]
    )


def _most(values: list[arb]) -> arb:
    return reduce(lambda a, b: a.max(b), values)
