"""The comparison as a table: for the terminal, as CSV, and as a page with a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.compare.figures import NO_CERTIFICATE, Figures
from cdobs_cli.printable import printable
from cdobs_cli.report.blocks import Block, Bullets, Cell, Grid, Mark, Paragraph, Picture
from cdobs_cli.report.data import text_csv
from cdobs_cli.report.html import blocks_page
from cdobs_cli.report.numbers import NOTHING, ends_text, float_or_none, number_text
from cdobs_cli.report.trajectories import axis_name

_PANELS = 4
_DIGITS = 4
CHART = "compare_error"


def columns(rows: Sequence[Figures], states: Sequence[str]) -> dict[str, list[str]]:
    """What people read, by heading, with numbers shortened to the safe side; columns without an entry are left out."""
    table = {"observer": [row.name for row in rows], "certificate": [row.certificate for row in rows]}
    table["sampling"] = [row.law for row in rows]
    for name, bounds in (("period", [row.period for row in rows]), ("rate", [row.rate for row in rows])):
        unit = next((bound.unit for bound in bounds if bound.proved or bound.refuted), "")
        for place, end in enumerate(("proved", "refuted")):
            table[f"{name} {end}{unit and f' ({unit})'}"] = [ends_text(bound)[place] for bound in bounds]
    for state in states:
        table[f"error of {state} proved"] = [ends_text(row.error(state))[0] for row in rows]
    for state in states:
        table[f"RMSE of {state}"] = [number_text(row.rmse.get(state), _DIGITS) for row in rows]
    table["samples"] = [number_text(row.measurements) for row in rows]
    table["CPU (s)"] = [NOTHING if row.cpu is None else f"{row.cpu:.2f}" for row in rows]
    return {name: cells for name, cells in table.items() if any(cell not in (NOTHING, "") for cell in cells)}


def text_lines(rows: Sequence[Figures], states: Sequence[str]) -> list[str]:
    """For a terminal: aligned columns."""
    table = {printable(name): [printable(cell) for cell in cells] for name, cells in columns(rows, states).items()}
    widths = [max(map(len, (name, *cells))) for name, cells in table.items()]
    grid = [list(table), *map(list, zip(*table.values(), strict=True))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in grid]


def compare_csv(rows: Sequence[Figures], states: Sequence[str]) -> bytes:
    """Exact ends and full floats; times stand in another file."""
    ends = [f"{name}.{end}" for name in ("period", "rate", *(f"error.{state}" for state in states))
            for end in ("proved", "refuted")]  # fmt: skip
    header = ["observer", "kind", "certificate", "sampling", *ends, *(f"rmse.{state}" for state in states), "seeds"]
    body = []
    for row in rows:
        bounds = (row.period, row.rate, *(row.error(state) for state in states))
        exact = [end or "" for bound in bounds for end in (bound.proved, bound.refuted)]
        rmse = ["" if state not in row.rmse else repr(row.rmse[state]) for state in states]
        counts = ["" if one is None else str(one) for one in (row.seeds, row.measurements)]
        body.append([row.name, row.kind, row.certificate, row.law, *exact, *rmse, *counts, row.remark])
    return text_csv([*header, "measurements", "remark"], body)


def times_csv(rows: Sequence[Figures]) -> bytes:
    """CPU seconds."""
    cpu = [[row.name, "" if row.cpu is None else f"{row.cpu:.3f}"] for row in rows]
    return text_csv(["observer", "cpu_seconds"], cpu)


def compare_chart(rows: Sequence[Figures], states: Sequence[str]) -> Chart | None:
    """Error against measurements, state by state; None where nothing was run."""
    shown = [row for row in rows if row.measurements is not None]
    panels = []
    for state in states[:_PANELS]:
        series = []
        for place, row in enumerate(one for one in shown if state in one.rmse):
            is_bare = row.certificate.startswith(NO_CERTIFICATE)
            label = f"{row.name} ({NO_CERTIFICATE})" if is_bare else row.name
            proved = None if is_bare else float_or_none(row.error(state).proved)
            y = [row.rmse[state], *([] if proved is None else [proved])]
            series.append(Series(label, [float(row.measurements or 0)] * len(y), y, "points", place=place))
        if series:
            panels.append(Panel("measurements", f"error of {axis_name(state)}", tuple(series), y_scale="log"))
    caption = (
        "Errors against the measurements of a run. Of each observer the lower mark is its RMS error in simulation "
        "(after the transient, where noise or disturbance is declared), the upper one of the same kind what is proved."
    )
    return Chart(CHART, "Error against measurements", caption, tuple(panels)) if panels else None


def compare_page(
    title: str, rows: Sequence[Figures], states: Sequence[str], notes: Sequence[str], chart: Chart | None,
    pictures: Mapping[str, bytes],
) -> bytes:  # fmt: skip
    """The table, the figure, what is not there and why."""
    table = columns(rows, states)
    cells: list[tuple[Cell, ...]] = []
    for row in zip(*table.values(), strict=True):
        marked = (Mark(cell) if name == "certificate" and cell == "proved" else cell
                  for name, cell in zip(table, row, strict=True))  # fmt: skip
        cells.append(tuple(marked))
    words = (
        "Proved ends hold for the slopes claimed; what has no certificate was only run, and nothing is claimed of it."
    )
    remarks = tuple(f"{row.name}: {row.remark}" for row in rows if row.remark)
    blocks: list[Block] = [Paragraph(words), Grid(tuple(table), tuple(cells))]
    blocks += [] if chart is None else [Picture(chart)]
    blocks += [Bullets((*remarks, *notes))] if remarks or notes else []
    return blocks_page(title, blocks, pictures).encode("utf-8", "backslashreplace")
