"""A report as files: names and contents; whoever calls writes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from cdobs_cli.chart import Chart
from cdobs_cli.plant import Plant
from cdobs_cli.report.html import html_page
from cdobs_cli.report.ladder import Ladder
from cdobs_cli.report.model import Report, proved_envelope
from cdobs_cli.report.text import markdown
from cdobs_cli.report.trajectories import WayBack, run_charts

if TYPE_CHECKING:
    from cdobs_cli.certificate import Check
    from cdobs_cli.design import Design
    from cdobs_cli.families.base import Family
    from cdobs_cli.run import Run


def render(report: Report) -> dict[str, bytes]:
    """All files of a report by relative name: report.md, report.html, figures/<name>.svg, .png and .csv."""
    drawn = figures(report.charts)
    pictures = {chart.name: drawn[f"figures/{chart.name}.svg"] for chart in report.charts}
    return {"report.md": markdown(report).encode(), "report.html": html_page(report, pictures).encode(), **drawn}


def figures_of_run(
    plant: Plant, family: Family, design: Design, check: Check | None, run: Run, coordinates: WayBack | None = None
) -> dict[str, bytes]:
    """The common figures of a simulation alone, by relative name."""
    envelope = proved_envelope(family, plant, design, check)
    return figures(run_charts(plant, run, envelope, coordinates))


def figures(charts: Iterable[Chart | Ladder]) -> dict[str, bytes]:
    """Each chart as .svg, .png and .csv, by relative name."""
    from cdobs_cli.report.figures import draw

    drawings = {chart.name: draw(chart) for chart in charts}
    formats = ("svg", "png", "csv")
    return {f"figures/{name}.{one}": getattr(drawing, one) for name, drawing in drawings.items() for one in formats}
