"""The table of a sweep: one row a point in the grid's order, exact ends of all bounds; times stand in another file."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from cdobs_cli.report.data import text_csv
from cdobs_cli.sweep.points import Point, Row, shown_value

_KNOWN = ("status", "verdict", "family", "outcome")


def table_csv(points: Sequence[Point], rows: Sequence[Row]) -> bytes:
    """The fields, what became of the point, both ends of each bound that some point has, the first finding."""
    names = list(dict.fromkeys(name for row in rows for name in row.bounds))
    ends = [f"{name}.{end}" for name in names for end in ("proved", "refuted")]
    body = []
    for point, row in zip(points, rows, strict=True):
        bounds = [row.bounds.get(name) for name in names]
        cells = [text for one in bounds for text in ((one.proved, one.refuted) if one else (None, None))]
        known = [getattr(row, name) for name in _KNOWN]
        first = next((one.text for one in row.messages if one.severity == "error"), "")
        body.append([*map(shown_value, point.settings), *known, *cells, first])
    return text_csv([*_fields(points), *_KNOWN, *ends, "message"], body)


def table_rows(points: Sequence[Point], rows: Sequence[Row]) -> list[dict[str, str]]:
    """The same as mappings."""
    return list(csv.DictReader(io.StringIO(table_csv(points, rows).decode())))


def times_csv(points: Sequence[Point]) -> bytes:
    """CPU seconds of each point."""
    body = [[*map(shown_value, point.settings), f"{seconds:.3f}" if (seconds := point.seconds()) is not None else ""]
            for point in points]  # fmt: skip
    return text_csv([*_fields(points), "cpu_seconds"], body)


def _fields(points: Sequence[Point]) -> list[str]:
    return [setting.field for setting in points[0].settings]
