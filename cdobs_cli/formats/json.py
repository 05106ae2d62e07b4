"""The artefacts as they are: one JSON document for the whole command."""

from __future__ import annotations

import json

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Result


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """{command, exit_code, results: [{spec, status, messages, design, check, simulation}]}."""
    content = {"command": command, "exit_code": int(code), "results": [result.document() for result in results]}
    return json.dumps(content, indent=1, allow_nan=False)
