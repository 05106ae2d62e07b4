"""How large the error stays under what is declared: proved, found, simulated, and beside the Kalman filter."""

from __future__ import annotations

from cdobs_cli.certificate import Bound
from cdobs_cli.report.blocks import Block, Cell, Grid
from cdobs_cli.report.model import Report
from cdobs_cli.report.numbers import ends_text, number_text

_KINDS = {"error": "peak", "rms": "rms"}
_MOST = 1000  # a larger ratio says no more


def accuracy(report: Report) -> tuple[Block, ...]:
    """The table of accuracies, a row for each state; nothing where no disturbance and no noise is declared."""
    comparison = None if report.run is None else report.run.comparison
    if comparison is None:
        return ()
    bounds = report.check.bounds if report.check else {}
    kinds = [kind for kind in _KINDS if any(f"{kind}.{name}" in bounds for name in report.plant.states)]
    named = [_KINDS[kind] for kind in kinds] or ["bound"]
    bracket = [column for what in named for column in (f"proved {what}", f"worst {what} found".replace("bound ", ""))]
    columns = ("state", *bracket, "RMSE", "RMSE of the filter", "ratio")
    rows = []
    for name in report.plant.states:
        unit = report.labels.states.get(name)
        row: list[Cell] = [f"{name} ({unit})" if unit else name]
        for kind in kinds or [""]:
            row += ends_text(bounds.get(f"{kind}.{name}", Bound()))
        figures = comparison.states.get(name)
        own, theirs = (None, None) if figures is None else (figures.rmse, figures.rmse_ekf)
        ratio = own / theirs if own is not None and theirs else None
        told = f"> {_MOST}" if ratio is not None and ratio > _MOST else number_text(ratio, 3)
        row += [number_text(own, 4), number_text(theirs, 4), told]
        rows.append(tuple(row))
    return (Grid(columns, tuple(rows), "Accuracy", _caption(report)),)


def _caption(report: Report) -> str:
    assert report.run is not None and report.run.comparison is not None
    comparison, plant = report.run.comparison, report.plant
    runs = "one run" if comparison.seeds == 1 else f"{comparison.seeds} runs"
    told = [f"Root mean square errors over the second half of {runs}."]
    if comparison.reason is not None:
        return " ".join((*told, comparison.reason))
    told.append("The filter is the extended Kalman filter for what is declared, on the same measurements.")
    if not plant.is_disturbed:
        told.append("No disturbance is declared: the filter takes the model as exact, and its error goes on falling.")
    return " ".join(told)
