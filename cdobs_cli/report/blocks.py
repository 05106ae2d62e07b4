"""What a report is made of, without how it is written: Markdown and HTML print the same sections."""

from __future__ import annotations

from dataclasses import dataclass

from cdobs_cli.chart import Chart
from cdobs_cli.report.equations import Equation
from cdobs_cli.report.ladder import Ladder


@dataclass(frozen=True)
class Mark:
    """A status word in a table: proved, refuted, undecided, holds, fails."""

    status: str


@dataclass(frozen=True)
class Code:
    """A name, a digest, a path: set in a fixed width."""

    text: str


@dataclass(frozen=True)
class Term:
    """A word that a page of `cdobs explain` is about; is_code: the id itself."""

    text: str
    id: str
    is_code: bool = False


Cell = str | Mark | Code | Term


@dataclass(frozen=True)
class Paragraph:
    """Plain sentences."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """Short sentences, one a line."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Mathematics:
    """Displayed equations, aligned at their relation."""

    equations: tuple[Equation, ...]


@dataclass(frozen=True)
class Grid:
    """A table; every row has as many cells as there are columns."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure: its data; whoever writes the files draws it."""

    chart: Chart | Ladder


@dataclass(frozen=True)
class Listing:
    """Lines to type, as they are."""

    lines: tuple[str, ...]


Block = Paragraph | Bullets | Mathematics | Grid | Picture | Listing


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it."""

    title: str
    blocks: tuple[Block, ...]
