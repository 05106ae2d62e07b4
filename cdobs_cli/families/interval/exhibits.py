"""What the report shows of this family: widths over time, the positivity that decides the period, the trade-off
between period and width, and the ways to tighten the bounds side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from cdobs_cli.certificate import Check
from cdobs_cli.chart import Chart, Exhibits, Panel, Series, Table
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import upper_text
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.design import residuals
from cdobs_cli.families.interval.parts import entries
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.widths import comparison
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

MAX_PANELS = 6


def exhibits(family: Interval, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """Charts and tables of one design; what there is no data for is left out."""
    if design.outcome == "none":
        return Exhibits()
    charts = [width_chart(plant, check, run), positivity_chart(plant, design, check), trade_off_chart(design, check)]
    tables = [comparison_table(family, plant, design, check), sylvester_table(plant, design)]
    return Exhibits(tuple(chart for chart in charts if chart), tuple(table for table in tables if table), _notes(check))


def width_chart(plant: Plant, check: Check | None, run: Run | None) -> Chart | None:
    """x_upper - x_lower against time with its proved limit."""
    if run is None or not run.trajectories or "x_lower" not in run.trajectories[0].estimates:
        return None
    first = run.trajectories[0]
    width = first.estimates["x_upper"] - first.estimates["x_lower"]
    panels = []
    for j, name in enumerate(plant.states[:MAX_PANELS]):
        series = [Series("width", first.t, width[:, j], "line", "estimate")]
        bound = check.bounds.get(f"final_width.{name}") if check is not None else None
        if bound is not None and bound.proved is not None:
            series.append(Series("proved final width", (first.t[0],), (float(bound.proved),), "limit", "proved"))
        panels.append(Panel("time (s)", f"width of {name}", tuple(series), y_scale="log"))
    caption = "Distance of the two bounds of each state. "
    caption += "The proved final width holds for every signal in the declared intervals."
    return Chart("width", "Width of the interval estimate", caption, tuple(panels))


def positivity_chart(plant: Plant, design: Design, check: Check | None) -> Chart | None:
    """The diagonal entries of E(s) that can turn negative, up to a little beyond their first zero."""
    bound = check.bounds.get("positivity_period_max.orthant") if check is not None else None
    if check is None or bound is None or bound.refuted is None:
        return None
    errors, limit = System(plant, design.gain).errors, float(bound.refuted)
    s = np.linspace(0.0, 1.25 * max(limit, float(design.sampling.T_max)), 200)
    maps, N1 = errors.maps(s), errors.N1.floats
    if maps is None:
        return None
    E = maps[0]
    pulled = [j for j in range(plant.n) if N1[j, j] < 0]
    series = [Series(f"$E_{{{j + 1}{j + 1}}}(s)$", s, E[:, j, j], "line", "other") for j in pulled]
    series.append(Series("zero", (0.0,), (0.0,), "limit", "refuted"))
    series.append(Series("proved up to here", (float(bound.proved or 0),), (0.0,), "mark", "proved"))
    printed = check.bounds.get("positivity_period_max.theorem_1")
    if printed is not None and printed.proved is not None and float(printed.proved) <= s[-1]:
        series.append(Series("printed condition", (float(printed.proved),), (0.0,), "mark", "measured"))
    caption = "From every box of z the bounds stay in order between two samples while these entries are not negative; "
    panel = Panel("time since the sample (s)", "E(s)", tuple(series))
    return Chart("positivity", "Positivity between samples", f"{caption}no other fails first.", (panel,))


def trade_off_chart(design: Design, check: Check | None) -> Chart | None:
    """Least width sum found against the largest period; each point is a design of its own."""
    try:
        curve = design.details.get("trade_off") or []
        points = [(float(point["period"]), float(point["width_sum"])) for point in curve]
    except (KeyError, TypeError, ValueError):  # not what synthesis writes
        return None
    if len(points) < 2:
        return None
    periods, widths = zip(*points, strict=True)
    looks: tuple[tuple[str, Literal["line", "points"]], ...] = (("least width found", "line"), ("designs", "points"))
    series = [Series(label, periods, widths, kind, "other") for label, kind in looks]
    own = check.bounds.get("final_width") if check is not None else None
    if own is not None and own.proved is not None:
        T = float(design.sampling.T_max)
        series.append(Series("this design", (T,), (float(own.proved),), "points", "estimate"))
    caption = "Sum of the final widths against the largest sampling period; each point is an S and L of its own, "
    caption += "proved when it was found; what `check` proves again is this design."
    panel = Panel("largest sampling period (s)", "sum of final widths", tuple(series), y_scale="log")
    return Chart("trade_off", "Period against width", caption, (panel,))


def comparison_table(family: Interval, plant: Plant, design: Design, check: Check | None) -> Table | None:
    """Proved final widths for this S and L with each way to tighten the bounds."""
    found = comparison(Analysis(family, plant, design, 0, list(check.claims))) if check is not None else {}
    if not found:
        return None
    labels = {"none": "bounds of the observer", "intersect": "intersected with y at samples", "hull": "hull predictor"}
    widths = {labels[name]: [float(upper_text(value)) for value in entries(width)] for name, width in found.items()}
    rows = [(label, *values, sum(values)) for label, values in widths.items()]
    caption = "Largest width that each can settle at, proved, for the same S and L under the declared "
    caption += "disturbance and noise."
    return Table("widths", "Ways to tighten the bounds", caption, ("bounds", *plant.states, "sum"), tuple(rows))


def sylvester_table(plant: Plant, design: Design) -> Table | None:
    """Rates of the Sylvester equation, and what its printed solution leaves, computed anew."""
    found = design.details.get("sylvester")
    if not found:
        return None
    try:
        rates, directions = np.array(found["rates"], float), np.array(found["directions"], float)
        solved, structure = residuals(System(plant, design.gain), rates, directions)
    except (KeyError, TypeError, ValueError):  # not what synthesis writes
        return None
    rows: list[tuple[str | float, ...]] = [(f"rate {k + 1}", float(rate)) for k, rate in enumerate(rates)]
    rows.append(("residual of T A - Lambda T = G C, relative", solved))
    rows.append(("S L C S^-1 off its diagonal block, relative", structure))
    caption = "S = [C; T] in printed decimals. "
    caption += "The residuals do not matter for the proofs, which read the printed numbers."
    return Table("sylvester", "Sylvester equation", caption, ("quantity", "value"), tuple(rows))


def _notes(check: Check | None) -> tuple[str, ...]:
    if check is None:
        return ()
    notes = []
    printed, exact = (check.bounds.get(f"positivity_period_max.{name}") for name in ("theorem_1", "orthant"))
    if printed is not None and exact is not None and printed.proved and exact.proved and exact.proved != "inf":
        factor = float(exact.proved) / float(printed.proved)
        notes.append(f"The exact positivity limit is {factor:.3g} times the one of the printed condition.")
    separation, theorem_2 = check.claim("separation"), check.claim("theorem_2")
    if separation and theorem_2 and separation.status == "proved" and theorem_2.status != "proved":
        note = "The feedback is proved by separation; the small-gain condition of Theorem 2 does not hold for it"
        notes.append(f"{note}, and is not needed.")
    return tuple(notes)
