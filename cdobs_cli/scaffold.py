"""`cdobs init`: the commented spec of a family, written where nothing is lost."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.parser import nearest
from cdobs_cli.store import write_atomically


def example(family: str = "auto") -> str:
    """The family's example; `auto`: the shortest useful spec, which leaves the family open.

    Raises:
        UsageError: there is no such family.
    """
    from cdobs_cli.families import FAMILIES

    if family == "auto":
        return files("cdobs_cli.spec").joinpath("example.yaml").read_text(encoding="utf-8")
    known = [*FAMILIES, "auto"]
    if family not in FAMILIES:
        raise UsageError(f"unknown family {family!r}{nearest(family, known)}; known: {', '.join(known)}")
    return FAMILIES[family].example()


def write_new(path: Path, text: str) -> None:
    """Write a file that does not exist yet.

    Raises:
        UsageError: it exists; nothing is overwritten.
    """
    if path.exists():
        raise UsageError(f"{path} exists already; choose another name")
    write_atomically(path, text.encode())
