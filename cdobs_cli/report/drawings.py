"""The figures of a folder: each is drawn once, and stands while its chart, its formats and its files do."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field, fields, is_dataclass
from typing import Any

from cdobs_cli import __version__
from cdobs_cli.chart import Chart
from cdobs_cli.codec import parse
from cdobs_cli.records import dataclass
from cdobs_cli.report.ladder import Ladder

RECORD = "figures/.drawn.json"  # of each figure: what it was drawn of, and its files
DATA = "csv"


@dataclass
class Drawings:
    """What is drawn already. read: a file of the folder by its relative name, None where there is none.

    known: of each figure the digest of its chart, and those of its files by their endings.
    """

    read: Callable[[str], bytes | None]
    known: dict[str, tuple[str, dict[str, str]]] = field(default_factory=dict)

    @staticmethod
    def of(read: Callable[[str], bytes | None]) -> Drawings:
        """As the folder's record has it."""
        return Drawings(read, _recorded(read(RECORD)))

    def drawn(
        self, charts: Iterable[Chart | Ladder], formats: Sequence[str]
    ) -> tuple[dict[str, bytes], dict[str, bytes]]:
        """SVG of each chart by its name, and the files to be written, by relative name: what is new, and the record.

        SVG is always drawn, since pages hold it; the data stand beside it as CSV.
        """
        pictures: dict[str, bytes] = {}
        files: dict[str, bytes] = {}
        for chart in charts:
            digest = _digest((__version__, chart))
            kept = self._kept(chart.name, digest, formats)
            if kept is None:
                made = figure_files(chart, formats)
                files |= {_path(chart.name, ending): content for ending, content in made.items()}
                named = {ending: hashlib.sha256(content).hexdigest() for ending, content in made.items()}
                self.known[chart.name] = (digest, named)
                kept = made["svg"]
            pictures[chart.name] = kept
        if files:
            files[RECORD] = (json.dumps(self.known, indent=1, sort_keys=True) + "\n").encode()
        return pictures, files

    def _kept(self, name: str, digest: str, formats: Sequence[str]) -> bytes | None:
        """The SVG of a figure that stands as it was drawn of this very chart; None where it does not."""
        drawn_of, files = self.known.get(name, ("", {}))
        if drawn_of != digest or not {"svg", DATA, *formats} <= files.keys():
            return None
        contents = {ending: self.read(_path(name, ending)) for ending in files}
        if any(one is None or hashlib.sha256(one).hexdigest() != files[ending] for ending, one in contents.items()):
            return None
        return contents["svg"]


def figure_files(chart: Chart | Ladder, formats: Sequence[str]) -> dict[str, bytes]:
    """The files of a figure by their endings."""
    from cdobs_cli.report.data import data_csv
    from cdobs_cli.report.figures import draw

    return {**draw(chart, tuple(dict.fromkeys(("svg", *formats)))), DATA: data_csv(chart)}


def _path(name: str, ending: str) -> str:
    return f"figures/{name}.{ending}"


def _recorded(content: bytes | None) -> dict[str, tuple[str, dict[str, str]]]:
    """What a record says; nothing where it is not one."""
    try:
        known = {} if content is None else parse(content)
        return {str(name): (str(digest), dict(files)) for name, (digest, files) in known.items()}
    except (ValueError, TypeError, AttributeError):
        return {}


def _digest(value: Any) -> str:
    """sha256 of a chart: its words, and its numbers as they are."""
    content = hashlib.sha256()
    _feed(content.update, value)
    return content.hexdigest()


def _feed(update: Callable[[bytes], None], value: Any) -> None:
    if is_dataclass(value):
        update(type(value).__name__.encode())
        for one in fields(value):
            _feed(update, getattr(value, one.name))
    elif value is None or isinstance(value, str | int | float):
        update(repr(value).encode() + b";")
    elif isinstance(value, tuple) and not all(isinstance(one, int | float) for one in value):
        update(f"{len(value)}(".encode())
        for one in value:
            _feed(update, one)
    else:
        import numpy as np

        numbers = np.asarray(value, dtype=float)
        update(f"{numbers.shape}".encode() + numbers.tobytes())
