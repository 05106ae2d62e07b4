"""report.html: one file with its style, formulas (MathML) and figures (SVG) inside; nothing is fetched or run."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from textwrap import shorten

from cdobs_cli.chart import Chart
from cdobs_cli.printable import printable
from cdobs_cli.report import prose
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
    Section,
    Term,
    numbered,
)
from cdobs_cli.report.equations import mathml_block
from cdobs_cli.report.glossary import glossary, linked
from cdobs_cli.report.model import Report
from cdobs_cli.report.numbers import NOTHING
from cdobs_cli.report.palette import adaptable
from cdobs_cli.report.sections import sections
from cdobs_cli.report.status import STATUS_CLASSES, SYMBOLS, status_badge
from cdobs_cli.report.style import page
from cdobs_cli.report.verdict import is_expected, verdict_text, words

_TITLE = 70  # letters that a browser and a search engine show
_NUMBER = re.compile(r"[−-]?[\d.]+(e-?\d+)?|∞|–")


def html_page(report: Report, pictures: Mapping[str, bytes]) -> str:
    """The report as one page; `pictures` holds the SVG of each chart by name."""
    told = sections(report)
    body = [f"<h1>{escape(report.title)}</h1>", _headline(report), _contents([section.title for section in told])]
    for section in told:
        body.append(f'<h2 id="{_anchor(section.title)}">{escape(section.title)}</h2>')
        body += [_block(block, pictures) for block in section.blocks]
    body.append(glossary(report))
    return page(escape(shorten(report.title, _TITLE, placeholder=" …")), "\n".join(body))


def _contents(titles: Sequence[str]) -> str:
    items = "".join(f'<li><a href="#{_anchor(title)}">{escape(title)}</a></li>' for title in titles)
    return f'<nav class="contents" aria-label="Contents"><ul>{items}</ul></nav>'


def _anchor(title: str) -> str:
    return f"section-{re.sub(r'[^a-z]+', '-', title.lower())}"


def blocks_page(title: str, blocks: Sequence[Block], pictures: Mapping[str, bytes]) -> str:
    """A page of blocks below a heading, for what is no report of one spec."""
    (section,) = numbered([Section(title, tuple(blocks))])
    body = [f"<h1>{escape(title)}</h1>", *(_block(block, pictures) for block in section.blocks)]
    return page(escape(title), "\n".join(body), wide=True)


def fragment(report: Report, titles: Sequence[str], *, headed: bool = False) -> str:
    """Some sections of a report without their figures, as a part of another page: nothing in it leads elsewhere.

    headed: whether the verdict stands above them.
    """
    told = {section.title: section for section in sections(report)}
    body = [_headline(report)] if headed else []
    for section in (told[title] for title in titles if title in told):
        body += [_block(block, {}) for block in section.blocks if not isinstance(block, Picture)]
    return re.sub(r'<a [^>]*href="#[^>]*>(.*?)</a>', r"\1", "\n".join(body))


def pictures_html(charts: Sequence[Chart]) -> str:
    """Figures with their captions, as a part of another page, whatever its colours are."""
    from cdobs_cli.report.figures import draw

    drawn = {chart.name: draw(chart)["svg"] for chart in charts}
    blocks = (_block(Picture(chart, number), drawn) for number, chart in enumerate(charts, start=1))
    return f'<div style="background: white; color: black">{"".join(blocks)}</div>'


def _headline(report: Report) -> str:
    lines = [f'<p class="verdict">{SYMBOLS[report.verdict]} {escape(verdict_text(report))}</p>']
    first, *further = words(report)
    lines.append(f"<p><strong>{prose.html(first)}</strong></p>")
    lines += [f"<p>{prose.html(sentence)}</p>" for sentence in further]
    kind = "expected" if is_expected(report) else STATUS_CLASSES.get(report.verdict, "")
    return f'<div class="headline {kind}">{"".join(lines)}</div>'


def _block(block: Block, pictures: Mapping[str, bytes]) -> str:
    match block:
        case Paragraph(text):
            return f"<p>{prose.html(text)}</p>"
        case Bullets(items):
            return f"<ul>{''.join(f'<li>{prose.html(item)}</li>' for item in items)}</ul>"
        case Mathematics(equations):
            shown = mathml_block(equations)
            return f'<div class="formula" tabindex="0" role="group" aria-label="Formula">{shown}</div>'
        case Grid():
            return _grid(block)
        case Picture(chart, number):
            caption = f"<strong>Figure {number}. {escape(chart.title)}.</strong> {prose.html(chart.caption)}"
            drawing = inline_svg(pictures[chart.name], chart.name, chart.title)
            return f'<figure id="{_figure_anchor(chart.name)}">{drawing}<figcaption>{caption}</figcaption></figure>'
        case Listing(lines):
            return f"<pre>{escape(chr(10).join(map(printable, lines)))}</pre>"
    raise TypeError(type(block).__name__)


def _figure_anchor(name: str) -> str:
    return f"figure-{re.sub(r'[^A-Za-z0-9]', '-', name)}"


def _grid(grid: Grid) -> str:
    title = f"<caption>{escape(grid.title)}</caption>" if grid.title and not grid.is_folded else ""
    head = "".join(f'<th scope="col">{escape(prose.plain(column))}</th>' for column in grid.columns)
    rows = "".join(f"<tr>{''.join(map(_cell, row, grid.columns))}</tr>" for row in grid.rows)
    # Tables of many columns become one card a row on a phone.
    kind = ' class="cards"' if len(grid.columns) > 4 else ""
    caption = f'<p class="caption">{prose.html(grid.caption)}</p>' if grid.caption else ""
    table = f"<table{kind}>{title}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    shown = f'<div class="scroll" tabindex="0" role="group" aria-label="{escape(grid.title or "Table")}">{table}</div>'
    if not grid.is_folded:
        return f"{shown}{caption}"
    return f"<details><summary>{escape(grid.title)} ({len(grid.rows)}){_open(grid)}</summary>{shown}{caption}</details>"


def _open(grid: Grid) -> str:
    """What a folded table has that is not proved."""
    counts = Counter(cell.status for row in grid.rows for cell in row if isinstance(cell, Mark))
    return "".join(f", {count} {status}" for status, count in counts.items() if status != "proved")


def _cell(cell: Cell, column: str) -> str:
    label = f' data-label="{escape(prose.plain(column))}"'
    match cell:
        case Mark(status):
            return f"<td{label}>{status_badge(status)}</td>"
        case Term(text, identifier, is_code):
            shown = f"<code>{_breakable(text)}</code>" if is_code else escape(text)
            kind = ' class="name"' if is_code and len(text) <= 40 else ""
            return f"<td{label}{kind}>{linked(shown, identifier)}</td>"
        case Code(text):
            kind = ' class="name"' if len(text) <= 40 else ""
            return f"<td{label}{kind}><code>{_breakable(text)}</code></td>"
        case Figure(name, number):
            return f'<td{label}><a href="#{_figure_anchor(name)}">figure {number}</a></td>'
        case _:
            name = "number" if _NUMBER.fullmatch(cell) else "long" if len(cell) > 60 else ""
            name = "none" if cell == NOTHING else name
            kind = f' class="{name}"' if name else ""
            return f"<td{label}{kind}>{prose.html(cell)}</td>"


def _breakable(text: str) -> str:
    """A dotted name that may break behind its dots."""
    return re.sub(r"([._])(?=[A-Za-z])", r"\1<wbr>", escape(text))


def inline_svg(svg: bytes, prefix: str, title: str) -> str:
    """An SVG file as an element of a page: no prologue, identifiers made unique by a prefix, a name for readers
    that cannot see it."""
    text = svg.decode()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    mark = re.sub(r"[^A-Za-z0-9]", "-", prefix)
    text = re.sub(r'\bid="', f'id="{mark}-', text)
    text = re.sub(r'(xlink:href|href)="#', rf'\1="#{mark}-', text)
    text = adaptable(text.replace("url(#", f"url(#{mark}-"))
    return text.replace("<svg ", f'<svg role="img" aria-label="{escape(title)}" ', 1).strip()
