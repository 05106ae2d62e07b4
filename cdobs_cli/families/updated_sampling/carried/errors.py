"""What noise and disturbance leave of the error along a carried certificate, in balls.

With K of the law V = e'Pi e has V+ <= V + v'Lambda v at a sample and V' <= -2 sigma r V + sum_i d_i^2 / gamma_i between
samples (2 e'Pi d <= sum_i gamma_i (Pi e)_i^2 + d_i^2 / gamma_i, and B holds gamma). Samples are T_min apart or more, so

    lim sup V <= W = sum_k Lambda_k v_k^2 / (1 - exp(-s T_min)) + sum_i d_i^2 / gamma_i / s,  s = 2 sigma idle,

and Pi >= zeta F gives e_i^2 <= W (F^-1)_ii / zeta. For noise of covariance R, s int V <= V(0) + sum_k (V_k+ - V_k),
of mean tr(Lambda R) a sample at most: the mean of e'e over time is at most
(tr(Lambda R) / T_min + sum_i d_i^2 / gamma_i) / (s zeta lambda_min(F)).
"""

from __future__ import annotations

from fractions import Fraction

from flint import arb

from cdobs_cli.certificate import Bound
from cdobs_cli.certify.definite import eigenvalue_range
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import upper_text
from cdobs_cli.families.updated_sampling.carried.law import Law
from cdobs_cli.plant import Plant

_DIGITS = 9
METHOD = "carried"


def bounds(plant: Plant, law: Law, share: Fraction) -> dict[str, Bound]:
    """`error.<state>` of bounded noise and disturbance, `rms` of noise with a covariance; a law that is proved, with
    its zeta. Empty where nothing is declared, or a disturbance is not in the law."""
    if not plant.is_perturbed or plant.intensity is not None:
        return {}
    steady = _disturbed(plant, law)
    if steady is None:
        return {}
    slowest = 2 * arb(law.sigma.scalar) * arb(law.idle.scalar)
    T = arb(law.T_min.scalar)
    weights = [arb(one.scalar) for one in law.Lambda.rows[0]]
    F = law.F.balls()
    if plant.covariance is not None:
        noise = sum((arb(plant.covariance[k, k].scalar) * one for k, one in enumerate(weights)), arb(0))
        low = arb(eigenvalue_range(F, smallest=True).low) * fraction_ball(share)
        rms = ((noise / T + steady) / (slowest * low)).sqrt() if low > 0 else arb("inf")
        return {"rms": _bound(rms, "root of the mean over time of E |x_hat - x|^2")} if rms.is_finite() else {}
    sizes = [arb(0)] * plant.p if plant.noise is None else [arb(size) for size in plant.noise.sizes]
    noise = sum((weight * size**2 for weight, size in zip(weights, sizes, strict=True)), arb(0))
    W = noise / (1 - (-slowest * T).exp()) + steady / slowest
    inverse = F.inverse().balls()
    errors = [(W * inverse[i, i] / fraction_ball(share)).sqrt() for i in range(plant.n)]
    about = "largest error that is left, of every run, noise and disturbance within the declared bounds"
    return {f"error.{state}": _bound(error, about) for state, error in zip(plant.states, errors, strict=True)}


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
