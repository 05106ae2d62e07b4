"""A report as files: names and contents; whoever calls writes them."""

from __future__ import annotations

from collections.abc import Iterable

from cdobs_cli.chart import Chart
from cdobs_cli.report.html import html_page
from cdobs_cli.report.ladder import Ladder
from cdobs_cli.report.model import Report
from cdobs_cli.report.text import markdown


def render(report: Report) -> dict[str, bytes]:
    """All files of a report by relative name: report.md, report.html, figures/<name>.svg, .png and .csv."""
    drawn = figures(report.charts)
    pictures = {chart.name: drawn[f"figures/{chart.name}.svg"] for chart in report.charts}
    return {"report.md": markdown(report).encode(), "report.html": html_page(report, pictures).encode(), **drawn}


def figures_of_run(report: Report) -> dict[str, bytes]:
    """The common figures of a simulation alone, by relative name."""
    return figures(report.run_charts)


def figures(charts: Iterable[Chart | Ladder]) -> dict[str, bytes]:
    """Each chart as .svg, .png and .csv, by relative name."""
    from cdobs_cli.report.figures import draw

    drawings = {chart.name: draw(chart) for chart in charts}
    formats = ("svg", "png", "csv")
    return {f"figures/{name}.{one}": getattr(drawing, one) for name, drawing in drawings.items() for one in formats}
