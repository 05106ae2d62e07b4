"""What is held between two samples, and what holds for every period of a law.

x(t_k + s) = F(s) x(t_k),    F(s) = exp(A s) + Gamma(s) held = I + s Phi(s),    Phi(s) = phi_1(A s) (A + held)

Gamma(s) = integral_0^s exp(A r) dr = s phi_1(A s)
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.certify.ball import spectral_radius_lower
from cdobs_cli.certify.cover import covered
from cdobs_cli.certify.floats import exponentials
from cdobs_cli.exact.functions import fraction_ball, hull
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import arb_fraction, lower_text
from cdobs_cli.sampling import SamplingLaw


def growth(A: Matrix, closed: Matrix, s: arb) -> Matrix:
    """Phi(s) = phi_1(A s) closed, with F(s) = I + s Phi(s) and closed = A + held, for every s of a ball.

    phi_1(A s) is the upper right block of exp([A s, I; 0, 0]).
    """
    n = A.shape[0]
    both = block([[A.balls() * s, Matrix.identity(n)], [Matrix.zeros(n, n), Matrix.zeros(n, n)]]).exp()
    phi_1: Matrix = both[0:n, n : 2 * n]
    return phi_1 @ closed


def growth_and_slope(A: Matrix, closed: Matrix, s: arb) -> tuple[Matrix, Matrix]:
    """Phi(s) and Phi'(s) = A (phi_1(A s) - phi_2(A s)) closed, phi_2(X) = integral_0^1 (1 - r) exp(X r) dr.

    phi_1 and phi_2 stand in the first row of blocks of exp([A s, I, 0; 0, 0, I; 0, 0, 0]).
    """
    n = A.shape[0]
    identity, zero = Matrix.identity(n), Matrix.zeros(n, n)
    rows = block([[A.balls() * s, identity, zero], [zero, zero, identity], [zero, zero, zero]]).exp()[0:n, :]
    phi_1, phi_2 = rows[:, n : 2 * n], rows[:, 2 * n :]
    return phi_1 @ closed, A @ (phi_1 - phi_2) @ closed


def flow(A: Matrix, s: arb) -> Matrix:
    """exp(A s) for every s of a ball."""
    flow: Matrix = (A * s.mid()).exp() @ (A * arb(0, s.rad())).exp()
    return flow


def flows(A: Array, times: Any) -> tuple[Array, Array] | None:
    """exp(A s) and phi_1(A s) for each s in floats, shapes (times, n, n); None where they are not finite."""
    n, count = len(A), len(times)
    blocks = np.zeros((count, 2 * n, 2 * n))
    blocks[:, :n, :n], blocks[:, :n, n:] = A * np.reshape(times, (count, 1, 1)), np.eye(n)
    if not np.all(np.isfinite(blocks)):
        return None
    both = exponentials(blocks)[:, :n]
    return (both[:, :, :n], both[:, :, n:]) if np.all(np.isfinite(both)) else None


def held_maps(A: Array, held: Array, times: Any) -> Array | None:
    """F(s) for each s in floats, shape (times, n, n); None where they are not finite."""
    parts = flows(A, times)
    if parts is None or not np.all(np.isfinite(held)):
        return None
    maps: Array = parts[0] + np.reshape(times, (-1, 1, 1)) * parts[1] @ held
    return maps if np.all(np.isfinite(maps)) else None


def contraction(Phi: Matrix, w: Matrix, s: arb) -> list[arb]:
    """((w - |F(s)| w)/s)_i for F(s) = I + s Phi(s); s may be a ball that holds 0.

    Positive for all i and s means: rho <= beta w at one sample, c small, implies rho <= beta w at the next.
    """
    falls = []
    for i, row in enumerate(Phi.tolist()):
        own = arb(row[i])
        # (|1 + s f| - 1)/s = max(f, -f - 2/s); the second only counts where 1 + s f may be negative.
        if not 1 + s * own > 0:
            own = arb.max(own, -own - 2 / s)
        falls.append(-sum((abs(arb(value)) * w[j, 0] for j, value in enumerate(row) if j != i), own * w[i, 0]))
    return falls


def contracts(growths: Callable[[arb], tuple[Matrix, Matrix]], w: Matrix, law: SamplingLaw) -> bool:
    """Whether w > 0 and |F(s)| w <= (1 - rate s) w, rate > 0, is proved for every period s of the law.

    Args:
        growths: Phi(s) and Phi'(s).
    """

    def falls(s: arb) -> bool:
        Phi = growths(arb(s.mid()))[0] + growths(s)[1] * arb(0, s.rad())
        return all(fall > 0 for fall in contraction(Phi, w, s))

    return is_above_0(w) and holds_under(law, falls)


def growing_period(law: SamplingLaw, F: Callable[[arb], Matrix]) -> Witness | None:
    """A constant period T of the law with rho(F(T)) > 1, proved."""
    for T in (law.T_max, law.T_min):
        multiplier = spectral_radius_lower(F(T.ball())) if T.sign() == 1 else arb(0)
        if multiplier > 1:
            return Witness("constant", "plant", (str(T),), ((),), lower_text(multiplier), data={"arcs": [1]})
    return None


def tried_periods(law: SamplingLaw, count: int) -> Array:
    """Periods of a law for a search in floats, denser at both ends."""
    low, high = float(law.T_min), float(law.T_max)
    shares = (1 - np.cos(np.pi * np.arange(count + 1) / count)) / 2
    return np.array([high]) if low == high else low + (high - low) * shares


def law_ends(law: SamplingLaw) -> tuple[Fraction, Fraction]:
    """Rational ends of an interval that holds every period of the law."""
    low, high = arb_fraction(law.T_min.ball().lower()), arb_fraction(law.T_max.ball().upper())
    return max(Fraction(0), low), high


def interval(low: Fraction, high: Fraction) -> arb:
    """The ball that holds [low, high]."""
    return hull(fraction_ball(low), fraction_ball(high))


def holds_under(law: SamplingLaw, holds: Callable[[arb], bool]) -> bool:
    """Whether what can be proved of all numbers of a ball is proved of every period of the law."""
    return holds_between(holds, *law_ends(law))


def holds_between(holds: Callable[[arb], bool], low: Fraction, high: Fraction) -> bool:
    """Whether what can be proved of all numbers of a ball is proved of those in [low, high]."""
    return covered(lambda a, b: holds(interval(a, b)), low, high)


def is_at_least_0(values: Matrix) -> bool:
    """Whether no entry is negative, proved."""
    return all(arb(value) >= 0 for row in values.tolist() for value in row)


def is_above_0(values: Matrix) -> bool:
    """Whether every entry is positive, proved."""
    return all(arb(value) > 0 for row in values.tolist() for value in row)
