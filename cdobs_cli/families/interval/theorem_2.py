"""Theorem 2 of Efimov2016 put to the test for given gains: its small-gain condition, proved or refuted.

The theorem asks for the L2 gain gamma from y to zeta(t_k) of the observer loop to be below 1/(|C| mu). A
constant y gives a lower bound of gamma, the static gain |(Phi_0 + Phi_2)^-1 Lambda|: where that is too large
already, no solution of the LMIs exists.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from types import SimpleNamespace
from typing import Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.ball import frobenius
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.lmi import Program, full, symmetric
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.exact.functions import fraction_ball, hull
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text
from cdobs_cli.families.interval.method import DIGITS, Part, between
from cdobs_cli.families.interval.parts import negative_part, positive_part, symmetrised
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import (
    ObserverLoop,
    theorem_2_derivative,
    theorem_2_functional,
)
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

SYMMETRIC = ("P", "U")
_NAMES = ("P", "U", "X", "X_1", "P_2", "P_3", "R", "Y_1", "Y_2")
_MOST_STATES = 3  # beyond these it takes longer than it is worth
_WIDTH = Fraction(1, 1000)
_SLACK = 1e-6


@dataclass(frozen=True)
class Theorem2(Part):
    """A solution of Theorem 2's inequalities at the law's largest period, with gain gamma: P, U symmetric, the others
    full, all (2n, 2n)."""

    unknowns: dict[str, ExactMatrix]
    gamma: str

    name = "theorem_2"
    rung = "theorem_2"
    how = "Theorem 2"

    @classmethod
    def applies(cls, question: Question) -> bool:
        feedback = "K_lower" in question.inclusion.gain
        return feedback and question.plant.n <= _MOST_STATES and not System.of(question).structure

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The solution of nearly the least gamma at the law's largest period."""
        T = question.law.T_max
        law = SamplingLaw("aperiodic", T_max=T if T.rational is not None else search.short(float(T), 12))
        solution = _least_gain(System.of(question).float_loop, float(law.T_max))
        if solution is None:
            return None
        gamma, unknowns = solution
        for factor in (1 + 1e-6, 1 + 1e-4, 1.01):
            theorem = cls(law, unknowns, decimal_text(gamma * factor**0.5, 8)).proved(question)
            if theorem is not None:
                return theorem
        return None

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """The certificate of the longest period found where gamma is small enough."""
        system, T = System.of(question), float(question.law.T_max)
        limit = gain_limit(system)
        if question.effort == 0 or refute_theorem_2(system.loop, limit) is not None:
            return None
        low, high = search.short(T / 50, 6), search.short(2 * T, 8)
        return between(lambda period: cls._below(question.at(period), limit), low, high, _WIDTH)

    @classmethod
    def _below(cls, question: Question, limit: arb) -> Self | None:
        theorem = cls.propose(question)
        return theorem if theorem is not None and Exact(theorem.gamma).ball() < limit else None

    def _prove(self, question: Question) -> Proof:
        """The inequalities of Theorem 2 at Tbar, with gamma.

        Source: Efimov2016, Theorem 2
        """
        loop, Tbar, gamma = System.of(question).loop, self.law.T_max.ball(), Exact(self.gamma).ball()
        balls = {name: self.unknowns[name].balls() for name in _NAMES}
        if not gamma > 0 or any(M.shape != loop.Phi_0.shape for M in balls.values()):
            return Proof.of(False)
        v = SimpleNamespace(**balls | {name: symmetrised(balls[name]) for name in SYMMETRIC})
        corners = (-theorem_2_derivative(loop, v, gamma * gamma, Tbar, corner) for corner in (0, 1))
        return Proof.of(all(has_positive_pivots(M) for M in (v.P, v.U, theorem_2_functional(v, Tbar), *corners)))


def _least_gain(loop: ObserverLoop, T: float) -> tuple[float, dict[str, ExactMatrix]] | None:
    """gamma and the unknowns of nearly the least gain, by the solver."""
    size = len(loop.Phi_0)
    unknowns = {name: symmetric(size) if name in SYMMETRIC else full(size, size) for name in _NAMES}
    program = Program({**unknowns, "g": full(1, 1)})

    def derivative(x: Mapping[str, Array], corner: int) -> Array:
        M = theorem_2_derivative(loop, SimpleNamespace(**x), x["g"][0, 0], T, corner)
        margin: Array = -M - _SLACK * np.eye(len(M))
        return margin

    program.require(lambda x: theorem_2_functional(SimpleNamespace(**x), T) - _SLACK * np.eye(2 * size))
    program.require(lambda x: derivative(x, 0))
    program.require(lambda x: derivative(x, 1))
    program.require(lambda x: x["P"] - _SLACK * np.eye(size))
    program.require(lambda x: x["U"] - _SLACK * np.eye(size))
    program.maximise(lambda x: -x["g"])
    values = program.solve().values
    gamma_squared = float(values["g"][0, 0])
    if not 0 < gamma_squared < 1e12:
        return None
    return gamma_squared**0.5, {name: ExactMatrix.from_floats(values[name], DIGITS) for name in _NAMES}


def spectral_norm(M: Matrix) -> arb:
    """The largest singular value, enclosed: a Rayleigh quotient from below, definiteness from above."""
    gram = M.T @ M
    values, vectors = np.linalg.eigh(gram.floats)
    vector = Matrix.from_floats(vectors[:, [-1]])
    lower = arb((vector.T @ gram @ vector)[0, 0]) / arb((vector.T @ vector)[0, 0])
    upper = frobenius(M) ** 2
    if np.isfinite(values[-1]):
        guess = Fraction(float(values[-1])) * (1 + Fraction(1, 10**9)) + Fraction(1, 10**300)
        if has_positive_pivots(Matrix.identity(gram.shape[0]) * guess - gram):
            upper = fraction_ball(guess)
    lower = arb.max(lower, arb(0))
    return hull(lower.lower().sqrt().lower(), upper.upper().sqrt().upper())


def gain_limit(system: System) -> arb:
    """1 / (|C| mu) with mu = sqrt(2 (|R^+|^2 + |R^-|^2)), R = S^-1, enclosed.

    Source: Efimov2016, Theorem 2
    """
    R = system.z.R
    C, plus, minus = (spectral_norm(M) for M in (system.plant.C.balls(), positive_part(R), negative_part(R)))
    return arb(1) / (C * ((plus * plus + minus * minus) * 2).sqrt())


def refute_theorem_2(loop: ObserverLoop, limit: arb) -> Witness | None:
    """A constant y whose static response is larger than the limit 1/(|C| mu) allows, proved: the LMIs have no
    solution with gamma below it. `data` holds both numbers.

    Source: Efimov2016, Theorem 2
    """
    try:
        static = (loop.Phi_0 + loop.Phi_2).solve(loop.Lambda)
    except ZeroDivisionError:
        return None
    _, _, directions = np.linalg.svd(static.floats)
    y = ExactMatrix.from_floats(directions[[0], :].T, 6)
    response = static @ y.balls()
    ratio_squared = arb((response.T @ response)[0, 0]) / arb((y.balls().T @ y.balls())[0, 0])
    if not (ratio_squared.is_finite() and ratio_squared > limit * limit):
        return None
    texts = tuple(row[0] for row in y.texts())
    data = {"static_gain": lower_text(ratio_squared.lower().sqrt(), 8), "limit": upper_text(limit, 8), "y": list(texts)}
    return Witness("vector", "plant", values=(texts,), data=data)
