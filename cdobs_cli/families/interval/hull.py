"""The hull predictor: a centre that copies the model and a radius that bounds its error exactly from sample to
sample. It needs neither positivity nor the structure of Assumption 3.

    c' = A c + B u + d_mid + L (y_k - v_mid - C c(t_k)),    F(s) = exp(A s) - Gamma_A(s) L C
    rho_(k+1) = |S F(T_k) S^-1| rho_k + integral_0^T_k |S exp(A r)| dr d_rad + |S Gamma_A(T_k) L| v_rad
    |x - c| <= |F(s) S^-1| rho_k + integral_0^s |exp(A r)| dr d_rad + |Gamma_A(s) L| v_rad  at t_k + s

It stays bounded where |S F(s) S^-1| contracts in one weighted norm for every period of the law.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, lower_text
from cdobs_cli.families.interval.boundedness import DIGITS
from cdobs_cli.families.interval.held_loop import growth, holds_on, law_ends
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_PIECES = 96
_ROUNDS = 40


def contraction(Phi: Matrix, w: Matrix, s: arb) -> list[arb]:
    """((w - |F(s)| w)/s)_i for F(s) = I + s Phi(s); s may be a ball that holds 0.

    Positive for all i and s means: rho <= beta w at one sample, c small, implies rho <= beta w at the next.
    """
    found = []
    for i in range(Phi.shape[0]):
        own = arb(Phi[i, i])
        # (|1 + s f| - 1)/s = max(f, -f - 2/s); the second only counts where 1 + s f may be negative.
        if not 1 + s * own > 0:
            own = arb.max(own, -own - 2 / s)
        total = own * arb(w[i, 0])
        for j in range(Phi.shape[1]):
            if j != i:
                total += abs(arb(Phi[i, j])) * arb(w[j, 0])
        found.append(-total)
    return found


def hull_growth(A: Matrix, C: Matrix, S: Matrix, R: Matrix, L: Matrix, s: Any) -> Matrix:
    """Phi(s) with S F(s) S^-1 = I + s Phi(s)."""
    return S @ growth(A, A - L @ C, s) @ R


def prove_hull(A: Matrix, C: Matrix, S: Matrix, R: Matrix, L: Matrix, w: Matrix, law: SamplingLaw, effort: int = 1) -> bool:
    """Whether |S F(s) S^-1| w <= (1 - rate s) w, rate > 0, is proved for every period s of the law."""
    if w.shape != (A.shape[0], 1) or not all(arb(w[i, 0]) > 0 for i in range(w.shape[0])):
        return False
    low, high = law_ends(law)
    return holds_on(lambda s: all(value > 0 for value in contraction(hull_growth(A, C, S, R, L, s), w, s)), low, high, 512 * 2**effort)


def find_hull(A: Array, C: Array, S: Array, L: Array, law: SamplingLaw) -> ExactMatrix | None:
    """Weights w for `prove_hull`: a linear program over some periods of the law, largest common rate."""
    import numpy as np

    from cdobs_cli.certify.lmi import Program, diagonal, full

    n = len(A)
    low, high = float(law.T_min), float(law.T_max)
    periods = [high] if low == high else [low + (high - low) * (1 - np.cos(np.pi * k / 24)) / 2 for k in range(25)]
    errors, R = error_maps_at(A, C, S, L, periods), float_inverse(S)
    if errors is None or R is None:
        return None
    program = Program({"w": diagonal(n), "t": full(1, 1)})
    inner = S @ (A - L @ C) @ R
    for s, F in zip(periods, errors, strict=True):
        slope = np.diag(np.diag(inner)) + np.abs(inner - np.diag(np.diag(inner))) if s == 0 else (np.abs(F) - np.eye(n)) / s
        scale = 1 / max(float(np.abs(slope).max()), 1e-12)
        for i in range(n):
            program.require(lambda x, row=slope[i] * scale: (-row @ np.diag(x["w"]) - x["t"][0, 0]).reshape(1, 1))  # type: ignore[misc]
    for i in range(n):
        program.require(lambda x, i=i: (x["w"][i, i] - x["t"][0, 0]).reshape(1, 1))  # type: ignore[misc]
    program.equate(lambda x: np.trace(x["w"]).reshape(1, 1) - n)
    program.maximise(lambda x: x["t"])
    solution = program.solve()
    if not solution.values["t"][0, 0] > 0:
        return None
    return ExactMatrix.from_floats(np.diag(solution.values["w"]).reshape(-1, 1), DIGITS)


def float_inverse(S: Array) -> Array | None:
    """S^-1 in floats; None where floats take S for singular."""
    import numpy as np

    try:
        R: Array = np.linalg.inv(S).astype(np.float64)
    except np.linalg.LinAlgError:
        return None
    return R if np.all(np.isfinite(R)) else None


def error_maps_at(A: Array, C: Array, S: Array, L: Array, periods: list[float]) -> Array | None:
    """S F(s) S^-1 for each period, in floats; None where they are not finite."""
    import numpy as np

    from cdobs_cli.certify.falsify import exponentials

    n = len(A)
    maps = np.array([np.block([[A, -L @ C], [np.zeros((n, 2 * n))]]) * s for s in periods])
    if not np.all(np.isfinite(maps)):
        return None
    parts = exponentials(maps)
    R = float_inverse(S)
    if R is None:
        return None
    errors = S @ (parts[:, :n, :n] + parts[:, :n, n:]) @ R
    return errors if np.all(np.isfinite(errors)) else None


def hull_width(
    A: Matrix, C: Matrix, S: Matrix, R: Matrix, L: Matrix, w: Matrix, disturbance: Matrix, noise: Matrix, law: SamplingLaw,
    known: Matrix | None = None,
) -> Matrix | None:  # fmt: skip
    """An upper bound of the final width of x at all times, shape (n, 1): the largest over the phase s of the
    width that a radius rho bounded for ever leads to.

    The bound of rho starts at the multiple of w that no sample raises, and is improved by applying the worst
    sample of the law to it; every step is a valid bound. For one period it tends to the fixed point itself.

    Args:
        known: a final width of z proved without the hull, shape (n, 1): the hull is never wider.
    """
    n = A.shape[0]
    half_d, half_v = disturbance * Fraction(1, 2), noise * Fraction(1, 2)
    low, high = law_ends(law)
    pieces = _phases(A, C, S, R, L, half_d, half_v, low, high)
    beta = arb(0)
    for piece in pieces:
        if not piece.is_sample:
            continue
        drop = contraction(piece.Phi, w, piece.s)
        for i in range(n):
            if not drop[i] > 0:
                return None
            beta = arb.max(beta, (arb(piece.rate[i, 0]) / drop[i]).upper())
    rho = w.balls() * beta
    if known is not None:
        rho = Matrix.from_rows([[arb.min(arb(rho[i, 0]), arb(known[i, 0]) / 2).upper()] for i in range(n)])
    for _ in range(_ROUNDS if low > 0 else 1):
        peak = [arb(0)] * n
        for piece in pieces:
            if piece.is_sample:
                value = absolute(Matrix.identity(n) + piece.Phi * piece.s) @ rho + piece.rate * piece.s
                peak = [arb.max(peak[i], arb(value[i, 0]).upper()) for i in range(n)]
        rho = Matrix.from_rows([[arb.min(arb(rho[i, 0]), peak[i]).upper()] for i in range(n)])
    width = [arb(0)] * n
    for piece in pieces:
        value = (piece.to_x @ rho + piece.in_x) * 2
        width = [arb.max(width[i], arb(value[i, 0]).upper()) for i in range(n)]
    if known is not None:
        without = absolute(R) @ known
        width = [arb.min(value, arb(without[i, 0])).upper() for i, value in enumerate(width)]
    return Matrix.from_rows([[value] for value in width])


class _Phase:
    """One piece of the phase s since the last sample: Phi(s), what disturbance and noise add per unit of time
    to rho, and the map from rho and data to |x - c|."""

    def __init__(self, s: arb, Phi: Matrix, rate: Matrix, to_x: Matrix, in_x: Matrix, *, is_sample: bool) -> None:
        self.s, self.Phi, self.rate, self.to_x, self.in_x, self.is_sample = s, Phi, rate, to_x, in_x, is_sample


def _phases(
    A: Matrix, C: Matrix, S: Matrix, R: Matrix, L: Matrix, half_d: Matrix, half_v: Matrix, low: Fraction, high: Fraction
) -> list[_Phase]:
    """Pieces that cover [0, high]; those that cover [low, high] are where a sample may come."""
    n = A.shape[0]
    ends = sorted({high * k / _PIECES for k in range(_PIECES + 1)} | {low})
    pairs = list(pairwise(ends)) + ([(high, high)] if low == high else [])
    in_x, in_z = Matrix.zeros(n, 1).balls(), Matrix.zeros(n, 1).balls()
    pieces = []
    for a, b in pairs:
        length = fraction_ball(b - a)
        s = fraction_ball((a + b) / 2) + arb(0, (length / 2).upper())
        flow = (A.balls() * arb(0, (length / 2).upper())).exp() @ A.exp(fraction_ball((a + b) / 2))
        # Integrals up to any point of the piece: up to its end is an upper bound of them.
        next_x = in_x + absolute(flow) @ half_d * length
        next_z = in_z + absolute(S @ flow) @ half_d * length
        gamma = growth(A, Matrix.identity(n), s)  # Gamma_A(s)/s
        Phi = S @ gamma @ (A - L @ C) @ R
        noise_rate = absolute(S @ gamma @ L) @ half_v
        # in_z(s)/s <= max of |S exp(A r)| d_rad over [0, s]; for pieces away from 0 by division.
        disturbance_rate = next_z / s if a > 0 else absolute(S @ flow) @ half_d
        to_x = absolute(flow_to_x(gamma, A, L @ C, s) @ R)
        pieces.append(_Phase(s, Phi, disturbance_rate + noise_rate, to_x, next_x + absolute(gamma @ L) @ half_v * s, is_sample=a >= low))
        in_x, in_z = next_x, next_z
    return pieces


def flow_to_x(gamma: Matrix, A: Matrix, LC: Matrix, s: arb) -> Matrix:
    """F(s) = I + s (Gamma_A(s)/s) (A - L C)."""
    F: Matrix = Matrix.identity(A.shape[0]) + gamma @ (A - LC) * s
    return F


def refute_hull(A: Matrix, C: Matrix, S: Matrix, R: Matrix, L: Matrix, law: SamplingLaw) -> Witness | None:
    """A constant period of the law at which the radius grows for ever: rho(|S F(T) S^-1|) > 1, proved."""
    from cdobs_cli.certify.ball import spectral_radius_lower

    for T in (law.T_max, law.T_min):
        if T.sign() != 1:
            continue
        s = T.ball()
        multiplier = spectral_radius_lower(absolute(Matrix.identity(A.shape[0]) + hull_growth(A, C, S, R, L, s) * s))
        if multiplier > 1:
            return Witness("constant", "plant", (str(T),), ((),), lower_text(multiplier), data={"arcs": [1]})
    return None
