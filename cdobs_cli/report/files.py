"""A report as files: names and contents; whoever calls writes them."""

from __future__ import annotations

from cdobs_cli.report.drawings import Drawings
from cdobs_cli.report.html import html_page
from cdobs_cli.report.model import Report
from cdobs_cli.report.text import markdown
from cdobs_cli.report.thumbnail import NAME as THUMBNAIL
from cdobs_cli.report.thumbnail import thumbnail


def render(report: Report, drawings: Drawings) -> dict[str, bytes]:
    """report.md, report.html, and the figures that are not there yet, by relative name."""
    pictures, files = drawings.drawn(report.charts, report.formats)
    if small := thumbnail(report.charts):
        files[f"figures/{THUMBNAIL}.svg"] = small
    return {"report.md": markdown(report).encode(), "report.html": html_page(report, pictures).encode(), **files}
