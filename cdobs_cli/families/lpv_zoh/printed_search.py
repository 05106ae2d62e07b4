"""(P, Y) that meet every condition of the printed Theorem 1 at one gain, Y = P L."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from cdobs_cli.certify.lmi import Program, full, symmetric
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.families.lpv_zoh.printed import SOURCE, Printed, side_conditions
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 9
_SIZES = (1e-3, 1e2)


@dataclass(frozen=True)
class PrintedTheorem1(Method):
    """(P, Y), shapes (n, n) and (n, 1): the conditions as printed, whose proof has a gap; convergence never rests on
    them."""

    P: list[list[str]]
    Y: list[list[str]]

    name: ClassVar[str] = "theorem_1"
    rung: ClassVar[str] = "theorem_1"
    source: ClassVar[str] = SOURCE
    how: ClassVar[str] = "balls"
    reach: ClassVar[Reach] = "printed conditions"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return is_class_16(question.plant)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """With lambda_max(P) held at a trial value, delta and beta are numbers, and mu lambda_min(P) is maximised:
        [[mu, s], [s, lambda_min]] >= 0 with s as objective."""
        view = question.inclusion.view_floats
        gain, tau, n = view.gain["L"], float(question.law.T_max), question.plant.n
        R, one, identity = np.eye(1, n, 1), np.eye(1), np.eye(n)
        L_1 = float(gain[0, 0])
        vertices = view.vertices
        best: tuple[float, Array] | None = None
        for size in np.geomspace(*_SIZES, 11):
            beta = theorems.theorem_1_beta(tau, size, L_1)
            delta = 1 + 1.001 * beta / (2 * tau)
            program = Program({"P": symmetric(n), "mu": full(1, 1), "low": full(1, 1), "s": full(1, 1)})
            for A_i in vertices:
                program.require(
                    lambda x, A_i=A_i, delta=delta: (
                        -theorems.lmi_26_schur(  # type: ignore[misc]
                            x["P"], x["P"] @ gain, A_i, view.C, R, tau, delta, x["mu"], identity, one
                        )
                    )
                )
            program.require(lambda x, size=size: identity * size - x["P"])  # type: ignore[misc]
            program.require(lambda x: x["P"] - identity * x["low"])
            program.require(lambda x: np.block([[x["mu"], x["s"]], [x["s"], x["low"]]]))
            program.maximise(lambda x: x["s"])
            solution = program.solve()
            s = float(solution.values["s"][0, 0])
            if np.isfinite(s) and s > 0 and (best is None or s * s / beta > best[0]):
                best = (s * s / beta, solution.values["P"])
        if best is None or best[0] <= 1:
            return None
        P = ExactMatrix.from_floats(best[1], _DIGITS)
        Y = ExactMatrix.from_floats(P.floats @ gain, _DIGITS)
        certificate = cls(question.law, P.texts(), Y.texts())
        return certificate if certificate.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        view = question.inclusion.view_balls
        P, Y = ExactMatrix(self.P), ExactMatrix(self.Y)
        data = Printed.of(P, Y, question.gain("L"), view.C, view.vertices)
        if data is None:
            return NOTHING
        return Proof.of(side_conditions(data, self.law.T_max.scalar) == "proved")
