"""Theorem II.1, the continuous-time reference: with y(t) at hand, does one P serve every slope?"""

from __future__ import annotations

from fractions import Fraction
from math import comb

import numpy as np

from cdobs_cli.certificate import Certificate, Claim
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.base import UNREADABLE
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.reachability.theorems import lmi_6
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

REFERENCE = "theorem_2_1"
MAX_CORNERS = 64


def reference(plant: Plant) -> tuple[Certificate, ...]:
    """P and L of (6), rounded and proved; nothing where none was found.

    Source: Dinh2014, Theorem II.1, (6)
    """
    if plant.output_quantities:
        return ()
    if plant.is_canonical:
        return high_gain(plant)
    from cdobs_cli.certify.lmi import Program, full, symmetric

    if 2 ** len(plant.slopes.quantities) > MAX_CORNERS:
        return ()
    corners = PlantView.floats(plant, {}).vertices
    # In the states' own units of time: s_i e_i with s_i = omega^-(i-1), omega the size of the flow.
    size = max(float(np.linalg.norm(R, 2)) for R in corners) or 1.0
    C = plant.C.floats
    if not np.isfinite(size):
        return ()
    program = Program({"P": symmetric(plant.n), "L": full(plant.n, plant.p), "t": full(1, 1)})
    one = np.eye(plant.n)
    program.equate(lambda x: np.array([[np.trace(x["P"]) - 1.0]]))
    program.maximise(lambda x: x["t"])
    program.require(lambda x: x["P"] - x["t"][0, 0] * one)
    for R in corners:
        program.require(lambda x, R=R / size: lmi_6(x["P"], x["L"], R, C) - x["t"][0, 0] * one)  # type: ignore[misc]
    solution = program.solve()
    P, L = solution.values["P"], solution.values["L"] * size
    if not (np.all(np.isfinite(P)) and np.all(np.isfinite(L))):
        return ()
    P_text, L_text = ExactMatrix.from_floats((P + P.T) / 2, 12).texts(), ExactMatrix.from_floats(L, 12).texts()
    certificate = Certificate(REFERENCE, plant.sampling, {"P": P_text, "L": L_text})
    return (certificate,) if proves_reference(plant, certificate) else ()


def high_gain(plant: Plant) -> tuple[Certificate, ...]:
    """P and L of (6) in closed form for a canonical plant: theta P + A'P + P A = C'C, L = C'/2, theta large,

        P_ij = (-1)^(i+j) binomial(i + j - 2, j - 1) / theta^(i+j-1),    i, j from 1.

    Source: Dinh2014, Section III-B (the high-gain observer), (6)
    """
    n = plant.n
    for power in range(-20, 41, 2):
        theta = Fraction(2) ** power
        P = [[(-1) ** (i + j) * comb(i + j, j) / theta ** (i + j + 1) for j in range(n)] for i in range(n)]
        L = [[Fraction(1, 2) if i == 0 else Fraction(0)] for i in range(n)]
        certificate = Certificate(REFERENCE, plant.sampling, {"P": ExactMatrix(P).texts(), "L": ExactMatrix(L).texts()})
        if proves_reference(plant, certificate):
            return (certificate,)
    return ()


def proves_reference(plant: Plant, certificate: Certificate) -> bool:
    """Whether P > 0 and (6) holds at every corner R of A + V, for the stored P and L."""
    try:
        P, L = ExactMatrix(certificate.data["P"]), ExactMatrix(certificate.data["L"])
    except UNREADABLE:
        return False
    n, p = plant.n, plant.p
    if plant.output_quantities or P.shape != (n, n) or L.shape != (n, p):
        return False
    if any(P[i, j] != P[j, i] for i in range(n) for j in range(i)):
        return False
    C = plant.C.balls()
    return has_positive_pivots(P.balls()) and all(
        has_positive_pivots(lmi_6(P.balls(), L.balls(), R, C)) for R in PlantView.balls(plant, {}).vertices
    )


def reference_claims(plant: Plant, design: Design) -> list[Claim]:
    """The stored P and L of Theorem II.1, put to the test again."""
    return [
        Claim(
            "continuous", "certificate", "proved" if proves_reference(plant, certificate) else "undecided",
            "With y(t) measured all the time, one quadratic function serves every slope, so small periods are "
            "within reach "
            "(Proposition II.1).", "Dinh2014, Theorem II.1, (6)",
        )
        for certificate in design.certificates if certificate.method == REFERENCE
    ]  # fmt: skip
