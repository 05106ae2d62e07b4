"""The notebook of the site: run again, it says what it shows."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from docs_pages import DOCS

CELLS = [one for one in json.loads((DOCS / "notebook.ipynb").read_text())["cells"] if one["cell_type"] == "code"]
_NUMBER = re.compile(r" *\d+(?:\.\d+)?(?:e-?\d+)?")  # with the spaces that columns have before


def texts(cell: Any, kind: str) -> Iterator[str]:
    """What a cell shows: `stream`, or the HTML of its last value."""
    for one in cell["outputs"]:
        assert one["output_type"] != "error"
        if one["output_type"] == kind == "stream":
            yield "".join(one["text"])
        elif kind == "html" and "data" in one:
            yield "".join(one["data"]["text/html"])


def agrees(found: str, shown: str) -> None:
    """The same words, and numbers that a search may end at."""
    assert _NUMBER.sub("#", found) == _NUMBER.sub("#", shown)
    numbers = [[float(one) for one in _NUMBER.findall(text)] for text in (found, shown)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.02)


def test_its_cells_print_what_they_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    printed = 0
    for cell in CELLS:
        source = "".join(cell["source"])
        *before, last = source.rstrip().split("\n")
        shows = list(texts(cell, "html"))
        exec("\n".join([*before, f"shown = {last}" if shows else last]), names)
        agrees(capsys.readouterr().out, "".join(texts(cell, "stream")))
        printed += any(texts(cell, "stream"))
        for html in shows:
            found = names["shown"]._repr_html_()
            words = [set(re.findall(r"[a-z]{4,}", re.sub(r"<svg.*?</svg>|<[^>]*>", " ", one, flags=re.DOTALL)))
                     for one in (found, html)]  # fmt: skip
            assert words[0] == words[1]
    assert printed >= 4
