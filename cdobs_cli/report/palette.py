"""The colours of figures, on light and on dark pages.

Those of Okabe and Ito, told apart by people with any colour vision. Files are always light: papers print them.
"""

from __future__ import annotations

import re

BLACK, WHITE, GRID, GREY = "#000000", "#ffffff", "#dddddd", "#7f7f7f"
ORANGE, SKY, GREEN, BLUE = "#e69f00", "#56b4e9", "#009e73", "#0072b2"
VERMILLION, PURPLE, PALE = "#d55e00", "#cc79a7", "#fbe3d3"
STRETCHED = "#f0f3f6"

# What stands for each on a dark page: lighter where it would sink, darker where it would glare.
DARK = {
    BLACK: "#e4e8ec", WHITE: "#14181c", GRID: "#333b43", GREY: "#a3adb8", ORANGE: "#f0b429", SKY: "#8fd0f7",
    GREEN: "#33c79b", BLUE: "#58a9e8", VERMILLION: "#ff8b4d", PURPLE: "#e29bc3", PALE: "#43200b",
    STRETCHED: "#1d242b",
}  # fmt: skip
_COLOUR = re.compile(rf"(?<=: )({'|'.join(DARK)})\b")
_FILL = re.compile(rf'fill="({"|".join(DARK)})"')


def _name(colour: str) -> str:
    return f"--figure-{colour[1:]}"


def variables(*, dark: bool) -> str:
    """The declarations of a style sheet that give each colour its value."""
    return " ".join(f"{_name(light)}: {shown if dark else light};" for light, shown in DARK.items())


def adaptable(svg: str) -> str:
    """A drawing whose colours are those that the style sheet of its page gives."""
    styled = _FILL.sub(r'style="fill: \1"', svg)  # an attribute knows no variables
    return _COLOUR.sub(lambda match: f"var({_name(match[1])}, {match[1]})", styled)
