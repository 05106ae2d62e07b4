"""The repaired Theorem 1, for the class (16): (P, alpha) at a given gain, proved for every T_k <= tau_max."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.cuts import largest_margin
from cdobs_cli.certify.lmi import symmetric
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.wirtinger.certificate import least_margin
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix, decimal_text
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.hybrid import PlantView
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 12
_ALPHAS = (0.003, 0.9)  # alpha tau_max < 1


@dataclass(frozen=True)
class Repaired(Method):
    """P, shape (n, n), alpha and beta."""

    P: list[list[str]]
    alpha: str
    beta: str

    name: ClassVar[str] = "repaired"
    rung: ClassVar[str] = "repaired"
    source: ClassVar[str] = "Boukal2020, Theorem 1, with its proof repaired"
    how: ClassVar[str] = "pivots of LDL' in balls"
    statement: ClassVar[str] = "The error of the whole slope class converges"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_class_16(question.plant)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """Over a line search on alpha, the one of the fastest rate; at least the question's rate."""
        tau, view = float(question.law.T_max), question.inclusion.view_floats
        L = view.gain["L"]
        if not is_class_16(question.plant) or not np.all(np.isfinite(L)):
            return None
        best: tuple[float, Self] | None = None
        for alpha_tau in np.geomspace(*_ALPHAS, 12).tolist():
            P, margin = _search(view, tau, alpha_tau)
            if not margin > 0:
                continue
            alpha = alpha_tau / tau
            beta = 2 * tau * tau * L[0, 0] * L[0, 0] * float(np.linalg.inv(P)[0, 0])
            beta += 1e-3 * (alpha - beta)
            speed = theorems.lemma_5_rate(alpha, beta, np.exp(alpha_tau)) / 2
            if best is None or speed > best[0]:
                texts = ExactMatrix.from_floats(P, _DIGITS).texts()
                best = (speed, cls(question.law, texts, decimal_text(alpha, 9), decimal_text(beta, 12)))
        if best is None:
            return None
        proof = best[1].prove(question)
        return best[1] if proof.holds and proof.rate >= Exact(question.rate).ball() else None

    @property
    def covers(self) -> SamplingLaw:
        return SamplingLaw("aperiodic", EXACT_ZERO, self.law.T_max)

    def _prove(self, question: Question) -> Proof:
        """P > 0 and both repaired inequalities at every vertex; the rate of |e| is half of `theorems.lemma_5_rate`."""
        if not is_class_16(question.plant):
            return NOTHING
        view, P = question.inclusion.view_balls, ExactMatrix(self.P).balls()
        L = view.gain["L"]
        tau, alpha, beta = self.law.T_max.scalar, Exact(self.alpha).scalar, Exact(self.beta).scalar
        if P.shape != view.A.shape or P.T.data != P.data or not 0 < beta < alpha or not alpha * tau < 1:
            return NOTHING
        R, one = Matrix.from_rows([[int(j == 1) for j in range(question.plant.n)]]), Matrix.identity(1)
        forms = [P, theorems.repaired_jump(P, view.C, L[0, 0], tau, beta)]
        forms += [-theorems.repaired_flow(P, L, A_i - L @ view.C, R, tau, alpha, one) for A_i in view.vertices]
        margin = least_margin(forms)
        rate = theorems.lemma_5_rate(arb(alpha), arb(beta), arb(alpha * tau).exp()) / 2
        return Proof.of(margin is not None, rate, margin)


def _search(given: PlantView[Any], tau: float, alpha_tau: float) -> tuple[Array, float]:
    """P of the largest margin in both inequalities, floats, no proof."""
    units = Units.of(given, tau, slower=1.0)  # the class (16) is kept
    view = units.view(given)
    L, R, one = view.gain["L"], np.eye(1, len(view.A), 1), np.eye(1)
    solution, margin = largest_margin(
        {"P": symmetric(len(view.A))},
        lambda x, A_i: -theorems.repaired_flow(x["P"], L, A_i - L @ view.C, R, 1.0, alpha_tau, one),
        view.vertices,
        (lambda x: x["P"], lambda x: theorems.repaired_jump(x["P"], view.C, L[0, 0], 1.0, alpha_tau)),
    )
    return units.states_out(solution.values["P"]) * tau, margin
