"""Formats of stdout for other programs, one file each: `render` picks by name."""

from __future__ import annotations

from importlib import import_module

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Result


def render(name: str, command: str, results: list[Result], code: ExitCode) -> str:
    """The whole document of one command in the format `name`."""
    document: str = import_module(f"cdobs_cli.formats.{name}").document(command, results, code)
    return document
