"""Andrieu2014 and Andrieu2013 as pure functions, in the order of the papers; Theorem 2' after them.

Written over `@ .T + - *`: called with numpy arrays they search, called with exact matrices they prove.
e = x_hat - x throughout, and the scaled error is E = calL^-1 e with calL = diag(L, .., L^n).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.matrix import Matrix, block, symmetric
from cdobs_cli.records import dataclass

M = TypeVar("M")


@dataclass(frozen=True)
class Chain(Generic[M]):
    """(1)-(2): A a chain of n integrators, C = [1 0 .. 0], D = diag(1, .., n), in one arithmetic.

    Shapes: A, D, identity (n, n); C (1, n). `diagonal` makes diag of a list of n scalars.
    """

    n: int
    A: M
    C: M
    D: M
    identity: M
    diagonal: Callable[[list[Any]], M]

    @staticmethod
    def floats(n: int) -> Chain[NDArray[np.float64]]:
        return Chain(n, np.eye(n, k=1), np.eye(1, n), np.diag(np.arange(1.0, n + 1)), np.eye(n), np.diag)

    @staticmethod
    def exact(n: int) -> Chain[Matrix]:
        A = Matrix.from_rows([[int(j == i + 1) for j in range(n)] for i in range(n)])
        C = Matrix.from_rows([[int(j == 0) for j in range(n)]])
        return Chain(n, A, C, Matrix.diagonal(range(1, n + 1)), Matrix.identity(n), Matrix.diagonal)

    def powers(self, r: Any) -> M:
        """diag(r, .., r^n)."""
        return self.diagonal([r**i for i in range(1, self.n + 1)])

    def exp(self, tau: Any) -> M:
        """exp(A tau), a polynomial since A^n = 0."""
        total: Any = self.identity
        term: Any = self.identity
        for k in range(1, self.n):
            term = (term @ self.A) * tau / k
            total = total + term
        return total  # type: ignore[no-any-return]


def is_definite(*matrices: Matrix) -> bool:
    """Whether M > 0 is proved of each, in balls."""
    return all(has_positive_pivots(M.balls()) for M in matrices)


def growth(a_2: Any, a_3: Any, b: Any, exp: Callable[[Any], Any]) -> Any:
    """ln(L^- / L_k) = (a_2 / a_3) (exp(a_3 b) - 1), b the integral of c over the period; a_2 b where a_3 = 0.

    Source: Andrieu2014, (6a)-(6b) integrated
    """
    return a_2 * b if a_3 == 0 else (exp(a_3 * b) - 1) * a_2 / a_3


def condition_8(P: Any, p_1: Any, p_2: Any, identity: Any) -> tuple[Any, Any]:
    """P - p_1 I >= 0 and p_2 I - P >= 0.

    Source: Andrieu2014, (8)
    """
    return P - identity * p_1, identity * p_2 - P


def condition_9(chain: Chain[Any], P: Any, W: Any) -> Any:
    """-I - (A + K C)'P - P (A + K C) >= 0 with W = P K.

    Source: Andrieu2014, (9)
    """
    return -chain.identity - symmetric(P @ chain.A + W @ chain.C)


def condition_9_lower(chain: Chain[Any], P: Any, p_3: Any) -> Any:
    """P D + D P - p_3 P >= 0.

    Source: Andrieu2014, (9)
    """
    return symmetric(P @ chain.D) - P * p_3


def condition_9_upper(chain: Chain[Any], P: Any, p_4: Any) -> Any:
    """p_4 P - P D - D P >= 0.

    Source: Andrieu2014, (9)
    """
    return P * p_4 - symmetric(P @ chain.D)


def theorem_2_a_1(p_2: Any, p_4: Any) -> Any:
    """a_1 = 1 / (2 p_2 p_4).

    Source: Andrieu2014, Theorem 2
    """
    return 1 / (2 * p_2 * p_4)


def one_step_map(chain: Chain[Any], K: Any, alpha: Any) -> Any:
    """Q(alpha) = (I + alpha K C) exp(A alpha): the scaled error over one period where f = 0.

    Source: Andrieu2014, (15)
    """
    return (chain.identity + (K @ chain.C) * alpha) @ chain.exp(alpha)


def psi_0(chain: Chain[Any], a_1_alpha: Any) -> Any:
    """psi_0 = diag((1 - a_1 alpha)^-i).

    Source: Andrieu2014, Lemma 6
    """
    return chain.powers(1 / (1 - a_1_alpha))


def lemma_4(chain: Chain[Any], P: Any, K: Any, alpha: Any, a_1: Any, p_2: Any) -> Any:
    """(1 - alpha / (4 p_2)) P - Q' psi_0 P psi_0 Q >= 0.

    Source: Andrieu2014, Lemma 4, (17) by Lemma 6
    """
    return theorem_2_prime_i(chain, P, K, alpha, a_1, alpha / (4 * p_2))


def lemma_5(norm_Q: Any, norm_J: Any, exp_alpha: Any, norm_P: Any, scale: Any) -> tuple[Any, Any]:
    """N_1 = 2 |Q| |J| e^(|A| alpha) |P| / s and N_2 = |J|^2 e^(2 |A| alpha) |P| / s, with J = I + alpha K C, |A| = 1
    and s = (1 - a_1 alpha)^(2n), which is `scale`.

    Source: Andrieu2014, Lemma 5
    Deviates: Andrieu2013 has N_1(0) = N_2(0) = 1; they are 2 |P| and |P|.
    """
    grown = norm_J * exp_alpha
    return 2 * norm_Q * grown * norm_P / scale, grown * grown * norm_P / scale


def theorem_2_a_2(weight: Any, N_1: Any, N_2: Any, p_1: Any, p_3: Any) -> Any:
    """a_2 >= 2 w (N_1 + N_2) / (p_3 p_1), with a_3 = 2 w; w = n (triangular), 1 (last row).

    Source: Andrieu2014, Theorem 2, step 3
    Deviates: the footnote to Theorem 2 lacks the factor n.
    """
    return 2 * weight * (N_1 + N_2) / (p_3 * p_1)


def theorem_2_a_2_least(weight: Any, N_1: Any, N_2: Any, p_1: Any, p_3: Any, maximum: Callable[[Any, Any], Any]) -> Any:
    """a_2 >= w max(N_1, 2 N_2) / (p_3 p_1) is what step 3 needs with a_3 = 2 w.

    With q = e^beta >= 1: N_1 + N_2 (q - 1) <= max(N_1 / 2, N_2) (q + 1).
    Source: Andrieu2014, Theorem 2, step 3
    """
    return weight * maximum(N_1, 2 * N_2) / (p_3 * p_1)


def lemma_1_kappa(a_2: Any, a_3: Any, b: Any, exp: Callable[[Any], Any]) -> Any:
    """kappa(s) = exp(a_2 c s exp(a_3 c s)), b = c s.

    Source: Andrieu2014, proof of Lemma 1
    """
    return exp(a_2 * b * exp(a_3 * b))


def lemma_1_phi(a_1_alpha: Any, kappa: Any, ell: Any) -> Any:
    """phi(l) = (1 - a_1 alpha) kappa(alpha / l) + a_1 alpha / l.

    Source: Andrieu2014, (A.2)
    """
    return (1 - a_1_alpha) * kappa + a_1_alpha / ell


def theorem_2_prime_i(chain: Chain[Any], P: Any, K: Any, alpha: Any, a_1: Any, epsilon: Any) -> Any:
    """(i) (1 - eps) P - Q' psi_0 P psi_0 Q >= 0, that is

        (I + alpha K C)' psi_0 P psi_0 (I + alpha K C) <= (1 - eps) exp(-A' alpha) P exp(-A alpha)

    Shapes: P (n, n), K (n, 1).
    Source: Andrieu2014, (17) with any eps > 0
    """
    Q = psi_0(chain, a_1 * alpha) @ one_step_map(chain, K, alpha)
    return P * (1 - epsilon) - Q.T @ P @ Q


def sign_corners(n: int) -> Iterator[tuple[tuple[int, ...], ...]]:
    """The lower triangular G_ij = s_i r_j with signs s, r, s_n = 1: they decide (ii).

    v'P G v is at most sum_(j <= i) |(P v)_i| |v_j|, and G_ij = sign((P v)_i) sign(v_j) attains it, so of the
    2^(n (n + 1) / 2) corners of the class only these 2^(2n - 1) matter ((s, r) and (-s, -r) are one).
    """
    for signs in product((1, -1), repeat=2 * n - 1):
        s, r = (*signs[: n - 1], 1), signs[n - 1 :]
        yield tuple(tuple(s[i] * r[j] if j <= i else 0 for j in range(n)) for i in range(n))


def transported(chain: Chain[Any], G: Any, tau: Any) -> Any:
    """exp(-A tau) G exp(A tau): the slopes seen from the start of the period. A polynomial in tau."""
    return chain.exp(-tau) @ G @ chain.exp(tau)


def theorem_2_prime_ii(P: Any, G: Any, g: Any) -> Any:
    """(ii) g P - P G - G'P >= 0 for G = exp(-A tau) G exp(A tau), all tau in [0, alpha] and corners G.

    This is lambda_max(P(tau) G + G'P(tau), P(tau)) <= g, P(tau) = exp(-A' tau) P exp(-A tau), after the
    congruence with exp(A tau).
    Source: Andrieu2014, Assumption 1, (3); Theorem 2'
    """
    return P * g - symmetric(P @ G)


def last_row_bound(P_tau: Any, unit_n: Any, identity: Any, g: Any, mu: Any, one: Any) -> Any:
    """(ii) where |Delta| <= c |e| in the last row: [[g P(tau) - mu I, P(tau) e_n], [., mu]] >= 0 for some mu > 0.

    By Schur, g P(tau) >= mu I + P(tau) e_n e_n' P(tau) / mu >= d + d' for every d = P(tau) e_n (unit vector)'.
    Source: Andrieu2013, Assumption 1; Theorem 2'
    """
    column = P_tau @ unit_n
    return block([[P_tau * g - identity * mu, column], [column.T, one * mu]])


def held(chain: Chain[Any], P: Any, tau: Any) -> Any:
    """P(tau) = exp(-A' tau) P exp(-A tau)."""
    back = chain.exp(-tau)
    return back.T @ P @ back


def deadbeat_gain(chain: Chain[Any], P: Any, alpha: Any, solve: Callable[[Any, Any], Any]) -> Any:
    """The K of (i) that leaves the most room: I + alpha K C has first column (0, B^-1 b), with P(alpha) =
    [[a, b'], [b, B]]. Then (i) holds for some eps > 0 exactly where `solvable_i` is positive definite.

    Shape (n, 1).
    """
    P_alpha = held(chain, P, alpha)
    y = solve(P_alpha[1:, 1:], P_alpha[1:, [0]])
    return block([[-chain.identity[:1, :1]], [y]]) / alpha


def solvable_i(chain: Chain[Any], P: Any, alpha: Any, a_1_alpha: Any, epsilon: Any) -> Any:
    """E' ((1 - eps) P(alpha) - psi_0 P psi_0) E > 0, E the columns 2..n of I: some K meets (i). Shape (n-1, n-1).

    On C v = 0 the jump changes nothing; elsewhere K is free (projection lemma).
    """
    scale = psi_0(chain, a_1_alpha)
    gap = held(chain, P, alpha) * (1 - epsilon) - scale @ P @ scale
    return gap[1:, 1:]


def fixed_point(a_1_alpha: Any, growth_at_x: Any, x: Any, exp: Callable[[Any], Any]) -> Any:
    """x (exp(-I) - (1 - a_1 alpha)) - a_1 alpha, I = `growth` at b = c alpha / x: 0 where L^- = x repeats.

    Then L_k = x exp(-I) and L_(k+1) = x (1 - a_1 alpha) + a_1 alpha agree.
    """
    return x * (exp(-growth_at_x) - (1 - a_1_alpha)) - a_1_alpha
