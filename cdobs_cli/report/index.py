"""The index page of a directory: one row a spec, sortable, readable from disk without a network."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from hashlib import sha256
from html import escape
from importlib.resources import files
from urllib.parse import quote

from cdobs_cli.certificate import Bound
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.report.model import Report, bound_title
from cdobs_cli.report.numbers import bracket_words, float_or_none
from cdobs_cli.report.status import status_badge
from cdobs_cli.report.style import page
from cdobs_cli.report.thumbnail import NAME as THUMBNAIL
from cdobs_cli.report.verdict import is_expected

# Worst first: what needs a look stands on top when sorted.
_RANK = {"failed": 0, "invalid": 1, "refuted": 2, "no design found": 3, "undecided": 4, "not checked": 5, "proved": 6}
_SORT = "\n" + files("cdobs_cli.report").joinpath("sort.js").read_text(encoding="utf-8")


@dataclass(frozen=True)
class IndexEntry:
    """One spec in the index.

    verdict: proved, refuted, undecided, `no design found`, `not checked`, or `invalid` and `failed` where there is no
    report. link, figure: paths of the report and of a small picture, relative to the page. holds: whether what the
    spec expects came out (the exit code's question); message: what to know where it did not; expected: whether a
    verdict other than proved is what the spec expects. plant: what it is about; bars of one plant have one scale.
    """

    name: str
    title: str
    verdict: str
    family: str = ""
    bound_name: str | None = None
    bound: Bound | None = None
    link: str | None = None
    figure: str | None = None
    holds: bool | None = None
    message: str = ""
    expected: bool = False
    plant: str = ""

    @property
    def scale_kind(self) -> tuple[str, str]:
        """Entries of one kind have bars on one scale: of one plant, in one unit."""
        return self.plant or self.name, "" if self.bound is None else self.bound.unit

    @staticmethod
    def of(report: Report, folder: str, pictures: Sequence[str]) -> IndexEntry:
        """The entry of a report whose files stand in `folder`, relative to the page; `pictures` are the names
        of the figures that are there."""
        name, bound = report.headline_bound or (None, None)
        figure = next((name for name in (THUMBNAIL, "error", "states", *pictures) if name in pictures), None)
        failed = [f"expected {what}; found {value}" for what, holds, value in report.expectations if not holds]
        return IndexEntry(
            report.name, report.title, report.verdict, report.design.family, name, bound,
            f"{folder}/report.html", f"{folder}/figures/{figure}.svg" if figure else None,
            not failed if report.expectations else report.status == "proved",
            "; ".join(failed) or (report.sentence if report.design.outcome == "none" else ""), is_expected(report),
            _plant_key(report.plant),
        )  # fmt: skip


def _plant_key(plant: Plant) -> str:
    """The same for the same equations of motion."""
    matrices = (
        None if one is None else [[str(value) for value in row] for row in one.rows] for one in (plant.A, plant.B)
    )
    return sha256(repr((plant.states, *matrices, [str(one) for one in plant.phi])).encode()).hexdigest()


def index_page(entries: Sequence[IndexEntry]) -> bytes:
    """The page; entries keep their order until a heading is clicked."""
    counts = Counter(entry.verdict for entry in entries)
    order = sorted(counts, key=lambda verdict: (-_RANK.get(verdict, 9), verdict))
    summary = ", ".join(f"{counts[verdict]} {verdict}" for verdict in order)
    sortable = ("spec", "family", "verdict", "as expected", "bracket")
    heads = [*(f'<button type="button">{column}</button>' for column in sortable), "picture"]
    head = "".join(f'<th scope="col">{column}</th>' for column in heads)
    count = f"{len(entries)} spec{'' if len(entries) == 1 else 's'}"
    scales: dict[tuple[str, str], float] = {}
    for entry in entries:
        if entry.bound is not None:
            kind = entry.scale_kind
            scales[kind] = max(scales.get(kind, 0.0), *_finite_ends(entry.bound), 0.0)
    rows = "\n".join(_row(entry, scales.get(entry.scale_kind, 1.0)) for entry in entries)
    body = (
        f"<h1>Observers</h1>\n<p>{count}: {escape(summary) or 'none'}.</p>\n"
        f'<table class="index"><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table>\n'
        '<p class="caption">Bracket: what is proved (solid) and what is refuted (hatched); '
        "the bars of one plant have one scale. Pictures: the first curves of the report, with the ends of their "
        "axes.</p>"
    )
    # The small pictures are files beside the page, on a server or on a disk.
    return page("Observers", body, wide=True, script=_SORT, images="'self' file: data:").encode()


def _row(entry: IndexEntry, largest: float) -> str:
    name = escape(entry.title or entry.name)
    link = f'<a href="{_address(entry.link)}">{name}</a>' if entry.link else name
    message = f'<br><span class="soft">{escape(entry.message)}</span>' if entry.message else ""
    expected = "" if entry.holds is None else status_badge("holds" if entry.holds else "fails")
    image = f'<img src="{_address(entry.figure)}" alt="Curves of {name}">'
    picture = f'<a href="{_address(entry.link or entry.figure)}">{image}</a>' if entry.figure else ""
    proved = float_or_none(entry.bound.proved) if entry.bound else None
    cells = (
        (entry.name, f'{link}<br><span class="soft">{escape(entry.name)}</span>{message}'),
        (None, escape(entry.family.replace("_", " "))),
        (_RANK.get(entry.verdict, 9), status_badge(entry.verdict, expected=entry.expected)),
        ("" if entry.holds is None else int(entry.holds), expected),
        ("" if proved is None else repr(min(proved, 1e308)), _bracket(entry, largest)),
        (None, picture),
    )
    keys = ("" if key is None else f' data-key="{escape(str(key))}"' for key, _ in cells)
    return f"<tr>{''.join(f'<td{key}>{cell}</td>' for key, (_, cell) in zip(keys, cells, strict=True))}</tr>"


def _address(path: str | None) -> str:
    return escape(quote(os.fsencode(path or "")))


def _bracket(entry: IndexEntry, largest: float) -> str:
    if entry.bound is None or entry.bound_name is None:
        return ""
    text, title = escape(bracket_words(entry.bound)), escape(bound_title(entry.bound_name))
    return f'{_bars(entry.bound, largest)}<strong>{text}</strong><br><span class="soft">{title}</span>'


def _finite_ends(bound: Bound) -> list[float]:
    ends = [float_or_none(text) for text in (bound.proved, bound.refuted)]
    return [end for end in ends if end is not None and math.isfinite(end) and end > 0]


def _bars(bound: Bound, largest: float) -> str:
    """A bar from 0 to what is proved, hatched from what is refuted on; `largest` is a little before its end."""
    width = 100.0
    scale = width / (1.1 * (largest or 1.0))
    proved, refuted = float_or_none(bound.proved), float_or_none(bound.refuted)
    end = min(width, max(0.0, proved * scale)) if proved is not None else 0.0
    start = min(width, max(0.0, refuted * scale)) if refuted is not None else width
    steps = (start + 3 * step for step in range(int((width - start) / 3) + 1))
    ends = ((x, min(width, x + 4)) for x in steps if x < width)
    hatch = 'y1="12" x2="{:.1f}" y2="4" stroke="var(--figure-d55e00)" stroke-width="0.8"'
    lines = "".join(f'<line x1="{left:.1f}" {hatch.format(right)}></line>' for left, right in ends)
    label = escape(bracket_words(bound))
    return (
        f'<svg class="bracket" viewBox="0 0 100 16" preserveAspectRatio="none" role="img" aria-label="{label}">'
        f'<rect x="0" y="4" width="{end:.1f}" height="8" fill="var(--figure-009e73)"></rect>{lines}'
        '<line x1="0" y1="14" x2="100" y2="14" stroke="currentColor" stroke-width="0.5"></line></svg>'
    )
