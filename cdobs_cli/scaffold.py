"""`cdobs init`: the commented spec of a family, written where nothing is lost."""

from __future__ import annotations

from pathlib import Path

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.parser import nearest
from cdobs_cli.store import write_atomically


def example(family: str) -> str:
    """The family's example.

    Raises:
        UsageError: there is no such family.
    """
    from cdobs_cli.families import FAMILIES

    if family not in FAMILIES:
        raise UsageError(f"unknown family {family!r}{nearest(family, list(FAMILIES))}; known: {', '.join(FAMILIES)}")
    return FAMILIES[family].example()


def write_new(path: Path, text: str) -> None:
    """Write a file that does not exist yet.

    Raises:
        UsageError: it exists; nothing is overwritten.
    """
    if path.exists():
        raise UsageError(f"{path} exists already; choose another name")
    write_atomically(path, text.encode())
