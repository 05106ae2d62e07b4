"""The block `report`: what is drawn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from cdobs_cli.fields import sized
from cdobs_cli.spec.block import Block

Format = Literal["svg", "png", "pdf"]


class ReportBlock(Block):
    """figures: the formats of every figure; SVG, which the pages show, is always drawn."""

    figures: Annotated[tuple[Format, ...], sized(1, 3)] = Field(
        default=("svg",), description="Which files are written of each figure, beside the SVG that the pages show."
    )
