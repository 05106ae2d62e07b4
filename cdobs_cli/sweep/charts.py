"""Figures of a sweep: brackets against one field, or maps over two."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cdobs_cli.certificate import Status
from cdobs_cli.chart import AxisScale, Chart, Panel, Role, Series
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass
from cdobs_cli.report.model import HEADLINE_BOUNDS, bound_title
from cdobs_cli.report.numbers import float_or_none, unit_text
from cdobs_cli.sweep.grid import Axis
from cdobs_cli.sweep.points import Row

_PANELS = 4
_WIDE = 30.0  # the ratio of an axis' ends from which on it is logarithmic
_ROLES: dict[Status, Role] = {"proved": "proved", "refuted": "refuted", "undecided": "other"}


@dataclass(frozen=True)
class _Scale:
    """Where the values of a field stand on an axis: numbers where they are, else 1, 2, .., named in the label."""

    label: str
    places: tuple[float, ...]

    @staticmethod
    def of(axis: Axis, shown: Sequence[str]) -> _Scale:
        numbers = [_number(text) for text in shown]
        if all(number is not None for number in numbers):
            return _Scale(axis.field, tuple(number for number in numbers if number is not None))
        named = ", ".join(f"{place} {text[:20]}" for place, text in enumerate(shown[:8], start=1))
        return _Scale(f"{axis.field}: {named}", tuple(float(place) for place in range(1, len(shown) + 1)))

    @property
    def is_wide(self) -> bool:
        return min(self.places) > 0 and max(self.places) > _WIDE * min(self.places)


def _number(text: str) -> float | None:
    try:
        value = float(Exact(text))
    except (ValueError, ArithmeticError, TypeError):
        return None
    return value if math.isfinite(value) else None


def sweep_charts(axes: Sequence[Axis], shown: Sequence[Sequence[str]], rows: Sequence[Row]) -> list[Chart]:
    """Of one field or two; none where there are more, or where nothing is known. shown: the values, field by field;
    rows in the order of the grid."""
    if len(axes) > 2:
        return []
    scales = [_Scale.of(axis, texts) for axis, texts in zip(axes, shown, strict=True)]
    return list(_curves(scales[0], rows) if len(axes) == 1 else _maps(scales[0], scales[1], rows))


def _groups(rows: Sequence[Row]) -> Iterator[tuple[str, str, list[str]]]:
    """Name and title of a figure, and the bounds it shows."""
    known = [name for row in rows for name, bound in row.bounds.items() if bound.proved or bound.refuted]
    period = next((name for name in HEADLINE_BOUNDS if name in known), None)
    first = [name for name in (period, "decay_rate") if name in known]
    if first:
        yield "sweep_period", "Period and rate", [name for name in first if name is not None]
    for head in ("error", "rms"):
        errors = [name for name in dict.fromkeys(known) if name.startswith(f"{head}.")]
        if errors:
            yield f"sweep_{head}", bound_title(head), errors[:_PANELS]


def _ends(rows: Sequence[Row], name: str, end: str) -> list[float]:
    bounds = (row.bounds.get(name) for row in rows)
    ends = (None if bound is None else float_or_none(getattr(bound, end)) for bound in bounds)
    return [math.nan if one is None else one for one in ends]


def _y_label(rows: Sequence[Row], name: str) -> str:
    bound = next(row.bounds[name] for row in rows if name in row.bounds)
    unit = unit_text(bound).strip()
    return f"{name.replace('_', ' ')}{unit and f' ({unit})'}"


def _curves(scale: _Scale, rows: Sequence[Row]) -> Iterator[Chart]:
    order = sorted(range(len(rows)), key=scale.places.__getitem__)
    x, rows = [scale.places[k] for k in order], [rows[k] for k in order]
    for figure, title, names in _groups(rows):
        panels = []
        for name in names:
            series = []
            for end, role in (("proved", "proved"), ("refuted", "refuted")):
                y = _ends(rows, name, end)
                if any(map(math.isfinite, y)):
                    series += [Series(end, x, y, "line", role), Series(end, x, y, "points", role)]  # type: ignore[arg-type]
            panels.append(Panel(scale.label, _y_label(rows, name), tuple(series), x_scale=_axis(scale)))
        caption = f"What is proved and what is refuted against {scale.label}; each point is a design of its own."
        yield Chart(figure, title, caption, tuple(panels))


def _maps(first: _Scale, second: _Scale, rows: Sequence[Row]) -> Iterator[Chart]:
    """The first field to the right, the second one upwards."""
    x = [place for place in first.places for _ in second.places]
    y = [place for _ in first.places for place in second.places]
    verdicts = []
    for status, role in _ROLES.items():
        at = [k for k, row in enumerate(rows) if row.verdict == status]
        if at:
            verdicts.append(Series(status, [x[k] for k in at], [y[k] for k in at], "points", role))
    for figure, title, names in _groups(rows):
        panels = []
        for name in names:
            values = _ends(rows, name, "proved")
            cells = Series(_y_label(rows, name), x, y, "cells", "proved", y2=values)
            panels.append(
                Panel(first.label, second.label, (cells, *verdicts), x_scale=_axis(first), y_scale=_axis(second))
            )
        caption = (
            f"{title} proved, by colour, over {first.label} and {second.label}; "
            "marks say whether the claim is proved, refuted or undecided there."
        )
        yield Chart(figure, title, caption, tuple(panels))


def _axis(scale: _Scale) -> AxisScale:
    return "log" if scale.is_wide else "linear"
