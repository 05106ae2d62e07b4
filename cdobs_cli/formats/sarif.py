"""SARIF 2.1.0: findings as results, on the YAML line that is meant; tool failures as notifications."""

from __future__ import annotations

import json
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from cdobs_cli import __version__
from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Message, Result


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """One run with one invocation."""
    failed = [message for result in results if result.status == "failed" for message in result.messages]
    found = [message for result in results if result.status != "failed" for message in result.messages]
    rules = sorted({message.rule for message in found})
    run = {
        "tool": {"driver": {"name": "cdobs", "version": __version__, "rules": [{"id": rule, "name": _pascal(rule)} for rule in rules]}},
        "invocations": [
            {
                "executionSuccessful": code != ExitCode.FAILED,
                "exitCode": int(code),
                "commandLine": f"cdobs {command}",
                "toolExecutionNotifications": [
                    {"level": "error", "message": {"text": message.text}, "locations": _locations(message)} for message in failed
                ],
            }
        ],
        "columnKind": "unicodeCodePoints",
        "results": [
            {
                "ruleId": message.rule,
                "ruleIndex": rules.index(message.rule),
                "level": message.severity,
                "message": {"text": ": ".join(part for part in (message.field, message.text) if part)},
                "locations": _locations(message),
            }
            for message in found
        ],
    }
    return json.dumps({"version": "2.1.0", "runs": [run]}, indent=1)


def _locations(message: Message) -> list[dict[str, Any]]:
    if message.file is None:
        return []
    place: dict[str, Any] = {"artifactLocation": {"uri": quote(PurePath(message.file).as_posix())}}
    if message.line is not None:
        place["region"] = {"startLine": message.line, **({"startColumn": message.column} if message.column else {})}
    return [{"physicalLocation": place}]


def _pascal(rule: str) -> str:
    return "".join(part.capitalize() for part in rule.replace("-", ".").replace("_", ".").split("."))
