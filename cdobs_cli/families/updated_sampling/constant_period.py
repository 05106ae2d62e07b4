"""What a constant period can do for the same class with c known: the clock-dependent certificate beside Theorem 2'."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import HybridInclusion, corrected_copy
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

MAX_STATES = 3
METHOD = "constant_period"


def class_with(plant: Plant, variant: str, c: Exact, T: Exact, gain: dict[str, ExactMatrix]) -> HybridInclusion:
    """All lower triangular (or last row) slopes up to c, measured every T. For the last row a superset of |.| <= c."""
    n = plant.n
    inside = [[i == n - 1 or (variant == "triangular" and j <= i) for j in range(n)] for i in range(n)]
    upper = ExactMatrix([[c if entry else Exact(0) for entry in row] for row in inside])
    lower = ExactMatrix([[-c if entry else Exact(0) for entry in row] for row in inside])
    slopes, law = Slopes(lower, upper), SamplingLaw.periodic(T)
    return HybridInclusion(corrected_copy, replace(plant, slopes=slopes, sampling=law), gain, law, slopes.quantities)


def longest(plant: Plant, variant: str, c: Exact) -> Certificate | None:
    """A gain and a proved certificate for a constant period, the longest found by bisection; n <= 3."""
    if plant.n > MAX_STATES or c.rational is None or c.rational <= 0:
        return None
    nothing = {"K": ExactMatrix([[0] * plant.p for _ in range(plant.n)])}

    def prove(T: Exact) -> Certificate | None:
        met = design_impulsive(Question(class_with(plant, variant, c, T, nothing), effort=0))
        if met is None:
            return None
        K, method = met
        certificate = method.certificate({"K": K})
        return replace(certificate, method=METHOD, data={**certificate.data, "method": method.name, "c": str(c)})

    unit = Fraction(1 / float(c.rational)).limit_denominator(10**12)
    met = search.between(prove, Exact(unit / 40), Exact(2 * unit), Fraction(1, 50))
    return None if met is None else met[1]


def holds(plant: Plant, variant: str, c: Exact, certificate: Certificate) -> bool:
    """Whether a stored certificate proves its period for slopes up to c. Raises: KeyError on another's data."""
    data = dict(certificate.data)
    if data.pop("c") != str(c):
        return False
    stored = read(replace(certificate, method=data.pop("method"), data=data), GENERAL.methods, ("K",))
    if stored is None or stored.gain is None:
        return False
    inclusion = class_with(plant, variant, c, certificate.sampling.T_max, dict(stored.gain))
    return stored.method.prove(Question(inclusion)).holds
