"""Printed data, or those found by method theorem_1, put to the test: each condition, the gain, the vertices."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Bound, Claim, Status, Witness
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix, upper_text
from cdobs_cli.families.lpv_zoh import printed
from cdobs_cli.families.lpv_zoh.printed_search import PrintedTheorem1
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold


def printed_data(family: LpvZeroOrderHold, plant: Plant, design: Design) -> list[tuple[str, str, printed.Printed]]:
    """(prefix of the claims, where, data) for the printed (P, Y), or for those that method theorem_1 found: at the
    corners of the slope class, and at the printed vertices where there are some."""
    found = next((c for c in design.certificates if c.method == PrintedTheorem1.name), None)
    if family.printed is not None:
        P, Y = family.printed.P, family.printed.Y
    elif found is not None:
        P, Y = (ExactMatrix(found.data[name]) for name in ("P", "Y"))
    else:
        return []
    L = design.gain["L"]
    view = PlantView.balls(plant, {"L": L})
    # (P, Y) printed without a gain stand for L = P^-1 Y, not for the gain that was found.
    given = L if family.gain is not None or family.printed is None else None
    places = [("theorem_1", "at the corners of the slope class", tuple(view.vertices))]
    if family.printed is not None and family.printed.vertices is not None:
        typed = tuple(vertex.balls() for vertex in family.printed.vertices)
        places.append(("theorem_1.printed_vertices", "at the printed vertices", typed))
    made = [(prefix, where, printed.Printed.of(P, Y, given, view.C, vertices)) for prefix, where, vertices in places]
    return [(prefix, where, data) for prefix, where, data in made if data is not None]


def printed_claims(family: LpvZeroOrderHold, plant: Plant, design: Design) -> tuple[list[Claim], dict[str, Bound]]:
    """Each printed condition, and where the conditions end."""
    L = design.gain["L"]
    claims: list[Claim] = []
    bounds: dict[str, Bound] = {}
    for prefix, where, data in printed_data(family, plant, design):
        claims += printed.claims(data, plant.sampling.T_max, prefix, where)
        bounds["tau_max" + prefix.removeprefix("theorem_1")] = printed.tau_max_bound(data)
    if family.printed is not None and family.gain is not None:
        claims.append(_gain_claim(family.printed.P, family.printed.Y, L))
    if family.printed is not None and family.printed.vertices is not None:
        claims.append(_vertices_claim(plant, family.printed.vertices))
    return claims, bounds


def _gain_claim(P: ExactMatrix, Y: ExactMatrix, L: ExactMatrix) -> Claim:
    """Is L = P^-1 Y for some P, Y that round to those typed?

    Row i of P L = Y asks for |(P L - Y)_i| <= sum_j h_ij |L_j| + h_i with h half units of last digits. Changing
    P_ii and Y_i alone is enough; no change of all entries makes up for more than the sum.
    """
    n = L.shape[0]
    residual = (P.balls() @ L.balls() - Y.balls()).balls()
    rows = []
    for i in range(n):
        r = abs(arb(residual[i, 0]))
        own = _half_unit(P[i, i]) * abs(L[i, 0].ball()) + _half_unit(Y[i, 0])
        most = sum((_half_unit(P[i, j]) * abs(L[j, 0].ball()) for j in range(n)), _half_unit(Y[i, 0]))
        rows.append((r, own, most))
    status: Status = "undecided"
    if all(r <= own for r, own, _ in rows):
        status = "proved"
    elif any(r > most for r, _, most in rows):
        status = "refuted"
    worst = max((r for r, _, _ in rows), key=lambda r: float(r.mid()))
    residuals = [upper_text(r, 6) for r, _, _ in rows]
    return Claim(
        "theorem_1.gain", "printed", status, "L = P^-1 Y for some P, Y that round to those printed", printed.SOURCE,
        margin=upper_text(worst, 6), method="theorem_1",
        witness=Witness("vector", "class", data={"|P L - Y|": residuals}) if status == "refuted" else None,
    )  # fmt: skip


def _half_unit(number: Exact) -> arb:
    """Half the unit of the last digit of a decimal."""
    digits = str(number).partition(".")[2]
    return Exact(Fraction(1, 2 * 10 ** len(digits))).ball()


def _vertices_claim(plant: Plant, vertices: tuple[ExactMatrix, ...]) -> Claim:
    """Is each printed vertex A + V with V in the declared slope box?"""
    outside: list[dict[str, Any]] = []
    inside = True
    for k, vertex in enumerate(vertices):
        for i in range(plant.n):
            for j in range(plant.n):
                value = vertex[i, j] - plant.A[i, j]
                signs = (value - plant.slopes.lower[i, j]).sign(), (plant.slopes.upper[i, j] - value).sign()
                inside = inside and None not in signs
                if -1 in signs:
                    outside.append({"vertex": k + 1, "entry": [i + 1, j + 1], "slope": str(value)})
    return Claim(
        "theorem_1.vertices", "printed", "refuted" if outside else "proved" if inside else "undecided",
        "The printed vertices are A + V with V in the declared slopes", "Boukal2020, (25), (43)", method="theorem_1",
        witness=Witness("vector", "class", data={"outside": outside}) if outside else None,
    )  # fmt: skip
