"""Boukal2020 in the paper's order, then the forms that are true of it: pure mathematics.

    xhatdot = A xhat + phi(xhat, u) + B u + L (y(t_k) - C xhat(t_k)),    e = x - xhat,
    edot = (A_i - L C) e + L w,    w = C (e - e(t_k)),    A_i = A + V at a corner of the slope box.

Every inequality is one function of numpy arrays (search) or exact matrices (proof); `identity` is that of
the size the equation needs, in the same arithmetic.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from cdobs_cli.exact.matrix import block, symmetric
from cdobs_cli.hybrid import ErrorMaps, NoiseMaps, PlantView

# A numpy array, or an exact Matrix.
Mat: TypeAlias = Any


def vertices_25(view: PlantView[Mat]) -> list[Mat]:
    """The vertices A_i = A + V of the error's flow, over the slopes that vary.

        V_H = {Phi : Phi_j in {lower_j, upper_j}}

    Shapes: (n, n) each, 2^(number of uncertain slopes) of them; the order is that of
    `itertools.product` over (lower, upper) of `view.entries`.
    Source: Boukal2020, (23), (25).
    Deviates: the paper takes 2^n corners; only the entries on which phi depends are needed.
    """
    return view.vertices


def error_maps(view: PlantView[Mat]) -> ErrorMaps[Mat]:
    """The error with the held innovation, augmented by w = C (e - e(t_k)), which a sample sets to 0.

        d/dt (e, w) = [[A_i - L C, L], [C (A_i - L C), C L]] (e, w),    (e, w)+ = (e, 0)

    Shapes: A (n, n), C (p, n), L (n, p); the flow is (n + p, n + p).
    Source: Boukal2020, (24), written over (e, w).
    """
    A, C, L = view.A, view.C, view.gain["L"]
    F: Any = A - L @ C
    held = C.T * 0
    return ErrorMaps(
        base=block([[F, L], [C @ F, C @ L]]),
        parts=tuple(block([[part, held], [C @ part, C @ held]]) for part in view.parts),
        lower=view.lower,
        upper=view.upper,
        jump=block([[view.identity, held], [held.T, (C @ C.T) * 0]]),
    )


def held_maps(view: PlantView[Mat]) -> ErrorMaps[Mat]:
    """The error with the held innovation itself, where the outputs' slopes H vary: they are those of the last sample.

        d/dt (e, r) = [[A_i, L], [0, 0]] (e, r),    (e, r)+ = (e, -H e),    e = xhat - x

    Shapes: A (n, n), H (p, n), L (n, p); the flow is (n + p, n + p).
    Source: Boukal2020, (24), written over (e, r).
    """
    C, L = view.C, view.gain["L"]
    none, zero = C.T * 0, (C @ C.T) * 0

    def on_states(part: Mat) -> Mat:
        return block([[part, none], [none.T, zero]])

    return ErrorMaps(
        block([[view.A, L], [none.T, zero]]), tuple(map(on_states, view.parts)), view.lower, view.upper,
        block([[view.identity, none], [-C, zero]]),
        tuple(block([[view.identity * 0, none], [-H, zero]]) for H in view.outputs), view.output_lower,
        view.output_upper,
    )  # fmt: skip


def noise_maps(view: PlantView[Mat]) -> NoiseMaps[Mat]:
    """Disturbance and noise in (e, w), e = xhat - x, w = C (e - e(t_k)) + v_k: of the error of `error_maps`.

    d/dt (e, w) = .. - [I; C] d,    (e, w)+ = (e, v_k)
    """
    C = view.C
    return NoiseMaps(-block([[view.identity], [C]]), block([[C.T * 0], [view.output_identity]]))


def held_noise_maps(view: PlantView[Mat]) -> NoiseMaps[Mat]:
    """Disturbance and noise in (e, r), r+ = v_k - H e: of the error of `held_maps`."""
    C = view.C
    return NoiseMaps(-block([[view.identity], [C * 0]]), block([[C.T * 0], [view.output_identity]]))


def lemma_5_rate(alpha: Any, beta: Any, exp_alpha_tau: Any) -> Any:
    """The decay rate of V where Vdot <= -alpha V + beta V(t_k), beta < alpha, T_k <= tau.

        phi = (alpha - beta) exp(-alpha tau)

    V decays at rate phi, |e| at phi / 2. `exp_alpha_tau` is exp(alpha tau) in the caller's arithmetic.
    Source: Boukal2020, Lemma 5.
    """
    return (alpha - beta) / exp_alpha_tau


def lmi_26(P: Mat, Y: Mat, A_i: Mat, C: Mat, R: Mat, tau_max: Any, delta: Any, mu: Any, identity: Mat) -> Mat:
    """The printed inequality: this matrix <= 0 at each vertex.

        A_i' P - C' Y' + P A_i - Y C + Y Y' + 2 tau_max^2 delta R'R + mu I <= 0,    R = [0, 1, 0, .., 0]

    Shapes: P, A_i, identity (n, n); Y (n, 1); C, R (1, n).
    Source: Boukal2020, Theorem 1, (26).
    """
    return symmetric(P @ A_i - Y @ C) + Y @ Y.T + (R.T @ R) * (2 * tau_max * tau_max * delta) + identity * mu


def lmi_26_schur(
    P: Mat, Y: Mat, A_i: Mat, C: Mat, R: Mat, tau_max: Any, delta: Any, mu: Any, identity: Mat, one: Mat
) -> Mat:
    """(26) with Y Y' taken out by a Schur complement, affine in (P, Y, mu): this matrix <= 0.

        [[Sym(P A_i - Y C) + 2 tau_max^2 delta R'R + mu I, Y], [Y', -1]] <= 0

    Shapes: as `lmi_26`; `one` is the 1 x 1 identity.
    Source: Boukal2020, Theorem 1, (26).
    """
    corner = symmetric(P @ A_i - Y @ C) + (R.T @ R) * (2 * tau_max * tau_max * delta) + identity * mu
    return block([[corner, Y], [Y.T, -one]])


def theorem_1_beta(tau_max: Any, lambda_max: Any, L_1: Any) -> Any:
    """beta = 2 tau_max^2 lambda_max(P) L_1^2. Source: Boukal2020, Theorem 1.

    Deviates: the bound on V(t_k) needs 1 / lambda_min(P) in place of lambda_max(P).
    """
    return 2 * tau_max * tau_max * lambda_max * L_1 * L_1


def theorem_1_alpha_1(mu: Any, lambda_min: Any) -> Any:
    """alpha_1 = mu lambda_min(P). Source: Boukal2020, Theorem 1.

    Deviates: mu / lambda_max(P) is what e'e >= V_1 / lambda_max(P) gives.
    """
    return mu * lambda_min


def theorem_1_alpha_2(tau_max: Any, delta: Any) -> Any:
    """alpha_2 = 2 tau_max (delta - 1). Source: Boukal2020, Theorem 1.

    Deviates: the paper has three versions of it; (delta - 1) / (delta tau_max) is what the proof gives.
    """
    return 2 * tau_max * (delta - 1)


def remark_2_T_1_squared(mu: Any, lambda_min: Any, lambda_max: Any, L_1: Any) -> Any:
    """T_1^2 = 2 mu lambda_min(P) / (3 lambda_max(P) L_1^2). Source: Boukal2020, Remark 2, (39).

    Deviates: beta < alpha_1 as printed means tau_max^2 < mu lambda_min(P) / (2 lambda_max(P) L_1^2).
    """
    return 2 * mu * lambda_min / (3 * lambda_max * L_1 * L_1)


def remark_2_T_2_squared(delta: Any, lambda_max: Any, L_1: Any) -> Any:
    """T_2^2 = (delta - 1) / (lambda_max(P) L_1^2). Source: Boukal2020, Remark 2, (40)."""
    return (delta - 1) / (lambda_max * L_1 * L_1)


def repaired_delta(alpha: Any, tau_max: Any) -> Any:
    """delta = 1 / (1 - alpha tau_max), for alpha tau_max < 1: then the term of V_2 decays at alpha too.

    Source: Boukal2020, (35)-(36) with the lower limit t - tau_max in V_2 in place of t_k.
    """
    return 1 / (1 - alpha * tau_max)


def repaired_flow(P: Mat, L: Mat, F_i: Mat, R: Mat, tau_max: Any, alpha: Any, one: Mat) -> Mat:
    """The first inequality of the repaired Theorem 1: this matrix <= 0 at each vertex.

        [[Sym(P F_i) + 2 tau_max^2 delta R'R + alpha P, P L], [L' P, -1]] <= 0,    delta = 1 / (1 - alpha tau_max)

    It gives Vdot <= -alpha V + 2 tau_max^2 L_1^2 e_1(t_k)^2 for V = e'Pe + 2 tau_max delta times the double
    integral of e_2^2 over [t - tau_max, t]. For the class (16) only: n >= 2, C = e_1', first row of A = e_2'.
    Shapes: P, F_i = A_i - L C (n, n); L (n, 1); R (1, n).
    Source: Boukal2020, Theorem 1, proof.
    Deviates: the printed V_2 has the lower limit t_k and then no negative term.
    """
    delta = repaired_delta(alpha, tau_max)
    corner = symmetric(P @ F_i) + (R.T @ R) * (2 * tau_max * tau_max * delta) + P * alpha
    return block([[corner, P @ L], [(P @ L).T, -one]])


def repaired_jump(P: Mat, C: Mat, L_1: Any, tau_max: Any, beta: Any) -> Mat:
    """The second inequality of the repaired Theorem 1: this matrix > 0 for some beta < alpha.

        beta P - 2 tau_max^2 L_1^2 C'C > 0

    Shapes: P (n, n), C (1, n); L_1 the first entry of L.
    Source: Boukal2020, Theorem 1, beta.
    Deviates: the printed side condition compares eigenvalues, and the wrong ones.
    """
    return P * beta - (C.T @ C) * (2 * tau_max * tau_max * L_1 * L_1)
