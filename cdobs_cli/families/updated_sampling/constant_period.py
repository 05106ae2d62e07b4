"""What a constant period can do for the same class with c known: the clock-dependent certificate beside Theorem 2'."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock, search
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

MAX_STATES = 3
METHOD = "constant_period"


def error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """edot = (A + V) e, e+ = (I - K C) e, for e = x_hat - x and a copy of the model corrected by K (y - C x_hat).

    Source: Andrieu2014, (10)
    """
    unit = [view.unit(i) for i in range(view.A.shape[0])]
    identity = unit[0] @ unit[0].T
    for column in unit[1:]:
        identity = identity + column @ column.T
    left, right = tuple(unit[i] for i, _ in view.entries), tuple(unit[j].T for _, j in view.entries)
    jump = identity - view.gain["K"] @ view.C if "K" in view.gain else identity
    return ErrorMaps(view.A, left, right, view.lower, view.upper, jump)


def class_with(plant: Plant, variant: str, c: Exact, T: Exact, gain: dict[str, ExactMatrix]) -> HybridInclusion:
    """All lower triangular (or last row) slopes up to c, measured every T. For the last row a superset of |.| <= c."""
    n = plant.n
    inside = [[i == n - 1 or (variant == "triangular" and j <= i) for j in range(n)] for i in range(n)]
    upper = ExactMatrix([[c if entry else Exact(0) for entry in row] for row in inside])
    lower = ExactMatrix([[-c if entry else Exact(0) for entry in row] for row in inside])
    slopes, law = Slopes(lower, upper), SamplingLaw.periodic(T)
    return HybridInclusion(error_maps, replace(plant, slopes=slopes, sampling=law), gain, law, slopes.uncertain)


def longest(plant: Plant, variant: str, c: Exact, effort: int) -> Certificate | None:
    """A gain and a proved certificate for a constant period, the longest found by bisection; n <= 3."""
    if plant.n > MAX_STATES or c.rational is None or c.rational <= 0:
        return None

    def prove(T: Exact) -> Certificate | None:
        found = clock.design_impulsive(class_with(plant, variant, c, T, {}), effort)
        if found is None:
            return None
        K, certificate = found
        gain = ExactMatrix.from_floats(K, clock.GAIN_DIGITS).texts()
        data = {**certificate.data, "K": gain, "method": certificate.method, "c": str(c)}
        return Certificate(METHOD, certificate.sampling, data)

    unit = Fraction(1 / float(c.rational)).limit_denominator(10**12)
    found = search.between(prove, Exact(unit / 40), Exact(2 * unit), Fraction(1, 50))
    return None if found is None else found[1]


def holds(plant: Plant, variant: str, c: Exact, certificate: Certificate) -> bool:
    """Whether a stored certificate proves its period for slopes up to c."""
    if certificate.data["c"] != str(c):
        return False
    gain = {"K": ExactMatrix(certificate.data["K"])}
    data = {key: value for key, value in certificate.data.items() if key not in ("K", "method", "c")}
    inclusion = class_with(plant, variant, c, certificate.sampling.T_max, gain)
    return clock.prove(inclusion, Certificate(certificate.data["method"], certificate.sampling, data)).proved
