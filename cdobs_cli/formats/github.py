"""Annotations of a GitHub workflow run: one workflow command a finding, on the YAML line that is meant."""

from __future__ import annotations

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Message, Result
from cdobs_cli.printable import line

_LEVELS = {"error": "error", "warning": "warning", "note": "notice"}


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """One line a message: `::error file=..,line=..,col=..,title=..::text`, then a notice with the count."""
    lines = [_line(message) for result in results for message in result.messages]
    held = sum(result.status == "ok" for result in results)
    lines.append(f"::notice title=cdobs {command}::{held} of {len(results)} specs hold, exit code {int(code)}")
    return "\n".join(lines)


def _line(message: Message) -> str:
    places = {"file": message.file, "line": message.line, "col": message.column, "title": f"cdobs {message.rule}"}
    properties = ",".join(f"{name}={_property(str(value))}" for name, value in places.items() if value is not None)
    return f"::{_LEVELS[message.severity]} {properties}::{_data(message.told)}"


def _data(text: str) -> str:
    return line(text).replace("%", "%25")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
