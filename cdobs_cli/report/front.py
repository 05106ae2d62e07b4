"""The front of a design: what error or rate can be had at which period, as figures and a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cdobs_cli.chart import Chart, Panel, Series, Table
from cdobs_cli.design import Design, FrontPoint
from cdobs_cli.report.numbers import end_text, float_or_none

_DIGITS = 4
_SHOWN = 24  # numbers of a gain in a cell
_WITHOUT_DELAY = " Errors are those of an estimate without delays."


def front_charts(design: Design, states: Sequence[str], *, late: bool = False) -> Iterator[Chart]:
    """Proved errors, or rates, against the period; where the errors turn up stands a mark. late: whether measurements
    arrive late, of which the points do not know."""
    from cdobs_cli.report.trajectories import axis_name

    points = [(float_or_none(point.period), point) for point in design.front]
    known = [(T, point) for T, point in points if T is not None and T > 0]
    if len(known) < 2:
        return
    periods = [T for T, _ in known]
    named = [name for name in states if all(float_or_none(point.error.get(name)) is not None for _, point in known)]
    law = "period" if design.sampling.is_periodic else "largest period"
    if named:
        errors = {name: [float_or_none(point.error[name]) or 0.0 for _, point in known] for name in named}
        at = knee(periods, [sum(values) for values in zip(*(_relative(one) for one in errors.values()), strict=True)])
        panels = []
        for name, values in errors.items():
            series = [Series("proved, a gain for each period", periods, values, "line", "proved")]
            series.append(Series("", periods, values, "points", "proved"))
            own = float(design.sampling.period)
            at_knee = at is not None and math.isclose(own, periods[at], rel_tol=1e-3)
            label = "this design, at the knee" if at_knee else "this design"
            series.append(Series(label, [own], [0.0], "mark", "estimate"))
            if at is not None and not at_knee:
                series.append(Series("knee", [periods[at]], [0.0], "mark", "other"))
            panels.append(Panel("period (s)", f"error of {axis_name(name)}", tuple(series)))
        caption = (
            f"The least proved error against the {law}, each point with a gain of its own, for the slopes claimed."
        )
        caption += _WITHOUT_DELAY if late else ""
        if at is not None:
            caption += f" Up to the knee at {periods[at]:.4g} fewer samples cost little; beyond it they cost much."
        yield Chart("period_error", "Period against error", caption, tuple(panels))
    rates = [(T, float_or_none(point.rate)) for T, point in known]
    told = [(T, rate) for T, rate in rates if rate is not None]
    if len(told) > 1 and not named:
        series = [Series("a gain for each period", [T for T, _ in told], [rate for _, rate in told], "line", "proved")]
        series.append(Series("this design", [float(design.sampling.period)], [0.0], "mark", "estimate"))
        caption = f"The fastest decay rate that was proved against the {law}, each point with a gain of its own."
        panel = Panel("period (s)", "proved rate (1/s)", tuple(series))
        yield Chart("period_rate", "Period against rate", caption, (panel,))


def knee(periods: Sequence[float], values: Sequence[float]) -> int | None:
    """The point furthest below the chord from the first to the last, both axes scaled to [0, 1]; None where the curve
    has no bend."""
    if len(periods) < 4 or not values[-1] > values[0] > 0:
        return None
    x = [(T - periods[0]) / (periods[-1] - periods[0]) for T in periods]
    y = [(value - values[0]) / (values[-1] - values[0]) for value in values]
    below = [a - b for a, b in zip(x, y, strict=True)]
    best = max(range(len(below)), key=lambda k: below[k])
    return best if 0 < best < len(below) - 1 and below[best] > 0.1 else None


def front_table(design: Design, states: Sequence[str], *, late: bool = False) -> Table | None:
    """Every point with its gain; late: as of the charts."""
    if len(design.front) < 2:
        return None
    named = [name for name in states if any(name in point.error for point in design.front)]
    with_rate = any(point.rate is not None for point in design.front)
    columns = ("period (s)", *(["proved rate (1/s)"] if with_rate else []), *(f"error of {name}" for name in named))
    rows = []
    for point in design.front:
        rate = [end_text(point.rate, _DIGITS, up=False)] if with_rate else []
        errors = (end_text(point.error.get(name), _DIGITS, up=True) for name in named)
        rows.append((point.period, *rate, *errors, _gain_text(point)))
    caption = (
        "Each point was proved when it was found, for the slopes claimed: that the estimate stays where they hold is "
        "shown of this design, which `check` proves at its law again."
    )
    caption += _WITHOUT_DELAY if late and named else ""
    return Table("front", "Other periods", caption, (*columns, "gain"), tuple(rows))


def _gain_text(point: FrontPoint) -> str:
    told = []
    for letter, matrix in point.gain.items():
        rows = matrix.texts()
        if sum(len(row) for row in rows) > _SHOWN:
            told.append(f"{letter} in design.json")
        elif len(rows[0]) == 1:
            told.append(f"{letter} = ({', '.join(row[0] for row in rows)})")
        else:
            told.append(f"{letter} = [{'; '.join(', '.join(row) for row in rows)}]")
    return ", ".join(told)


def _relative(values: Sequence[float]) -> list[float]:
    least = min(values) or 1.0
    return [value / least for value in values]
