"""The statements of Efimov2016, in paper order, as pure mathematics over numpy arrays and Matrix alike.

    z = S x,    Q0 = S A S^-1,    Q1 = -S L C S^-1,    e = (z - z_lower, z_upper - z) >= 0 while the bounds hold

    edot = M e + N1 e(t_k) + b,  b >= 0,    M = [P N; N P],    N1 likewise from Q1

What is exact and new to the paper stands in `positivity.py`, `hurwitz.py` and `held_loop.py`.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, TypeAlias

import numpy as np
from flint import arb

from cdobs_cli.exact.matrix import Matrix, block, symmetric
from cdobs_cli.families.interval.parts import (
    absolute,
    diagonal_part,
    identity_like,
    metzler_split,
    off_diagonal_part,
    positive_part,
)
from cdobs_cli.records import dataclass

M: TypeAlias = Any  # a numpy array or a Matrix, like the other arguments
STRUCTURE_TOLERANCE = 1e-6  # what rounding a gain to short decimals may leave in a block that should be zero


@dataclass(frozen=True)
class Coordinates:
    """The plant in z = S x. Shapes: S, R = S^-1, Q0, Q1 (n, n); SL (n, p)."""

    S: M
    R: M
    Q0: M
    Q1: M
    SL: M


def coordinates(A: M, C: M, S: M, R: M, L: M) -> Coordinates:
    """Q0 = S A S^-1 and Q1 = -S L C S^-1, where R = S^-1.

    Source: Efimov2016, Assumption 3
    """
    SL = S @ L
    return Coordinates(S, R, S @ A @ R, -(SL @ C @ R), SL)


def error_flow(Q0: M) -> M:
    """M = [P N; N P] of the Metzler split of Q0: the flow of e = (z - z_lower, z_upper - z). Of Q1: N1, how e(t_k) acts
    until the next sample; negative off-diagonal entries of Q1 couple the two bounds.

    Source: Efimov2016, (11), (12)
    """
    P, N = metzler_split(Q0)
    return block([[P, N], [N, P]])


def width_flow(Q: M) -> M:
    """diag(Q) + |offdiag(Q)| = P + N: how the width z_upper - z_lower flows."""
    return diagonal_part(Q) + absolute(off_diagonal_part(Q))


def width_matrix(Q0: M, Q1: M) -> M:
    """Mtot = diag(Q0) + |offdiag(Q0)| + diag(Q1) + |offdiag(Q1)|: the width z_upper - z_lower at rest obeys
    0 = Mtot w + (width of delta).

    Source: Efimov2016, (12)
    """
    return width_flow(Q0) + width_flow(Q1)


def theorem_1_order(Q1: Matrix) -> int:
    """l of Assumption 3: the number of leading rows of Q1 with a certainly negative diagonal entry."""
    order = 0
    for k in range(Q1.shape[0]):
        if not arb(Q1[k, k]) < 0 or abs(arb(Q1[k, k])) <= _slack(Q1):
            break
        order += 1
    return order


def assumption_3(Q1: Matrix) -> tuple[str, ...]:
    """What of the structure of Q1 = [Q1bar 0; 0 0] fails: a negative diagonal in the first l >= 1 rows, an
    off-diagonal part of Q1bar that is not negative, zeros elsewhere. Empty where it holds.

    Entries up to 1e-6 of the largest are taken for the rounding of a printed gain; the other proofs read
    them as they are.

    Source: Efimov2016, Assumption 3
    """
    order, slack, n = theorem_1_order(Q1), _slack(Q1), Q1.shape[0]
    found = []
    if order == 0:
        found.append(f"the first diagonal entry of -S L C S^-1 has to be negative, it is {_short(Q1[0, 0])}")
    for i in range(n):
        for j in range(n):
            value = arb(Q1[i, j])
            if i < order and j < order:
                if i != j and value < -slack:
                    found.append(f"entry ({i + 1}, {j + 1}) of -S L C S^-1 must not be negative, it is {_short(value)}")
            elif not abs(value) <= slack and (order > 0 or (i, j) != (0, 0)):
                found.append(f"entry ({i + 1}, {j + 1}) of -S L C S^-1 has to be 0, it is {_short(value)}")
    return tuple(found)


def theorem_1_positivity(Q0: Matrix, Q1: Matrix) -> tuple[arb, arb | None]:
    """The paper's positivity condition q0_k <= e q1_k < q0_k + 1/Tbar for k = 1..l, solved for Tbar.

    Returns:
        The least e q1_k - q0_k (the first inequality holds where it is certainly not negative), and the
        largest admissible Tbar, 1 / max_k (e q1_k - q0_k), not attained (None: not enclosed).
    Source: Efimov2016, Theorem 1
    """
    e, q0 = arb.const_e(), positive_part(Q0)
    gaps = [-arb(Q1[k, k]) * e - arb(q0[k, k]) for k in range(theorem_1_order(Q1))]
    if not gaps:
        return arb(-1), None
    largest = reduce(arb.max, gaps)
    return reduce(arb.min, gaps), 1 / largest if largest > 0 else None


def paper_flow(Q0: M, Q1: M) -> tuple[M, M]:
    """The two blocks that Phi_0 = [P -N; -N P] splits into for z_lower + z_upper and z_upper - z_lower:
    P - N = Q0 and P + N, with the paper's split (of the diagonal too) in the first l rows.

    LMI (15) has a solution exactly where it has one for (Q0, Q1) and one for (P + N, Q1): averaging a
    solution over the swap of the two bounds makes it block diagonal in sum and difference.

    Source: Efimov2016, Theorem 1, Phi_0
    """
    order, n = theorem_1_order(Q1 if isinstance(Q1, Matrix) else Matrix.from_floats(Q1)), Q0.shape[0]
    moduli, split = absolute(Q0), width_flow(Q0)
    rows = [[moduli[i, j] if i < order else split[i, j] for j in range(n)] for i in range(n)]
    return Q0, Matrix.from_rows(rows) if isinstance(Q0, Matrix) else np.array(rows)


def lmi_15(Phi_0: M, Phi_1: M, P: M, W: M, tau: Any) -> M:
    """The matrix of (15), which has to be negative definite together with P > 0, W > 0; tau = 2 Tbar / pi.

        [ P Phi + Phi' P    tau P Phi_1    Phi' W       ]
        [ *                 -W             tau Phi_1' W ]      Phi = Phi_0 + Phi_1
        [ *                 *              -W           ]

    It is even in tau up to a congruence and affine in it, so it holds for every smaller Tbar as well.

    Source: Efimov2016, Theorem 1, (15)
    Deviates: W here is Tbar^2 times the W of the functional printed below it.
    """
    Phi = Phi_0 + Phi_1
    cross, slope, held = P @ Phi_1 * tau, Phi.T @ W, Phi_1.T @ W * tau
    return block([[symmetric(P @ Phi), cross, slope], [cross.T, -W, held], [slope.T, held.T, -W]])


def feedback_flow(Q0: M) -> M:
    """Phi_0 = [P -N; -N P]: the flow of zeta = (z_lower, z_upper).

    Source: Efimov2016, (17)
    Deviates: ordered (z_lower, z_upper) instead of by blocks of l and n - l, a permutation; the diagonal is
        not split.
    """
    P, N = metzler_split(Q0)
    return block([[P, -N], [-N, P]])


@dataclass(frozen=True)
class ObserverLoop:
    """zeta' = Phi_0 zeta + Phi_2 zeta(t_k) + Lambda y(t_k), zeta = (z_lower, z_upper). Source: Efimov2016, (17)"""

    Phi_0: M
    Phi_2: M
    Lambda: M


def observer_loop(z: Coordinates, SB: M, K_lower: M, K_upper: M) -> ObserverLoop:
    """Phi_2 = Phi_1 + [SB; SB] [K_lower K_upper] and Lambda = [S L; S L], in the arithmetic of the arguments.

    Source: Efimov2016, (17)
    """
    fed = [SB @ K_lower, SB @ K_upper]
    return ObserverLoop(feedback_flow(z.Q0), feedback_flow(z.Q1) + block([fed, fed]), block([[z.SL], [z.SL]]))


def theorem_2_functional(v: Any, Tbar: Any) -> M:
    """The first matrix inequality of Theorem 2 (> 0): the functional is positive.

    Source: Efimov2016, Theorem 2
    """
    half, cross = symmetric(v.X) * _half(Tbar), v.X_1 - v.X
    return block([[v.P * (1 / Tbar) + half, cross], [cross.T, half - symmetric(v.X_1)]])


def theorem_2_derivative(loop: ObserverLoop, v: Any, gamma_squared: Any, Tbar: Any, corner: int) -> M:
    """The second inequality (< 0) at corner 0 (just after a sample) or 1 (just before the next), in the
    coordinates zeta, zeta', zeta(t_k) (and the mean of zeta' at corner 1), y:

        Vdot + |zeta(t_k)|^2 - gamma^2 |y|^2 < 0.

    Source: Efimov2016, Theorem 2, Psi_0, Psi_1
    Deviates: the border of Psi_i is damaged in print; this is the Schur form it must have.
    """
    F0, F2, Lambda = loop.Phi_0, loop.Phi_2, loop.Lambda
    P, P_2, P_3, R, Y_1, Y_2 = v.P, v.P_2, v.P_3, v.R, v.Y_1, v.Y_2
    Omega = {
        (1, 1): symmetric(P_2.T @ F0 - Y_1), (1, 2): P - P_2.T + F0.T @ P_3 - Y_2, (1, 3): Y_1.T + P_2.T @ F2 - R,
        (2, 2): -symmetric(P_3), (2, 3): Y_2.T + P_3.T @ F2, (3, 3): symmetric(R) + identity_like(P, P.shape[0]),
    }  # fmt: skip
    rows = held_derivative(Omega, v, Tbar, corner)
    y = [P_2.T @ Lambda, P_3.T @ Lambda, *[P_2.T @ Lambda * 0] * (len(rows) - 2)]
    last = [*(one.T for one in y), identity_like(P, Lambda.shape[1]) * -gamma_squared]
    return block([*([*row, one] for row, one in zip(rows, y, strict=True)), last])


def held_derivative(Omega: dict[tuple[int, int], Any], v: Any, Tbar: Any, corner: int) -> list[list[Any]]:
    """The blocks of Vdot in (zeta, zeta', zeta(t_k)) at corner 0 or 1; there with the mean of zeta' since the sample.

    Source: Efimov2016, Theorem 2, Psi_0, Psi_1
    """
    U, X, X_1, R, Y_1, Y_2 = v.U, v.X, v.X_1, v.R, v.Y_1, v.Y_2
    mean = symmetric(X) * _half(Tbar)
    A11, A12, A13 = Omega[1, 1] - mean, Omega[1, 2], Omega[1, 3] + X - X_1
    A22, A23, A33 = Omega[2, 2], Omega[2, 3], Omega[3, 3] - mean + symmetric(X_1)
    if corner == 0:
        A12, A22, A23 = A12 + mean * Tbar, A22 + U * Tbar, A23 - (X - X_1) * Tbar
        return [[A11, A12, A13], [A12.T, A22, A23], [A13.T, A23.T, A33]]
    m1, m2, m3 = Y_1.T * Tbar, Y_2.T * Tbar, R.T * Tbar
    return [[A11, A12, A13, m1], [A12.T, A22, A23, m2], [A13.T, A23.T, A33, m3], [m1.T, m2.T, m3.T, -(U * Tbar)]]


def _half(like: Any) -> Any:
    return arb(1) / 2 if isinstance(like, arb) else 0.5


def _slack(Q1: Matrix) -> arb:
    largest = reduce(arb.max, (abs(arb(value)) for row in Q1.tolist() for value in row))
    return (largest * arb(STRUCTURE_TOLERANCE)).upper()


def _short(value: Any) -> str:
    return f"{float(arb(value).mid()):.6g}"
