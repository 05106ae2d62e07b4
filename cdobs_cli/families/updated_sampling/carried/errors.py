"""What noise and disturbance leave of the error along a carried certificate, in balls.

With K of the law V = e'Pi e has V+ <= V + v'Lambda v at a sample and V' <= -2 sigma r V + sum_i d_i^2 / gamma_i between
samples (2 e'Pi d <= sum_i gamma_i (Pi e)_i^2 + d_i^2 / gamma_i, and B holds gamma). Samples are T_min apart or more, so

    lim sup V <= N + D just after samples, N = sum_k Lambda_k v_k^2 / (1 - exp(-s T_min)),
    D = sum_i d_i^2 / gamma_i / s, s = 2 sigma idle, and lim sup V <= N exp(-s t) + D at a time t after the last one.

From T_min on Pi >= F, so e_i^2 <= W (F^-1)_ii with W = N exp(-s T_min) + D; before, e_i^2 <= (N exp(-s t) + D)
(Pi(t; cbar)^-1)_ii, which is proved to be at most a little more.

For noise of covariance R, s int V <= V(0) + sum_k (V_k+ - V_k), of mean tr(Lambda R) a sample at most: the mean of e'e
over time is at most (tr(Lambda R) / T_min + sum_i d_i^2 / gamma_i) / (s zeta lambda_min(F)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import reduce

from flint import arb

from cdobs_cli.certificate import Bound
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import upper_text
from cdobs_cli.families.updated_sampling.carried.law import Law
from cdobs_cli.families.updated_sampling.carried.proof import keeps_inverse, least_eigenvalue
from cdobs_cli.plant import Entry, Plant

_DIGITS = 9
_LARGEST = 1e100  # of what a spec may hold: beyond it nothing is said
METHOD = "carried"
_MORE = tuple(Fraction(text) for text in ["1.001", "1.01", "1.03", "1.1", "1.2", "1.4", "2"])


def bounds(plant: Plant, law: Law, largest: Mapping[Entry, Fraction], share: Fraction) -> dict[str, Bound]:
    """`error.<state>` of bounded noise and disturbance, `rms` of noise with a covariance; of a law that is proved, with
    its zeta. Empty where nothing is declared, or a disturbance is not in the law."""
    steady = _disturbed(plant, law)
    if not plant.is_perturbed or plant.intensity is not None or steady is None:
        return {}
    if plant.covariance is not None:
        return _mean_square(plant, law, share, steady)
    about = "largest error that is left, of every run, noise and disturbance within the declared bounds"
    errors = _peaks(plant, law, largest, share, steady)
    if not all(error.is_finite() and error.upper() < _LARGEST for error in errors):
        return {}
    return {f"error.{state}": _bound(error, about) for state, error in zip(plant.states, errors, strict=True)}


def _slowest(law: Law) -> arb:
    """s = 2 sigma idle."""
    return 2 * arb(law.sigma.scalar) * arb(law.idle.scalar)


def _of_sample(law: Law, squares: Sequence[arb]) -> arb:
    """The most that a sample adds: sum_k Lambda_k v_k^2 over what is read."""
    sums = (sum((arb(one.scalar) * square for one, square in zip(weights, squares, strict=True)), arb(0))
            for weights in law.readings)  # fmt: skip
    return reduce(arb.max, sums)


def _peaks(plant: Plant, law: Law, largest: Mapping[Entry, Fraction], share: Fraction, steady: arb) -> list[arb]:
    """The largest error of each state, by trying how little more than that at samples holds between them."""
    s, T = _slowest(law), arb(law.T_min.scalar)
    sizes = [arb(0)] * plant.p if plant.noise is None else [arb(size) for size in plant.noise.sizes]
    N = _of_sample(law, [size**2 for size in sizes]) / (1 - (-s * T).exp())
    D = steady / s
    W = N * (-s * T).exp() + D
    inverse = law.F.balls().inverse().balls()
    squares = []
    for i in range(plant.n):
        square = (N + D) * inverse[i, i] / fraction_ball(share)
        for more in _MORE:
            smaller = W * inverse[i, i] * fraction_ball(more)
            if not smaller < square:
                break

            def limit(t: Fraction, square: arb = smaller) -> arb:
                return square / (N * (-s * fraction_ball(t)).exp() + D)

            if keeps_inverse(plant, law, largest, i, limit):
                square = smaller
                break
        squares.append(square)
    return [square.sqrt() for square in squares]


def _mean_square(plant: Plant, law: Law, share: Fraction, steady: arb) -> dict[str, Bound]:
    assert plant.covariance is not None
    noise = _of_sample(law, [arb(plant.covariance[k, k].scalar) for k in range(plant.p)])
    low = least_eigenvalue(law.F.balls()) * fraction_ball(share)
    if not low > 0:
        return {}
    rms = ((noise / arb(law.T_min.scalar) + steady) / (_slowest(law) * low)).sqrt()
    return {"rms": _bound(rms, "root of the mean over time of E |x_hat - x|^2")} if rms.is_finite() else {}


def _bound(value: arb, about: str) -> Bound:
    return Bound(upper_text(value, _DIGITS), None, "", METHOD, about, "less")


def _disturbed(plant: Plant, law: Law) -> arb | None:
    """sum_i d_i^2 / gamma_i; None where a disturbance has no gamma."""
    total = arb(0)
    for size, gamma in zip(
        () if plant.disturbance is None else plant.disturbance.sizes, law.gamma.rows[0], strict=False
    ):
        if not arb(size).is_zero():
            if gamma.sign() != 1:
                return None
            total += arb(size) ** 2 / arb(gamma.scalar)
    return total
