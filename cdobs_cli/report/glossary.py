"""Words used here: the pages of the ids that occur in a report, folded away at its end."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape

from cdobs_cli.explain.pages import Page, find
from cdobs_cli.report.model import Report

_GENERAL = ("what is trusted", "brackets")
_SHOWN = 4  # ids of one page in its heading


def words(report: Report) -> dict[str, list[str]]:
    """The ids that occur and have a page, by the first id of that page, in the order of the report."""
    named: dict[str, list[str]] = {}
    for one in dict.fromkeys(_occurring(report)):
        page = find(one)
        if page is not None:
            named.setdefault(page.ids[0], []).append(one)
    return named


def _occurring(report: Report) -> Iterator[str]:
    yield from (report.verdict, *_GENERAL, report.design.outcome)
    if report.check is None:
        return
    yield from (claim.id for claim in report.check.claims)
    yield from report.check.bounds
    methods = (*(one.method for one in report.check.claims), *(one.method for one in report.check.bounds.values()))
    yield from filter(None, methods)
    yield from (claim.witness.kind for claim in report.check.claims if claim.witness is not None)


def glossary(report: Report) -> str:
    """The pages as one element of a page that is closed at first."""
    entries = []
    for first, ids in words(report).items():
        page = find(first)
        assert page is not None
        shown = ", ".join(f"<code>{escape(one)}</code>" for one in ids[:_SHOWN])
        more = ", .." if len(ids) > _SHOWN else ""
        told = "".join(f"<p><strong>{title}.</strong> {_marked(text)}</p>" for title, text in page.parts)
        entries.append(f'<dt id="{anchor(page)}">{shown}{more}</dt><dd>{told}</dd>')
    return f'<details class="words"><summary>Words used here</summary><dl>{"".join(entries)}</dl></details>'


def linked(shown: str, identifier: str) -> str:
    """HTML that leads to the page of an id and tells its first sentence; as it is where there is none."""
    page = find(identifier)
    if page is None:
        return shown
    title = escape(page.first_sentence.replace("`", ""))
    return f'<a class="word" href="#{anchor(page)}" title="{title}">{shown}</a>'


def anchor(page: Page) -> str:
    """The name of a page's place in a report."""
    return f"word-{re.sub(r'[^A-Za-z0-9]+', '-', page.ids[0]).strip('-')}"


def _marked(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))
