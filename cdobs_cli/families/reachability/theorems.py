"""Dinh2014, Section II: the inequalities and constants, in the paper's order and letters.

Every function is written over `@ .T + -` and `block`: numpy arrays search, `Matrix` objects prove.
"""

from __future__ import annotations

from typing import Any

from cdobs_cli.exact.matrix import block


def lmi_6(P: Any, L: Any, R: Any, C: Any) -> Any:
    """-(R'P + P R - C'L' - L C), to be > 0 at every corner R of A + V (Theorem II.1, continuous measurements).

    Shapes: P, R (n, n); L (n, p); C (p, n). Then P^-1 L is a gain of the observer (7).

    Source: Dinh2014, Theorem II.1, (6); Zemouche2008
    """
    return C.T @ L.T + L @ C - R.T @ P - P @ R


def lmi_13(P: Any, W: Any, M: Any, C: Any) -> Any:
    """[[P, M'(P - C'W')], [(P - W C) M, P]], to be > 0 at every M of the set; K = P^-1 W.

    Shapes: P, M (n, n); W (n, p); C (p, n).

    Source: Dinh2014, Theorem II.2, (13)
    """
    lower = (P - W @ C) @ M
    return block([[P, lower.T], [lower, P]])


def schur_13(P: Any, N_M: Any) -> Any:
    """P - N_M'P N_M with N_M = (I - K C) M: the Schur complement of (13).

    Source: Dinh2014, proof of Theorem II.2
    """
    return P - N_M.T @ P @ N_M


def growth(P: Any, R: Any) -> Any:
    """P R + R'P, whose largest eigenvalue over the corners R of A + V gives eta.

    Source: Dinh2014, proof of Theorem II.2
    """
    return P @ R + R.T @ P


def lmi_reduced(Q: Any, B: Any) -> Any:
    """[[Q, B'], [B, Q]], to be > 0 at every M of the set, with B of `reduced_map`.

    It is (13) restricted to C e = 0, which loses nothing: for any P and K the choice Q = P22,
    K2' = K2 - P22^-1 P21 (I - K1) only lowers (I - K C)'P(I - K C), and conversely P22 = Q with P11 large serves.

    Source: Dinh2014, Theorem II.2, (13), with C K = I
    """
    return block([[Q, B.T], [B, Q]])


def reduced_map(Q: Any, Y: Any, M: Any, C: Any, R: Any, N: Any) -> Any:
    """B = Q R M N - Y C M N: the error on ker C over one period, times Q; K = C+ + N Q^-1 Y.

    Shapes, with r = n - rank C: Q (r, r); Y (r, p); M (n, n); C (p, n); R (r, n); N (n, r). N is a basis of
    ker C, C C+ = I, R C+ = 0, R N = I.
    """
    return Q @ R @ M @ N - Y @ C @ M @ N


def schur_reduced(Q: Any, F: Any, rho_squared: Any) -> Any:
    """rho^2 Q - F'Q F: V = e'Q e (on ker C) shrinks by rho^2 over one period with error map F.

    The paper's kappa tends to 0 as P11 grows; this rate does not depend on P11.
    """
    return Q * rho_squared - F.T @ Q @ F


def error_jump(K: Any, C: Any, identity: Any) -> Any:
    """I - K C.

    Source: Dinh2014, (8)
    """
    return identity - K @ C


def recovered_P(Q: Any, R_tilde: Any, C: Any, s: Any) -> Any:
    """P = R~'Q R~ + s C'C with R~ = R (I - K C): a P of (13) from a Q of the reduced inequality, for s large.

    With C = [I 0]: P22 = Q, P21 = -Q K2, P11 = K2'Q K2 + s I.
    """
    return R_tilde.T @ Q @ R_tilde + (C.T @ C) * s
