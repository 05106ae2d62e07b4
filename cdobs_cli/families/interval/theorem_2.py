"""Theorem 2 of Efimov2016 put to the test for given gains: its small-gain condition, proved or refuted.

The theorem asks for the L2 gain gamma from y to zeta(t_k) of the observer loop to be below 1/(|C| mu). A
constant y gives a lower bound of gamma, the static gain |(Phi_0 + Phi_2)^-1 Lambda|: where that is too large
already, no solution of the LMIs exists.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.functions import fraction_ball, hull
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text
from cdobs_cli.families.interval.boundedness import DIGITS, symmetrised
from cdobs_cli.families.interval.theorems import (
    Coordinates,
    Theorem2Unknowns,
    feedback_flow,
    feedback_held,
    theorem_2_derivative,
    theorem_2_functional,
    theorem_2_gain_limit,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SYMMETRIC = ("P", "U")


@dataclass(frozen=True)
class ObserverLoop:
    """zeta' = Phi_0 zeta + Phi_2 zeta(t_k) + Lambda y(t_k), zeta = (z_lower, z_upper). Source: Efimov2016, (17)"""

    Phi_0: Any
    Phi_2: Any
    Lambda: Any


def observer_loop(z: Coordinates[Any], SB: Any, K_lower: Any, K_upper: Any) -> ObserverLoop:
    """The loop of the observer with feedback, in the arithmetic of its arguments.

    Source: Efimov2016, (17)
    """
    return ObserverLoop(feedback_flow(z.Q0), feedback_held(z.Q1, SB, K_lower, K_upper), block([[z.SL], [z.SL]]))


def spectral_norm(M: Matrix) -> arb:
    """The largest singular value, enclosed: a Rayleigh quotient from below, definiteness from above."""
    import numpy as np

    from cdobs_cli.certify.ball import frobenius

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


def gain_limit(z: Coordinates[Matrix], C: Matrix) -> arb:
    """1 / (|C| mu), enclosed."""
    return arb(theorem_2_gain_limit(spectral_norm(C), z.R, spectral_norm))


@dataclass(frozen=True)
class Theorem2:
    """A solution of Theorem 2's inequalities with gain gamma."""

    unknowns: Theorem2Unknowns[ExactMatrix]
    gamma: Exact

    def document(self) -> dict[str, Any]:
        named = {field.name: getattr(self.unknowns, field.name).texts() for field in fields(self.unknowns)}
        return {**named, "gamma": str(self.gamma)}

    @staticmethod
    def from_document(document: dict[str, Any]) -> Theorem2:
        """Raises: KeyError, ValueError on what `document` did not write."""
        named = {field.name: ExactMatrix(document[field.name]) for field in fields(Theorem2Unknowns)}
        return Theorem2(Theorem2Unknowns(**named), Exact(document["gamma"]))


def prove_theorem_2(loop: ObserverLoop, certificate: Theorem2, Tbar: arb) -> bool:
    """Whether the inequalities of Theorem 2 are proved for the stored solution at Tbar, with its gamma.

    Source: Efimov2016, Theorem 2
    """
    v = balls(certificate.unknowns)
    if any(getattr(v, field.name).shape != loop.Phi_0.shape for field in fields(v)):
        return False
    gamma = certificate.gamma.ball()
    if not gamma > 0:
        return False
    if not all(has_positive_pivots(M) for M in (v.P, v.U, theorem_2_functional(v, Tbar))):
        return False
    return all(
        has_positive_pivots(-theorem_2_derivative(loop.Phi_0, loop.Phi_2, loop.Lambda, v, gamma * gamma, Tbar, corner)) for corner in (0, 1)
    )


def balls(v: Theorem2Unknowns[ExactMatrix]) -> Theorem2Unknowns[Matrix]:
    """The stored unknowns in balls, P and U made symmetric."""
    named = {field.name: getattr(v, field.name).balls() for field in fields(v)}
    return Theorem2Unknowns(**{name: symmetrised(M) if name in SYMMETRIC else M for name, M in named.items()})


def find_theorem_2(floats: ObserverLoop, exact: ObserverLoop, Tbar: Fraction) -> Theorem2 | None:
    """A solution with nearly the least gamma, found by the solver and proved from its printed digits."""
    import numpy as np

    from cdobs_cli.certify.lmi import Program, full, symmetric

    size, p = len(floats.Phi_0), floats.Lambda.shape[1]
    T = float(Tbar)
    kinds = {field.name: symmetric(size) if field.name in SYMMETRIC else full(size, size) for field in fields(Theorem2Unknowns)}
    program = Program({**kinds, "g": full(1, 1)})

    def unknowns(x: Mapping[str, Array]) -> Theorem2Unknowns[Array]:
        return Theorem2Unknowns(**{name: x[name] for name in kinds})

    def derivative(x: Mapping[str, Array], corner: int, slack: float) -> Array:
        M = theorem_2_derivative(floats.Phi_0, floats.Phi_2, floats.Lambda, unknowns(x), x["g"][0, 0], T, corner)
        result: Array = -M - slack * np.eye(len(M))
        return result

    slack = 1e-6
    program.require(lambda x: theorem_2_functional(unknowns(x), T) - slack * np.eye(2 * size))
    program.require(lambda x: derivative(x, 0, slack))
    program.require(lambda x: derivative(x, 1, slack))
    program.require(lambda x: x["P"] - slack * np.eye(size))
    program.require(lambda x: x["U"] - slack * np.eye(size))
    program.maximise(lambda x: -x["g"])
    solution = program.solve()
    gamma_squared = float(solution.values["g"][0, 0])
    if not 0 < gamma_squared < 1e12 or p == 0:
        return None
    found = Theorem2Unknowns(**{name: ExactMatrix.from_floats(solution.values[name], DIGITS) for name in kinds})
    for factor in (1 + 1e-6, 1 + 1e-4, 1.01):
        certificate = Theorem2(found, Exact(decimal_text((gamma_squared * factor) ** 0.5, 8)))
        if prove_theorem_2(exact, certificate, fraction_ball(Tbar)):
            return certificate
    return None


def refute_theorem_2(loop: ObserverLoop, limit: arb) -> Witness | None:
    """A constant y whose static response is larger than the limit 1/(|C| mu) allows, proved: the LMIs have no
    solution with gamma below it. `data` holds both numbers.

    Source: Efimov2016, Theorem 2
    """
    import numpy as np

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
