"""The certificate of the set, proved in balls for the printed gain: no solver, no float decides anything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from fractions import Fraction
from functools import reduce
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certificate import Claim, status_of
from cdobs_cli.certify.definite import eigenvalue_range, has_positive_pivots, positive_definite
from cdobs_cli.certify.kernel import is_zero, kernel
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.texts import rational, symmetric
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, lower_text, upper_text
from cdobs_cli.families.reachability.escape import inclusion_claim
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.families.reachability.sets import (
    box_holds,
    inclusion_12,
    matrix_set,
    reachable_box,
    set_limit,
    set_round,
)
from cdobs_cli.families.reachability.theorems import error_jump, growth, recovered_P, schur_13, schur_reduced
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Rows = list[list[str]]

SOURCE = "Dinh2014, Theorem II.2"
# The paper's constants kappa and eta need the full (13), whose 2^(2n-1) members are many beyond this.
MAX_STATES_OF_CONSTANTS = 6
MAX_ENTRIES_OF_ETA = 10
_PIVOTS = "pivots of LDL' in balls"


@dataclass(frozen=True)
class SetProof(Proof):
    """What was proved, each part by itself; `holds` is all together.

    rho_squared: V shrinks at least by this factor over one period (None where it is not proved).
    members: how many members of the set were checked.
    """

    in_time: bool = False
    inclusion: bool = False
    positive: bool = False
    members: int = 0
    rho_squared: Fraction | None = None


@dataclass(frozen=True)
class ReachableSet(Method):
    """form `reduced`: C K = I and Q on ker C, with s of `recovered_P`; form `full`: P of (13). rho_squared: V shrinks
    by this factor over one period."""

    form: str
    rho_squared: str
    Q: list[list[str]] | None = field(default=None, metadata={OPTIONAL: True})
    P: list[list[str]] | None = field(default=None, metadata={OPTIONAL: True})
    s: str | None = field(default=None, metadata={OPTIONAL: True})

    name: ClassVar[str] = "set"
    rung: ClassVar[str] = "set"
    source: ClassVar[str] = SOURCE
    how: ClassVar[str] = _PIVOTS

    @classmethod
    def applies(cls, question: Question) -> bool:
        return super().applies(question) and question.law.is_periodic

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        from cdobs_cli.families.reachability.set_design import certificate_at

        return certificate_at(question)  # type: ignore[return-value]

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        from cdobs_cli.families.reachability.set_design import longest_for

        return longest_for(question)  # type: ignore[return-value]

    def _prove(self, question: Question) -> Proof:
        """The gain contracts V over one period delta for every slope history.

        1. delta <= delta_star, so that the box of the plant's structure holds every Phi_V(delta);
        2. the box lies in the set M;
        3. C K = I exactly: Q > 0 and rho^2 Q - F'Q F > 0 with F = R (I - K C) M N at every member that matters
           (form `reduced`); otherwise P > 0 and rho^2 P - N_M'P N_M > 0 (form `full`);
        4. rho < 1.

        With n = rank C and C K = I each jump ends at e = 0, whatever delta.

        Source: Dinh2014, Theorem II.2
        """
        plant, K, delta = question.plant, question.gain("K"), self.law.T_max
        if not self.law.is_periodic or delta.sign() != 1:
            return NOTHING
        if plant.p >= plant.n and self.Q == [] and kernel(plant.C).dimension == 0 and kernel(plant.C).is_kept(K):
            return SetProof(True, arb("inf"), None, None, True, True, True, 0, Fraction(0))
        box = reachable_box(plant, delta.ball())
        boxes = set_round(question.card, box, delta)
        if box is None or boxes is None:
            return NOTHING
        in_time = box_holds(plant, delta.ball())
        inclusion = inclusion_12(box, boxes) if question.card.set != "clarke" else True
        rho_squared = rational(self.rho_squared)
        inequality = self._inequality(plant, K)
        if inequality is None:
            return SetProof(False, in_time=in_time, inclusion=inclusion)
        V, contract, active = inequality
        count, contracts, positive = 0, 0 <= rho_squared < 1, has_positive_pivots(V)
        if contracts and positive:
            for M in set_members(boxes, active):
                count += 1
                if not has_positive_pivots(contract(M, rho_squared)):
                    contracts = False
                    break
        if not (positive and contracts):
            return SetProof(False, in_time=in_time, inclusion=inclusion, positive=positive, members=count)
        rate = arb("inf") if rho_squared == 0 else -fraction_ball(rho_squared).log() / (2 * delta.ball())
        return SetProof(in_time and inclusion, rate, None, None, in_time, inclusion, True, count, rho_squared)

    def _inequality(self, plant: Plant, K: ExactMatrix) -> Any:
        """(V, the matrix to be > 0 as a function of a member and rho^2, the columns of the members that matter)."""
        if self.form == "full":
            P = symmetric(self.P or [], plant.n)
            jump = error_jump(K.balls(), plant.C.balls(), Matrix.identity(plant.n))
            return P, lambda M, rho_squared: schur_reduced(P, jump @ M, rho_squared), list(range(plant.n))
        space = kernel(plant.C)
        if self.form != "reduced" or not space.is_kept(K):
            return None
        Q = symmetric(self.Q or [], space.dimension)
        T = space.R @ error_jump(K.balls(), space.C, Matrix.identity(plant.n))
        active = [j for j in range(plant.n) if any(not is_zero(space.N[j, b]) for b in range(space.dimension))]
        return Q, lambda M, rho_squared: schur_reduced(Q, T @ M @ space.N, rho_squared), active

    def lyapunov_matrix(self, plant: Plant, K: ExactMatrix) -> Matrix:
        """P of (13): stored in form `full`, recovered from Q and s in form `reduced`."""
        if self.form == "full":
            return symmetric(self.P or [], plant.n)
        space = kernel(plant.C)
        R_tilde = space.R @ error_jump(K.balls(), space.C, Matrix.identity(plant.n))
        P: Matrix = recovered_P(symmetric(self.Q or [], space.dimension), R_tilde, space.C_r, rational(self.s or ""))
        return P

    def decrease(self, plant: Plant, K: ExactMatrix) -> NDArray[np.float64] | None:
        """P in floats with V = e'Pe just after a jump; None where every jump ends at 0."""
        if self.form == "full":
            return ExactMatrix(self.P or []).floats
        if not self.Q:
            return None
        space = kernel(plant.C)
        T = space.R.floats @ (np.eye(plant.n) - K.floats @ plant.C.floats)
        P: NDArray[np.float64] = T.T @ ExactMatrix(self.Q).floats @ T
        return P

    def claims(self, question: Question, proof: Proof) -> list[Claim]:
        """(13) itself, the premises of Theorem II.2 one by one, and the paper's constants."""
        assert isinstance(proof, SetProof) or proof is NOTHING
        part = proof if isinstance(proof, SetProof) else SetProof(False)
        plant, delta = question.plant, self.law.T_max
        letter, where = ("Q", "reduced to C e = 0, as C K = I") if self.form == "reduced" else ("P", "with K fixed")
        gap = None if part.rho_squared is None else lower_text(fraction_ball(1 - part.rho_squared), 6)
        claims = [
            Claim("set.contraction", "certificate", status_of(part.holds),
                  f"(13), {where}, holds at all {part.members} matrices of the set that matter: V shrinks by "
                  f"rho^2 < 1 over each period.",
                  f"{SOURCE}, (13)", margin=gap, method=_PIVOTS)
        ]  # fmt: skip
        limit = set_limit(plant)
        if plant.slopes.uncertain and limit.is_finite():
            room = lower_text(limit - delta.ball(), 6) if part.in_time else None
            claims.append(
                Claim("set.period", "premise", status_of(part.in_time), f"delta = {delta} is at most delta_star, "
                f"so the box (31) holds "
                      "every reachable error.", "Dinh2014, Theorem III.2", margin=room, method="interval "
                      "evaluation of the first zero")
            )  # fmt: skip
        claims.append(inclusion_claim(question.card, plant, delta, part.inclusion and part.in_time))
        claims.append(
            Claim("set.positive", "premise", status_of(part.positive), f"{letter} is positive definite.", SOURCE)
        )
        return claims + self._constants_claims(question, part)

    def _constants_claims(self, question: Question, proof: SetProof) -> list[Claim]:
        paper = constants(question, self) if proof.holds else None
        if paper is None:
            return []
        kappa, eta = lower_text(fraction_ball(paper.kappa), 6), upper_text(fraction_ball(paper.eta), 6)
        return [
            Claim("set.constants", "certificate", "proved",
                  f"With P recovered from the certificate: e'Pe shrinks by 1 - kappa over each period, kappa >= "
                  f"{kappa}, and grows "
                  f"at most at the rate eta <= {eta} between samples.",
                  "Dinh2014, proof of Theorem II.2, (14)", margin=kappa, method=_PIVOTS)
        ]  # fmt: skip

    def factor(self, question: Question) -> float | None:
        """V after k periods is at most rho^(2k) V, and between samples |e| grows at most by exp(mu delta), mu the
        largest logarithmic norm of A + V; twice that growth, as the first jump may come a period late."""
        plant, rho_squared = question.plant, rational(self.rho_squared)
        if len(plant.slopes.quantities) > MAX_ENTRIES_OF_ETA or not 1e-12 < rho_squared < 1 or self.form != "reduced":
            return None
        space = kernel(plant.C)
        Q = symmetric(self.Q or [], space.dimension)
        T = space.R @ error_jump(question.gain("K").balls(), space.C, Matrix.identity(plant.n))
        least, largest = arb(eigenvalue_range(Q, smallest=True).low), arb(eigenvalue_range(Q, smallest=False).high)
        norms = [(R + R.T) * Fraction(1, 2) for R in question.inclusion.view_balls.vertices]
        mu = reduce(arb.max, [arb(eigenvalue_range(one, smallest=False).high) for one in norms], arb(0))
        grown = (mu * self.law.T_max.ball()).exp()
        kept = ((largest / least) * _norm_squared(space.N) * _norm_squared(T)).sqrt()
        # 1 / rho^2 = exp(2 rate delta): the phase within a period.
        factor = grown.max(grown**2 * kept) / fraction_ball(rho_squared)
        return float(factor.upper()) if least > 0 and factor.is_finite() else None


def _norm_squared(M: Matrix) -> arb:
    """The largest eigenvalue of M'M, enclosed."""
    return arb(eigenvalue_range(M.T @ M, smallest=False).high)


def set_members(boxes: tuple[IntervalMatrix, ...], active: list[int]) -> Iterator[Matrix]:
    """Every member that matters, of every box of the set."""
    for box in boxes:
        for signs in box.signs(active):
            yield box.member(signs)


@dataclass(frozen=True)
class Constants:
    """The paper's kappa (proved lower end) and eta (proved upper end), in |e|' P |e|."""

    kappa: Fraction
    eta: Fraction


def constants(question: Question, certificate: ReachableSet) -> Constants | None:
    """kappa = min lambda_min(P - N_M'P N_M) / lambda_max(P) and eta = max(lambda_max(P R + R'P), 0) / lambda_min(P).

    Floats suggest each eigenvalue, pivots decide; None where (13) itself is not proved for this P.

    Source: Dinh2014, proof of Theorem II.2
    """
    plant, K = question.plant, question.gain("K")
    large = plant.n > MAX_STATES_OF_CONSTANTS or len(plant.slopes.quantities) > MAX_ENTRIES_OF_ETA
    boxes = None if large else matrix_set(question.card, plant, certificate.law.T_max)
    if boxes is None or (certificate.s is None and certificate.form == "reduced"):
        return None
    P = certificate.lyapunov_matrix(plant, K)
    jump = error_jump(K.balls(), plant.C.balls(), Matrix.identity(plant.n))
    one = Matrix.identity(plant.n)
    gaps = [schur_13(P, jump @ M) for M in set_members(boxes, list(range(plant.n)))]
    rates = [growth(P, R) for R in PlantView.balls(plant, {}).vertices]
    eigenvalues = np.linalg.eigvalsh(P.floats)
    least = Fraction(0.999 * float(min(np.linalg.eigvalsh(gap.floats)[0] for gap in gaps)))
    largest, smallest = Fraction(1.000001 * float(eigenvalues[-1])), Fraction(0.999999 * float(eigenvalues[0]))
    top = Fraction(
        max(0.0, 1.001 * max(float(np.linalg.eigvalsh(rate.floats)[-1]) for rate in rates)) + 1e-9 * float(largest)
    )
    proved = (
        least > 0
        and smallest > 0
        and positive_definite(P - one * smallest).proved
        and positive_definite(one * largest - P).proved
        and all(has_positive_pivots(gap - one * least) for gap in gaps)
        and all(has_positive_pivots(one * top - rate) for rate in rates)
    )
    return Constants(least / largest, top / smallest) if proved else None
