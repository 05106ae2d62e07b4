"""The verb synthesize: c, then the gain by Theorem 2' or Theorem 2, or certificates for a given gain."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.ball import has_spectral_radius_at_least
from cdobs_cli.design import Design, SolverRecord
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text
from cdobs_cli.families.updated_sampling import constant_period, paper_search, prime_search
from cdobs_cli.families.updated_sampling.lipschitz import Rate, derive_rate, read_rate, typed_rate
from cdobs_cli.families.updated_sampling.proof import Numbers, prove_prime, prove_theorem_2
from cdobs_cli.families.updated_sampling.theorems import Chain, one_step_map
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.families.updated_sampling import UpdatedSampling

    Array = NDArray[np.float64]

PRIME, PAPER = "theorem_2_prime", "theorem_2"
EVALUATIONS = (20, 60, 120, 240)
_DIGITS = 10


def rate_of(family: UpdatedSampling, plant: Plant) -> Rate:
    """c(x_hat, u): typed, or derived from phi over the domain."""
    return derive_rate(plant, family.variant) if family.c is None else typed_rate(plant, family.c)


def stored_rate(family: UpdatedSampling, plant: Plant, design: Design) -> Rate:
    """The c of a stored design; a typed c is that of the spec. Raises: KeyError, ValueError where there is none."""
    rate = read_rate(design.details["rate"], plant)
    if (family.c is not None) != (rate.origin == "typed") or (family.c is not None and family.c != rate.c):
        raise ValueError("its c(x_hat, u) is not that of the spec")
    return rate


def weight(family: UpdatedSampling, n: int) -> int:
    """a_3 / 2 of Theorem 2: n in the triangular form, 1 for the last row.

    Source: Andrieu2014; Andrieu2013
    """
    return n if family.variant == "triangular" else 1


def synthesize(family: UpdatedSampling, plant: Plant, effort: int) -> Design:
    """A gain with a certificate that is proved already, or the given gain with one where one is found; beside it
    what a constant period can do for the same slopes."""
    rate = rate_of(family, plant)
    made = _designed(family, plant, rate, effort)
    beside = None if rate.largest is None or made.outcome == "none" else constant_period.longest(plant, family.variant, rate.largest, 0)
    return made if beside is None else replace(made, certificates=(*made.certificates, beside))


def _designed(family: UpdatedSampling, plant: Plant, rate: Rate, effort: int) -> Design:
    none = Design(family.name, "none", plant.sampling, {}, details={"rate": rate.document()})
    if family.gain is not None:
        gain = family.gain
        given = {"K": gain.K} | {name: ExactMatrix([[getattr(gain, name)]]) for name in ("alpha", "a1", "a2", "a3")}
        certificate, record = _certificate_for(family, plant, given, EVALUATIONS[effort])
        return replace(none, outcome="given", gain=given, certificates=(certificate,) if certificate else (), solver=record)
    if rate.largest is None:
        return replace(
            none, reason=f"c(x_hat, u) = {rate.c} has no bound over the domain, so no period can be guaranteed; declare a domain"
        )
    c = float(rate.largest)
    if family.method == PAPER:
        return _paper_design(family, plant, none, c, EVALUATIONS[effort])
    return _prime_design(family, plant, none, c, EVALUATIONS[effort])


def _prime_design(family: UpdatedSampling, plant: Plant, none: Design, c: float, evaluations: int) -> Design:
    alpha = None if family.alpha is None else float(family.alpha)
    if plant.n > 4:
        evaluations //= 2
    outcome = prime_search.longest_period(plant.n, family.variant, c, evaluations, alpha)
    if outcome is None:
        return replace(none, reason="no P was found that meets the conditions of Theorem 2'")
    found, search = outcome
    exact_alpha = family.alpha or Exact(decimal_text(found.alpha, 4))
    for attempt in range(6):
        # Rounding costs a little room: a_1 a little smaller, a_2 a little larger, until the proof goes through.
        slack = 1 + 5e-4 * 4**attempt
        again = search.least_growth(float(exact_alpha), found.a_1_alpha / slack, found.p_3 * (1 - 1e-4))
        if again is None:
            continue
        gain = {
            "K": ExactMatrix.from_floats(again.K, 6), "alpha": ExactMatrix([[exact_alpha]]),
            "a1": ExactMatrix([[_down(again.a_1_alpha / float(exact_alpha), 4)]]),
            "a2": ExactMatrix([[_up(again.a_2 * slack, 5)]]), "a3": ExactMatrix([["0"]]),
        }  # fmt: skip
        certificate = prime_certificate(plant, again)
        if prove_prime(Numbers.of(gain), certificate, family.variant).holds:
            return replace(none, outcome="found", gain=gain, certificates=(certificate,), solver=search.record)
    return replace(none, reason="conditions of Theorem 2' were met in floating point, but could not be proved for rounded numbers")


def prime_certificate(plant: Plant, found: prime_search.Found) -> Certificate:
    """P and p_3 of Theorem 2', rounded."""
    data = {"P": ExactMatrix.from_floats(_symmetric(found.P), _DIGITS).texts(), "p_3": _down(found.p_3 * (1 - 1e-6), 8)}
    return Certificate(PRIME, plant.sampling, data)


def paper_certificate(plant: Plant, P: Array) -> Certificate:
    """P and p_1 .. p_4 of (8)-(9), rounded."""
    rounded = ExactMatrix.from_floats(_symmetric(P), _DIGITS)
    p_1, p_2, p_3, p_4 = paper_search.numbers(rounded.floats)
    data = {"P": rounded.texts(), "p_1": _down(p_1, 8), "p_2": _up(p_2, 8), "p_3": _down(p_3, 8), "p_4": _up(p_4, 8)}
    return Certificate(PAPER, plant.sampling, data)


def _paper_design(family: UpdatedSampling, plant: Plant, none: Design, c: float, evaluations: int) -> Design:
    import numpy as np

    w = weight(family, plant.n)
    alpha = None if family.alpha is None else float(family.alpha)
    found = paper_search.longest_period(plant.n, w, c, evaluations, alpha)
    if found is None:
        return replace(none, reason="no P, K and alpha were found that meet the conditions of Theorem 2")
    K = ExactMatrix.from_floats(found.K, 6)
    certificate = paper_certificate(plant, found.P)
    p_2, p_4 = (Fraction(Decimal(certificate.data[name])) for name in ("p_2", "p_4"))
    a_1 = _down(float(1 / (2 * p_2 * p_4)) * (1 - 1e-9), 6)
    exact_alpha = family.alpha or Exact(_down(found.alpha, 4))
    p = tuple(float(certificate.data[f"p_{k}"]) for k in range(1, 5))
    a_2 = paper_search.a_2_at(np.array(found.P), np.array(K.floats), p, float(exact_alpha), float(a_1), w)  # type: ignore[arg-type]
    gain = {
        "K": K, "alpha": ExactMatrix([[exact_alpha]]), "a1": ExactMatrix([[a_1]]),
        "a2": ExactMatrix([[_up(a_2 * (1 + 1e-4), 5)]]), "a3": ExactMatrix([[str(2 * w)]]),
    }  # fmt: skip
    proof = prove_theorem_2(Numbers.of(gain), certificate, w)
    if proof is None or not proof.holds:
        return replace(none, reason="conditions of Theorem 2 were met in floating point, but could not be proved for rounded numbers")
    return replace(none, outcome="found", gain=gain, certificates=(certificate,), solver=found.record)


def _certificate_for(
    family: UpdatedSampling, plant: Plant, gain: dict[str, ExactMatrix], evaluations: int
) -> tuple[Certificate | None, SolverRecord | None]:
    """A certificate of the method asked for, whether it proves all conditions or not; None where none was found."""
    import numpy as np

    K, alpha, a_1 = np.array(gain["K"].floats), float(gain["alpha"][0, 0]), float(gain["a1"][0, 0])
    numbers = Numbers.of(gain)
    if not np.all(np.isfinite(K)) or has_spectral_radius_at_least(one_step_map(Chain.exact(plant.n), numbers.K, numbers.alpha)):
        return None, None
    if family.method == PAPER:
        tried = [
            found
            for p_1 in (0.01, 0.05, 0.2)
            for p_3 in (0.2, 0.8)
            if (found := paper_search.matrices(plant.n, p_1, p_3, 4.0 * plant.n, K)) is not None
        ]
        if not tried:
            return None, None
        w = weight(family, plant.n)
        best = min(tried, key=lambda found: paper_search.a_2_at(found[0], K, paper_search.numbers(found[0]), alpha, a_1, w))
        return paper_certificate(plant, best[0]), best[2]
    search = prime_search.PrimeSearch(plant.n, family.variant)
    least = prime_search.best_p_3(search, alpha, a_1 * alpha, K, evaluations)
    return (None if least is None else prime_certificate(plant, least)), search.record


def _symmetric(P: Any) -> Any:
    return (P + P.T) / 2


def _down(value: float, digits: int) -> str:
    from flint import arb

    return lower_text(arb(value), digits)


def _up(value: float, digits: int) -> str:
    from flint import arb

    return upper_text(arb(value), digits)
