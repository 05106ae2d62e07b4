"""What a report is made of, without how it is written: Markdown and HTML print the same sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from cdobs_cli.chart import Chart
from cdobs_cli.records import dataclass
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


@dataclass(frozen=True)
class Figure:
    """A reference to a figure by the name of its chart; number: its place in the report."""

    name: str
    number: int = 0


Cell = str | Mark | Code | Term | Figure


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
    """A table; every row has as many cells as there are columns. is_folded: whether a page opens it when asked to."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    caption: str = ""
    is_folded: bool = False


@dataclass(frozen=True)
class Picture:
    """A figure: its data; whoever writes the files draws it. number: its place in the report."""

    chart: Chart | Ladder
    number: int = 0


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


def numbered(sections: Sequence[Section]) -> tuple[Section, ...]:
    """The sections with the numbers of their figures, in the order of reading."""
    pictures = [one.chart.name for section in sections for one in section.blocks if isinstance(one, Picture)]
    numbers = {name: number for number, name in enumerate(pictures, start=1)}

    def of_cell(cell: Cell) -> Cell:
        return replace(cell, number=numbers.get(cell.name, 0)) if isinstance(cell, Figure) else cell

    def of_block(block: Block) -> Block:
        if isinstance(block, Picture):
            return replace(block, number=numbers[block.chart.name])
        if isinstance(block, Grid):
            return replace(block, rows=tuple(tuple(map(of_cell, row)) for row in block.rows))
        return block

    return tuple(replace(section, blocks=tuple(map(of_block, section.blocks))) for section in sections)
