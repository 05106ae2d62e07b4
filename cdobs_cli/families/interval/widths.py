"""Where the widths of the bounds settle, proved, for each way to tighten them."""

from __future__ import annotations

from typing import Any

from flint import arb

from cdobs_cli.certificate import Bound, Status
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, lower_text, upper_text
from cdobs_cli.families.interval.analysis import Analysis, matrices
from cdobs_cli.families.interval.boundedness import final_width
from cdobs_cli.families.interval.held_loop import law_ends
from cdobs_cli.families.interval.hull import hull_width, prove_hull
from cdobs_cli.families.interval.intersect import intersected_width, measured_rows
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.plant import Plant


def declared_widths(plant: Plant) -> tuple[Matrix, Matrix]:
    """upper - lower of disturbance and noise in balls, zeros where none is declared."""

    def widths(box: Any, size: int) -> Matrix:
        if box is None:
            return Matrix.zeros(size, 1)
        return ExactMatrix([[high - low] for low, high in zip(box.lower, box.upper, strict=True)]).balls()

    return widths(plant.disturbance, plant.n), widths(plant.noise, plant.p)


def final_widths(a: Analysis, parts: dict[str, Status]) -> None:
    """Where the widths of x settle under the declared disturbance and noise: in all, and for each state."""
    disturbance, noise = declared_widths(a.plant)
    exact = parts.get("boundedness") == "proved"
    widths: Matrix | None = None
    method = "closed form"
    if "contraction" in parts:
        exact, method = False, "hull predictor, at any time"
        stored = a.matrix("hull", "w")
        if stored is not None and parts["contraction"] == "proved" and stored[0] == a.law:
            widths = hull_width(*matrices(a), stored[1], disturbance, noise, a.law, bounded_width(a, disturbance, noise))
    elif exact:
        if a.family.tighten == "intersect":
            widths, exact, method = intersect_width(a, disturbance, noise), False, "intersection, at any time"
        else:
            widths = final_width(a.z, a.Mtot, disturbance, noise)
    if widths is None:
        return
    values = [arb(widths[i, 0]) for i in range(a.plant.n)]
    rows = {"final_width": sum(values[1:], values[0])} | {
        f"final_width.{name}": value for name, value in zip(a.plant.states, values, strict=True)
    }
    for name, value in rows.items():
        about = "sum over the states" if name == "final_width" else None
        a.bounds[name] = Bound(upper_text(value), lower_text(value) if exact else None, unit="", method=method, about=about)


def bounded_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix | None:
    """The final width of z by positivity and boundedness, where both are proved for the law."""
    statuses = {claim.id: claim.status for claim in a.claims}
    if statuses.get("positivity") != "proved" or statuses.get("boundedness") != "proved":
        return None
    return (-a.Mtot).solve(absolute(a.z.S) @ disturbance + absolute(a.z.SL) @ noise)


def intersect_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix:
    """|S^-1| times the final width of z with measured rows cut at samples."""
    c = absolute(a.z.S) @ disturbance + absolute(a.z.SL) @ noise
    w = (-a.Mtot).solve(c)
    rows = measured_rows(a.plant.C.balls(), a.z.S)
    return absolute(a.z.R) @ intersected_width(a.z, rows, w, c, noise, law_ends(a.law)[1])


def comparison(a: Analysis) -> dict[str, Matrix]:
    """Proved final widths of x for each way to tighten the bounds of one design, where they are proved. Reads
    the claims `positivity` and `boundedness` of the analysis."""
    disturbance, noise = declared_widths(a.plant)
    found: dict[str, Matrix] = {}
    if bounded_width(a, disturbance, noise) is not None and not a.departs:
        found["none"] = final_width(a.z, a.Mtot, disturbance, noise)
        found["intersect"] = intersect_width(a, disturbance, noise)
    stored = a.matrix("hull", "w")
    if stored is not None and stored[0] == a.law and prove_hull(*matrices(a), stored[1], a.law):
        widths = hull_width(*matrices(a), stored[1], disturbance, noise, a.law, bounded_width(a, disturbance, noise))
        if widths is not None:
            found["hull"] = widths
    return found
