"""Where the widths of the bounds settle, proved, for each way to tighten them."""

from __future__ import annotations

from cdobs_cli.certificate import Bound, Status
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import lower_text, upper_text
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.held import law_ends
from cdobs_cli.families.interval.hull import Hull, hull_width
from cdobs_cli.families.interval.hurwitz import final_width
from cdobs_cli.families.interval.intersect import intersected_width
from cdobs_cli.families.interval.parts import absolute, entries


def final_widths(a: Analysis, parts: dict[str, Status]) -> None:
    """Where the widths of x settle under the declared disturbance and noise: in all, and for each state."""
    exact = False
    if "contraction" in parts:
        widths, method = tightest_hull(a), "hull predictor, at any time"
    elif a.system.cut:
        widths, method = intersect_width(a), "intersection, at any time"
    else:
        widths, method, exact = plain_width(a), "closed form", True
    if widths is None:
        return
    values = entries(widths)
    rows = {"final_width": sum(values[1:], values[0])} | {
        f"final_width.{name}": value for name, value in zip(a.plant.states, values, strict=True)
    }
    for name, value in rows.items():
        about = "sum over the states" if name == "final_width" else None
        refuted = lower_text(value) if exact else None
        a.bounds[name] = Bound(upper_text(value), refuted, unit="", method=method, about=about, better="less")


def ordered_width(a: Analysis) -> Matrix | None:
    """The final width of z where E(s) >= 0 and Mtot Hurwitz are proved for the law: no width stays above it,
    whatever is cut from it at samples."""
    if not a.ordered or a.hurwitz_rate is None:
        return None
    w: Matrix = (-a.system.Mtot).solve(a.system.delta_width)
    return w


def plain_width(a: Analysis) -> Matrix | None:
    """The final width of x without any cut: the fixed point of the width, where its map is proved to contract under
    the law; None else, or where the bounds are known to lose the state."""
    if a.system.cut or a.status("positivity") == "refuted":
        return None
    if not (a.hurwitz_rate is not None if a.ordered else a.shrinks or a.contracts):
        return None
    try:
        x: Matrix = final_width(a.system.z, a.system.Mtot, *a.system.widths)
    except ZeroDivisionError:
        return None
    return x


def intersect_width(a: Analysis) -> Matrix | None:
    """|S^-1| times the final width of z with measured rows cut at samples; it needs E(s) >= 0: a cut is no linear
    map, and only order carries it on."""
    w, system = ordered_width(a), a.system
    if w is None:
        return None
    noise, high = system.widths[1], law_ends(a.law)[1]
    x: Matrix = absolute(system.z.R) @ intersected_width(system.z, system.rows, w, system.delta_width, noise, high)
    return x


def tightest_hull(a: Analysis) -> Matrix | None:
    """The final width of x with the hull predictor, where it is proved to contract under the law."""
    hull = a.own(Hull)
    return None if hull is None else hull_width(a.system, hull.w.balls(), a.law, ordered_width(a))


def comparison(a: Analysis) -> dict[str, Matrix]:
    """Proved final widths of x for each way to tighten the bounds of one design, where they are proved. Reads the
    claim `positivity` of the analysis."""
    ways = {"hull": tightest_hull(a)}
    if not a.departs:
        known = ordered_width(a)
        none = absolute(a.system.z.R) @ known if known is not None else plain_width(a)
        ways = {"none": none, "intersect": intersect_width(a)} | ways
    return {name: width for name, width in ways.items() if width is not None}
