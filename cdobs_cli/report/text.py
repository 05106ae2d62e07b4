"""report.md: the report for reading as text, and in places that show Markdown."""

from __future__ import annotations

import re

from cdobs_cli import printable
from cdobs_cli.report.blocks import (
    Block,
    Bullets,
    Cell,
    Code,
    Figure,
    Grid,
    Listing,
    Mark,
    Mathematics,
    Paragraph,
    Picture,
    Term,
)
from cdobs_cli.report.equations import latex_block
from cdobs_cli.report.model import Report
from cdobs_cli.report.prose import plain
from cdobs_cli.report.sections import sections
from cdobs_cli.report.status import SYMBOLS
from cdobs_cli.report.verdict import verdict_text, words


def markdown(report: Report) -> str:
    """The report as Markdown, with figures beside it in `figures/`."""
    first, *further = words(report)
    parts = [f"# {escape(report.title)}", f"**{SYMBOLS[report.verdict]} {verdict_text(report)}**: {_prose(first)}"]
    parts += map(_prose, further)
    for section in sections(report):
        parts.append(f"## {section.title}")
        parts += [_block(block) for block in section.blocks]
    return printable.page("\n\n".join(parts) + "\n")


def escape(text: str) -> str:
    """Text that Markdown shows as it is."""
    return re.sub(r"([\\`*_\[\]<>#|~$])", r"\\\1", " ".join(text.split()))


def _prose(text: str) -> str:
    """A sentence of ours, its names set."""
    return escape(plain(text))


def _block(block: Block) -> str:
    match block:
        case Paragraph(text):
            return _prose(text)
        case Bullets(items):
            return "\n".join(f"- {_prose(item)}" for item in items)
        case Mathematics(equations):
            return f"```math\n{latex_block(equations)}\n```"
        case Grid():
            return _grid(block)
        case Picture(chart, number):
            title = escape(chart.title)
            return f"![{title}](figures/{chart.name}.svg)\n\n*Figure {number}. {title}.* {_prose(chart.caption)}"
        case Listing(lines):
            return "```sh\n" + "\n".join(printable.printable(line).replace("```", "") for line in lines) + "\n```"
    raise TypeError(type(block).__name__)


def _grid(grid: Grid) -> str:
    lines = [_line([_prose(column) for column in grid.columns]), _line(["---"] * len(grid.columns))]
    lines += [_line([_cell(cell) for cell in row]) for row in grid.rows]
    title = f"**{escape(grid.title)}**\n\n" if grid.title else ""
    return title + "\n".join(lines) + (f"\n\n{_prose(grid.caption)}" if grid.caption else "")


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    match cell:
        case Mark(status):
            return f"{SYMBOLS[status]} {status}"
        case Term(text, _, is_code) if not is_code:
            return escape(text)
        case Code(text) | Term(text):
            return "`" + printable.printable(text).replace("`", "'").replace("|", "/") + "`"
        case Figure(_, number):
            return f"figure {number}"
        case _:
            return _prose(cell)
