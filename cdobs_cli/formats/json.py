"""The artefacts as they are: one JSON document for the whole command."""

from __future__ import annotations

import json
import re
from typing import Any

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Result


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """{command, exit_code, results: [{spec, status, messages, design, check, simulation}]}."""
    content = {"command": command, "exit_code": int(code), "results": [result.document() for result in results]}
    return json_text(content)


def json_text(content: Any) -> str:
    """JSON of printable ASCII: every other character is escaped, bytes of file names that are no text are U+FFFD."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    text = text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    return re.sub("[^\n -~]|#(?=#)", _escape, text)


def _escape(match: re.Match[str]) -> str:
    character = match.group()
    return f"\\u{ord(character):04x}" if ord(character) < 0x10000 else json.dumps(character)[1:-1]
