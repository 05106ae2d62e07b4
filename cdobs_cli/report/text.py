"""report.md, and the few lines that a terminal gets."""

from __future__ import annotations

import re
from collections import Counter

from cdobs_cli.certificate import Bound, Status
from cdobs_cli.report.blocks import Block, Bullets, Cell, Code, Grid, Listing, Mark, Mathematics, Paragraph, Picture
from cdobs_cli.report.equations import latex_block
from cdobs_cli.report.model import Report, about_text, bound_title, end_text, ends_text, law_text, unit_text
from cdobs_cli.report.sections import sections

SYMBOLS = {"proved": "✓", "refuted": "✗", "undecided": "?", "holds": "✓", "fails": "✗", "no design found": "✗",
    "not checked": "·", "invalid": "!", "failed": "!"}  # fmt: skip
MAX_LISTED = 12


def markdown(report: Report) -> str:
    """The report as Markdown, with figures beside it in `figures/`."""
    parts = [f"# {escape(report.title)}", f"**{SYMBOLS[report.verdict]} {report.verdict}**: {escape(report.sentence)}"]
    if bracket := bracket_sentence(report):
        parts.append(escape(bracket))
    if report.conditions:
        parts.append("Conditions:\n\n" + "\n".join(f"- {escape(condition)}" for condition in report.conditions))
    for section in sections(report):
        parts.append(f"## {section.title}")
        parts += [_block(block) for block in section.blocks]
    return "\n\n".join(parts) + "\n"


def bracket_sentence(report: Report) -> str:
    """The headline's bracket in a sentence; empty where nothing is known."""
    if report.headline_bound is None:
        return ""
    name, bound = report.headline_bound
    told = bound.about is None or bound.about in bound_title(name)
    about = "" if told else f" (about {about_text(bound)})"
    return f"{bound_title(name)}: {_ends(bound)}{about}."


def _ends(bound: Bound) -> str:
    """`proved 1.713 s, refuted 1.7131 s`, whichever is known."""
    proved, refuted = ends_text(bound)
    ends = []
    if bound.proved is not None:
        ends.append(f"proved {proved}{unit_text(bound)}")
    if bound.refuted is not None:
        ends.append(f"refuted {refuted}{unit_text(bound)}")
    return ", ".join(ends)


def escape(text: str) -> str:
    """Text that Markdown shows as it is."""
    return re.sub(r"([\\`*_\[\]<>#|~$])", r"\\\1", " ".join(text.split()))


def _block(block: Block) -> str:
    match block:
        case Paragraph(text):
            return escape(text)
        case Bullets(items):
            return "\n".join(f"- {escape(item)}" for item in items)
        case Mathematics(equations):
            return f"```math\n{latex_block(equations)}\n```"
        case Grid():
            return _grid(block)
        case Picture(chart):
            return f"![{escape(chart.title)}](figures/{chart.name}.svg)\n\n*{escape(chart.title)}.* {escape(chart.caption)}"
        case Listing(lines):
            return "```sh\n" + "\n".join(line.replace("```", "") for line in lines) + "\n```"
    raise TypeError(type(block).__name__)


def _grid(grid: Grid) -> str:
    lines = [_line([escape(column) for column in grid.columns]), _line(["---"] * len(grid.columns))]
    lines += [_line([_cell(cell) for cell in row]) for row in grid.rows]
    title = f"**{escape(grid.title)}**\n\n" if grid.title else ""
    return title + "\n".join(lines) + (f"\n\n{escape(grid.caption)}" if grid.caption else "")


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(cell: Cell) -> str:
    match cell:
        case Mark(status):
            return f"{SYMBOLS[status]} {status}"
        case Code(text):
            return "`" + text.replace("`", "'").replace("|", "/") + "`"
        case _:
            return escape(cell)


def summary_lines(report: Report) -> list[str]:
    """A few plain lines: verdict, law, bracket, what failed. Status words stand first, so that a terminal can
    colour them."""
    lines = [f"{report.name}: {report.verdict}", f"  {' '.join(report.sentence.split())}"]
    lines.append(f"  sampling: {law_text(report.design.sampling)}")
    for name, bound in report.check.bounds.items() if report.check else ():
        if "." not in name and (bound.proved is not None or bound.refuted is not None):
            method = f" (by {bound.method})" if bound.method else ""
            lines.append(f"  {name}: {_ends(bound)}{method}")
    lines += [f"  condition: {condition}" for condition in report.conditions]
    lines += _claim_lines(report)
    lines += [f"  {'holds' if holds else 'fails'} expect {what}: {found}" for what, holds, found in report.expectations if not holds]
    return lines


def _claim_lines(report: Report) -> list[str]:
    if report.check is None:
        return []
    counts = Counter(claim.status for claim in report.check.claims)
    order: tuple[Status, ...] = ("proved", "refuted", "undecided")
    lines = ["  claims: " + ", ".join(f"{counts[status]} {status}" for status in order if counts[status])]
    open_claims = [claim for claim in report.check.claims if claim.status != "proved"]
    for claim in open_claims[:MAX_LISTED]:
        margin = f" (margin {end_text(claim.margin, 4, up=False)})" if claim.margin is not None else ""
        lines.append(f"  {claim.status} {claim.id}: {' '.join(claim.statement.split())}{margin}")
    if len(open_claims) > MAX_LISTED:
        lines.append(f"  and {len(open_claims) - MAX_LISTED} more")
    return lines
