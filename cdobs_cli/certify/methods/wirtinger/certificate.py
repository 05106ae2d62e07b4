"""Wirtinger's inequality for the held error: decay for every T_k <= tau_max, and the gain with its line search.

edot = F_i e + L w,   w = C (e - e(t_k)),   F_i = A_i - L C,   A_i = A + V at a corner of the slope box
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.cuts import largest_margin
from cdobs_cli.certify.definite import eigenvalue_range, positive_definite
from cdobs_cli.certify.levels import Level, constant_level
from cdobs_cli.certify.lmi import symmetric
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.texts import rate_of
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.matrix import symmetric as sym
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    pass

LETTER = "L"
_DIGITS = 12


@dataclass(frozen=True)
class Wirtinger(Method):
    """P, shape (n, n), and U, shape (p, p), for the rate sigma: a proof for every T_k <= T_max."""

    P: list[list[str]]
    U: list[list[str]]
    sigma: str

    name: ClassVar[str] = "wirtinger"
    rung: ClassVar[str] = "wirtinger"
    source: ClassVar[str] = "LiuFridman2012, Wirtinger's inequality for the held error, with a slope box and a rate"
    how: ClassVar[str] = "pivots of LDL' in balls"
    statement: ClassVar[str] = "The error of the whole slope class converges"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        tau = float(question.law.T_max)
        given = question.inclusion.view_floats
        units = Units.of(given, tau)
        view = units.view(given)
        L, q, identity = view.gain[LETTER], (2 / np.pi) ** 2, np.eye(question.plant.p)
        vertices = view.vertices
        if not np.all(np.isfinite(vertices)) or not np.all(np.isfinite(L)):
            return None
        solution, margin = largest_margin(
            {"P": symmetric(question.plant.n), "U": symmetric(question.plant.p)},
            lambda x, A_i: (
                -inequality(x["P"], x["U"], A_i - L @ view.C, L, view.C, q, float(question.rate) * tau, identity)
            ),
            vertices,
            (lambda x: x["P"], lambda x: x["U"]),
            lambda x: np.trace(x["P"]) - 1,
        )
        if not margin > 0:
            return None
        P, U = units.states_out(solution.values["P"]), units.outputs_out(solution.values["U"])
        P_text, U_text = (ExactMatrix.from_floats(form / np.trace(P), _DIGITS).texts() for form in (P, U))
        certificate = cls(question.law, P_text, U_text, str(Exact(question.rate)))
        return certificate if certificate.prove(question).holds else None

    @property
    def covers(self) -> SamplingLaw:
        return SamplingLaw("aperiodic", EXACT_ZERO, self.law.T_max)

    def _prove(self, question: Question) -> Proof:
        """P > 0, U > 0 and `inequality` < 0 at every vertex; the margin is the least of all."""
        view, sigma = question.inclusion.view_balls, rate_of(self.sigma)
        L = view.gain[LETTER]
        P, U = (ExactMatrix(rows).balls() for rows in (self.P, self.U))
        p = question.plant.p
        if P.shape != view.A.shape or U.shape != (p, p) or P.T.data != P.data or U.T.data != U.data:
            return NOTHING
        q, identity = q_of(self.law.T_max), Matrix.identity(p)
        forms = [P, U]
        forms += [-inequality(P, U, A_i - L @ view.C, L, view.C, q, sigma, identity) for A_i in view.vertices]
        margin = least_margin(forms)
        return Proof.of(margin is not None, sigma, margin)

    def level(self, question: Question) -> Level | None:
        """V is e'Pe at samples, and never below it."""
        return constant_level(ExactMatrix(self.P)) if self.prove(question).holds else None

    def factor(self, question: Question) -> float | None:
        """factor^2 = lambda_max(P) / lambda_min(P)."""
        P = ExactMatrix(self.P).balls()
        least = arb(eigenvalue_range(P, smallest=True).low)
        quotient = arb(eigenvalue_range(P, smallest=False).high) / least
        return float(quotient.sqrt().upper()) if least > 0 and quotient.is_finite() else None


def least_margin(forms: list[Matrix]) -> Fraction | None:
    """m with every form >= m I proved, m >= 0 and every form definite; None where one is not proved."""
    margins = []
    for form in forms:
        result = positive_definite(form)
        if not result.proved or result.margin is None:
            return None
        margins.append(result.margin)
    return min(margins)


def q_of(tau_max: Exact) -> Any:
    """q = (2 tau_max / pi)^2, enclosed."""
    root = 2 * tau_max.ball() / arb.pi()
    return root * root


def inequality(P: Any, U: Any, F_i: Any, L: Any, C: Any, q: Any, sigma: Any, identity: Any) -> Any:
    """Decay at rate sigma for every T_k <= tau_max: this matrix < 0 at each vertex, with P > 0, U > 0.

        [[sym(P F_i) + 2 sigma P, P L], [L' P, -U]] + q G_i' U G_i < 0,
        G_i = [C F_i, C L + sigma I],    q = (2 tau_max / pi)^2

    Proof: V = e'Pe + the integral over [t_k, t] of exp(-2 sigma (t - s)) (q |wdot + sigma w|_U^2 - |w|_U^2).
    By Wirtinger's inequality for exp(sigma s) w, which is 0 at t_k, the integral is >= 0; a sample sets it
    to 0; and this matrix makes Vdot + 2 sigma V < 0. So |e(t)| <= sqrt(cond P) exp(-sigma t) |e(0)|.
    The matrix is convex in F_i: its sign at the vertices decides for the whole slope box.
    Shapes: P, F_i (n, n); U, identity (p, p); L (n, p); C (p, n).
    Source: LiuFridman2012, the functional; here with a slope box and a rate.
    """
    G = block([[C @ F_i, C @ L + identity * sigma]])
    flow = block([[sym(P @ F_i) + P * (2 * sigma), P @ L], [(P @ L).T, -U]])
    return flow + (G.T @ U @ G) * q
