"""A proved bound of the error along time, from the certificate behind `convergence`."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from flint import arb

from cdobs_cli.certificate import Certificate, Check
from cdobs_cli.certify import clock
from cdobs_cli.certify.bernstein import elevation
from cdobs_cli.certify.definite import positive_definite
from cdobs_cli.design import Design
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.lpv_zoh import wirtinger
from cdobs_cli.families.lpv_zoh.claims import Proved, reprove
from cdobs_cli.families.lpv_zoh.laws import at_period, covers
from cdobs_cli.families.lpv_zoh.printed import eigenvalue_range
from cdobs_cli.plant import Plant

_ELEVATIONS = (0, 6, 18, 40)


def envelope(plant: Plant, design: Design, check: Check) -> Mapping[str, Any] | None:
    """|e(t)| <= factor |e(0)| exp(-rate t), from the certificates that cover the law; the fastest that has one.

    Wirtinger: V >= e'Pe with equality at a sample, so factor^2 = lambda_max(P) / lambda_min(P). Clock:
    factor^2 = lambda_max(P_11(0)) over the least eigenvalue of P(tau) on [0, T_max].
    """
    plant = at_period(plant, design.sampling.T_max)
    found = []
    for certificate in design.certificates:
        if covers(certificate, design.sampling):
            proof = reprove(plant, design.gain["L"], certificate)
            factor = None if proof is None else _factor(proof, plant.n)
            if proof is not None and factor is not None:
                found.append({"factor": factor, "rate": float(proof.rate.lower())})
    return max(found, key=lambda bound: (bound["rate"], -bound["factor"]), default=None)


def _factor(proof: Proved, n: int) -> float | None:
    certificate = proof.certificate
    if certificate.method == wirtinger.METHOD:
        P = ExactMatrix(certificate.data["P"]).balls()
        return _root_of_quotient(eigenvalue_range(P, smallest=False).high, eigenvalue_range(P, smallest=True).low)
    if certificate.method == clock.METHOD:
        return _clock_factor(certificate, n)
    return None


def _root_of_quotient(high: Any, low: Any) -> float | None:
    quotient = arb(high) / arb(low)
    return float(quotient.sqrt().upper()) if arb(low) > 0 and quotient.is_finite() else None


def _clock_factor(certificate: Certificate, n: int) -> float | None:
    """P(tau) >= m I from the Bernstein coefficients of its pieces, elevated until they are definite."""
    data = certificate.data
    degree = int(data["degree"])
    S = Matrix.from_rows([[Fraction(text) for text in row] for row in data["basis"]])
    back = S.inverse()
    P = [back.T @ clock.symmetric_from_upper(rows) @ back for rows in data["P"]]
    least: Fraction | None = None
    for start in range(0, len(P) - degree, degree):
        margin = _least(P[start : start + degree + 1])
        if margin is None:
            return None
        least = margin if least is None else min(least, margin)
    high = eigenvalue_range(P[0][:n, :n], smallest=False).high
    return None if least is None else _root_of_quotient(high, Matrix.from_rows([[least]])[0, 0])


def _least(coefficients: list[Matrix]) -> Fraction | None:
    """m > 0 with P(tau) >= m I on one piece; None where no elevation tried shows one."""
    degree = len(coefficients) - 1
    for more in _ELEVATIONS:
        margins = []
        for weights in elevation(degree, degree + more):
            total = coefficients[0] * 0
            for weight, coefficient in zip(weights, coefficients, strict=True):
                total = total + coefficient * weight
            margins.append(positive_definite(total).margin)
            if not margins[-1]:
                break
        proved = [margin for margin in margins if margin]
        if len(proved) == len(margins):
            return min(proved)
    return None
