"""LMI (15) of the paper: boundedness by a solver, for every period up to Tbar."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certify import search
from cdobs_cli.certify.ball import spectral_radius_lower
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.lmi import Program, full, symmetric
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.hurwitz import Hurwitz
from cdobs_cli.families.interval.method import DIGITS, Part, between, largest_margin
from cdobs_cli.families.interval.parts import symmetrised
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import Coordinates, lmi_15, paper_flow
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_MOST_STATES = 8  # beyond these it takes longer than it is worth
_WIDTH = Fraction(1, 2000)


@dataclass(frozen=True)
class Lmi15(Part):
    """A solution of (15) at the law's largest period Tbar, for the sum (Phi_0 = Q0) and the difference (Phi_0 = P + N)
    of the bounds; it serves every smaller period."""

    P: tuple[ExactMatrix, ExactMatrix]
    W: tuple[ExactMatrix, ExactMatrix]

    name = "lmi_15"
    rung = "lmi_15"
    how = "LMI (15)"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.plant.n <= _MOST_STATES and not System.of(question).structure

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        floats, Tbar = System.of(question).floats, question.law.T_max
        pairs = []
        for Phi_0 in paper_flow(floats.Q0, floats.Q1):
            pair = _solution(Phi_0, floats.Q1, 2 * float(Tbar) / np.pi)
            if pair is None:
                return None
            pairs.append(pair)
        return cls(SamplingLaw("aperiodic", T_max=Tbar), *zip(*pairs, strict=True)).proved(question)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        limit = lmi_15_limit(System.of(question).z)
        if limit is None or Hurwitz.propose(question) is None:
            return None
        low, high = (search.short(float(limit) * share, 8) for share in (1e-3, 0.9996))
        return between(lambda T: cls.propose(question.at(T)), low, high, _WIDTH)

    @classmethod
    def stored(cls, question: Question) -> list[Self]:
        longest = cls.longest(question)
        return [] if longest is None else [longest]

    def _prove(self, question: Question) -> Proof:
        """(15), P > 0 and W > 0.

        Source: Efimov2016, Theorem 1, (15)
        """
        z, tau = System.of(question).z, self.law.T_max.ball() * 2 / arb.pi()
        unknowns = zip(paper_flow(z.Q0, z.Q1), self.P, self.W, strict=True)
        return Proof.of(all(_solves(Phi_0, z.Q1, P.balls(), W.balls(), tau) for Phi_0, P, W in unknowns))


def _solves(Phi_0: Matrix, Q1: Matrix, P: Matrix, W: Matrix, tau: arb) -> bool:
    if P.shape != Phi_0.shape or W.shape != Phi_0.shape:
        return False
    P, W = symmetrised(P), symmetrised(W)
    return all(has_positive_pivots(M) for M in (P, W, -lmi_15(Phi_0, Q1, P, W, tau)))


def _solution(Phi_0: Array, Q1: Array, tau: float) -> tuple[ExactMatrix, ExactMatrix] | None:
    """P and W of (15) for one half of the bounds, by the solver."""
    n = len(Q1)
    identity, first = np.eye(n), np.kron(np.diag([1.0, 0, 0]), np.eye(n))
    program = Program({"P": symmetric(n), "W": symmetric(n), "t": full(1, 1)})

    def slack(x: Mapping[str, Array]) -> Array:
        margin: Array = -lmi_15(Phi_0, Q1, x["P"], x["W"], tau) - first * x["t"]
        return margin

    program.require(slack)
    program.require(lambda x: x["P"] - identity * x["t"])
    program.require(lambda x: x["W"])
    program.equate(lambda x: np.trace(x["P"]) - 1)
    values = largest_margin(program)
    if values is None:
        return None
    return ExactMatrix.from_floats(values["P"], DIGITS), ExactMatrix.from_floats(values["W"], DIGITS)


def lmi_15_limit(z: Coordinates) -> arb | None:
    """A period at and above which (15) has no solution: pi / (2 rho), rho = the largest -Q1_kk of a triangular
    Q1, from its lower right block W > tau^2 Phi_1' W Phi_1; None where no such bound is enclosed.

    Source: Efimov2016, Theorem 1, (15)
    """
    rho = spectral_radius_lower(z.Q1)
    return (arb.pi() / (2 * rho)).upper() if rho > 0 else None
