"""What a figure or a table shows, without how it is drawn: families say what, `report` draws and formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any, Literal

from cdobs_cli.certificate import Bound
from cdobs_cli.records import dataclass

# line: a curve; steps: held until the next x; points: markers; stems: lines from 0; band: filled between y and y2;
# limit: a horizontal line at y[0] over the whole panel; mark: a vertical line at x[0] over the whole panel; cells: the
# colour of y2 around each (x, y) of a grid.
SeriesKind = Literal["line", "steps", "points", "stems", "band", "limit", "mark", "cells"]
AxisScale = Literal["linear", "log"]
# truth: what really is; estimate: what the observer says; proved: a proved bound; refuted: a counterexample;
# measured: data at samples; arrived: the same, when they are there; beside: what is compared with, drawn thin; other:
# anything else (the next free colour).
Role = Literal["truth", "estimate", "proved", "refuted", "measured", "arrived", "beside", "other"]


@dataclass(frozen=True)
class Series:
    """One curve: x and y of equal length (numpy arrays or sequences of floats). place: of measurements, whose they are:
    each sensor has a marker and a colour of its own in all panels."""

    label: str
    x: Sequence[float] | Any
    y: Sequence[float] | Any
    kind: SeriesKind = "line"
    role: Role = "other"
    y2: Sequence[float] | Any = None
    place: int = 0


@dataclass(frozen=True)
class Panel:
    """One pair of axes; labels are plain text with `$..$` for mathematics. y_range: what is looked at of it, where
    that is not all."""

    x_label: str
    y_label: str
    series: tuple[Series, ...]
    y_scale: AxisScale = "linear"
    x_scale: AxisScale = "linear"
    y_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Chart:
    """One figure, panels from top to bottom with a shared x axis. `name` is its file name. stretch: up to there, from 0
    on, the axis has a larger scale, for what happens early."""

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    stretch: float | None = None


@dataclass(frozen=True)
class Table:
    """One table: cells are text or floats, formatted by the report; a bound takes two columns, proved and refuted,
    each end rounded to its safe side."""

    name: str
    title: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | float | int | Bound | None, ...], ...]


@dataclass(frozen=True)
class Exhibits:
    """What a family adds to the report: charts, tables, and short notes (plain sentences)."""

    charts: tuple[Chart, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)
