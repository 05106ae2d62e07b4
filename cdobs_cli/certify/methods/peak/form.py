"""The inequalities of an error bound, each one pure function of numpy arrays (search) or exact matrices (proof).

edot = A e + B d, e+ = J e + G v: between samples V(tau) = e'P(tau)e grows by at most sum_j mu_j d_j^2 per time, at a
sample by at most sum_j nu_j v_j^2. Shapes: A, J, P (N, N); B (N, q), G (N, p); mu, nu diagonal, (q, q) and (p, p);
z (N, 1).
"""

from __future__ import annotations

from typing import Any

from cdobs_cli.certify.methods.clock.form import jump_gap, lyapunov
from cdobs_cli.exact.matrix import block


def flow_block(P_dot: Any, P: Any, A: Any, B: Any, mu: Any, sigma: Any = 0) -> Any:
    """[[-(Pdot + P A + A'P + 2 sigma P), -P B], [., mu]] >= 0: d/dt e'P e <= d'mu d - 2 sigma e'P e."""
    return driven_block(-(P_dot + lyapunov(P, A, sigma)), P @ B, mu)


def driven_block(gap: Any, P_B: Any, mu: Any) -> Any:
    """[[gap, -P B], [., mu]] >= 0, gap what e'Pe falls by per time where d = 0: under d it grows by d'mu d at most."""
    return block([[gap, -P_B], [-P_B.T, mu]])


def jump_block(P: Any, P_0: Any, J: Any, G: Any, nu: Any) -> Any:
    """[[P - J'P_0 J, -J'P_0 G], [., nu - G'P_0 G]] >= 0: (J e + G v)'P_0 (J e + G v) <= e'P e + v'nu v."""
    side = -(J.T @ P_0 @ G)
    return block([[jump_gap(P_0, P, J), side], [side.T, nu - G.T @ P_0 @ G]])


def target_block(P: Any, z: Any) -> Any:
    """P - z z' >= 0: (z'e)^2 <= e'P e."""
    return P - z @ z.T
