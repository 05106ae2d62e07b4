"""Where the widths of the bounds settle, proved, for each way to tighten them."""

from __future__ import annotations

from flint import arb

from cdobs_cli.certificate import Bound, Status
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import lower_text, upper_text
from cdobs_cli.families.interval.analysis import Analysis, declared_widths, matrices
from cdobs_cli.families.interval.boundedness import final_width
from cdobs_cli.families.interval.held_loop import law_ends
from cdobs_cli.families.interval.hull import hull_width, prove_hull
from cdobs_cli.families.interval.intersect import intersected_width, measured_rows
from cdobs_cli.families.interval.parts import absolute


def final_widths(a: Analysis, parts: dict[str, Status]) -> None:
    """Where the widths of x settle under the declared disturbance and noise: in all, and for each state."""
    disturbance, noise = declared_widths(a.plant)
    exact, widths, method = False, None, "closed form"
    if "contraction" in parts:
        method = "hull predictor, at any time"
        stored = a.matrix("hull", "w")
        if stored is not None and parts["contraction"] == "proved" and stored[0] == a.law:
            widths = hull_width(*matrices(a), stored[1], disturbance, noise, a.law, ordered_width(a, disturbance, noise))
    elif a.cuts:
        widths, method = intersect_width(a, disturbance, noise), "intersection, at any time"
    else:
        widths, exact = plain_width(a, disturbance, noise), True
    if widths is None:
        return
    values = [arb(widths[i, 0]) for i in range(a.plant.n)]
    rows = {"final_width": sum(values[1:], values[0])} | {
        f"final_width.{name}": value for name, value in zip(a.plant.states, values, strict=True)
    }
    for name, value in rows.items():
        about = "sum over the states" if name == "final_width" else None
        a.bounds[name] = Bound(upper_text(value), lower_text(value) if exact else None, unit="", method=method, about=about, better="less")


def ordered_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix | None:
    """The final width of z where E(s) >= 0 and Mtot Hurwitz are proved for the law: no width stays above it,
    whatever is cut from it at samples."""
    if not a.ordered or a.hurwitz_rate is None:
        return None
    w: Matrix = (-a.Mtot).solve(_delta_width(a, disturbance, noise))
    return w


def plain_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix | None:
    """The final width of x without any cut: the fixed point of the width, where its map is proved to contract under
    the law; None else, or where the bounds are known to lose the state."""
    statuses = {claim.id: claim.status for claim in a.claims}
    if a.cuts or statuses.get("positivity") == "refuted":
        return None
    settles = a.hurwitz_rate is not None if a.ordered else a.shrinks or a.contracts
    if not settles:
        return None
    try:
        x: Matrix = final_width(a.z, a.Mtot, disturbance, noise)
    except ZeroDivisionError:
        return None
    return x


def intersect_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix | None:
    """|S^-1| times the final width of z with measured rows cut at samples; it needs E(s) >= 0: a cut is no linear
    map, and only order carries it on."""
    w = ordered_width(a, disturbance, noise)
    if w is None:
        return None
    rows = measured_rows(a.plant.C.balls(), a.z.S)
    c = _delta_width(a, disturbance, noise)
    return absolute(a.z.R) @ intersected_width(a.z, rows, w, c, noise, law_ends(a.law)[1])


def _delta_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix:
    """|S| (d_upper - d_lower) + |S L| (v_upper - v_lower)."""
    return absolute(a.z.S) @ disturbance + absolute(a.z.SL) @ noise


def comparison(a: Analysis) -> dict[str, Matrix]:
    """Proved final widths of x for each way to tighten the bounds of one design, where they are proved. Reads the
    claim `positivity` of the analysis."""
    disturbance, noise = declared_widths(a.plant)
    found: dict[str, Matrix] = {}
    known = ordered_width(a, disturbance, noise)
    if not a.departs:
        none = absolute(a.z.R) @ known if known is not None else plain_width(a, disturbance, noise)
        ways = {"none": none, "intersect": intersect_width(a, disturbance, noise)}
        found |= {name: width for name, width in ways.items() if width is not None}
    stored = a.matrix("hull", "w")
    if stored is not None and stored[0] == a.law and prove_hull(*matrices(a), stored[1], a.law):
        widths = hull_width(*matrices(a), stored[1], disturbance, noise, a.law, known)
        if widths is not None:
            found["hull"] = widths
    return found
