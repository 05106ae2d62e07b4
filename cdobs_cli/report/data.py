"""Tables as CSV: what a figure shows, point by point, and any other."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import Any

from cdobs_cli.chart import Chart, Series
from cdobs_cli.printable import printable
from cdobs_cli.report.ladder import Ladder


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """A header and rows; what is not there is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")


def text_csv(header: Sequence[str], rows: Iterable[Sequence[str | None]]) -> bytes:
    """The same of texts that somebody typed: what a terminal would obey is escaped."""
    return csv_bytes(header, ([printable(cell or "") for cell in row] for row in rows))


def data_csv(chart: Chart | Ladder) -> bytes:
    """What is drawn, as CSV."""
    return ladder_csv(chart) if isinstance(chart, Ladder) else chart_csv(chart)


def chart_csv(chart: Chart) -> bytes:
    """What is drawn, one point a row: panel, series, x, y, and y2 for bands."""
    rows: list[tuple[Any, ...]] = []
    for number, panel in enumerate(chart.panels, start=1):
        for series in panel.series:
            y2 = repeat("") if series.y2 is None else [repr(float(value)) for value in series.y2]
            rows += [
                (number, panel.y_label, series.label, repr(float(x)), repr(float(y)), other)
                for x, y, other in zip(*_same_length(series), y2, strict=False)
            ]
    return csv_bytes(("panel", "quantity", "series", "x", "y", "y2"), rows)


def _same_length(series: Series) -> tuple[Sequence[Any], Sequence[Any]]:
    """x and y; a limit has its number in y alone, a mark in x alone."""
    x, y = list(series.x), list(series.y)
    if series.kind == "limit":
        return [math.nan] * len(y), y
    return (x, [math.nan] * len(x)) if series.kind == "mark" else (x, y)


def ladder_csv(ladder: Ladder) -> bytes:
    """Each rung with both its ends."""
    ends = [["" if end is None else repr(end) for end in (rung.proved, rung.refuted)] for rung in ladder.rungs]
    return csv_bytes(
        ("method", "proved", "refuted"), [(rung.label, *pair) for rung, pair in zip(ladder.rungs, ends, strict=True)]
    )
