"""SARIF 2.1.0: findings as results, on the YAML line that is meant; tool failures as notifications."""

from __future__ import annotations

import os
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from cdobs_cli import __version__
from cdobs_cli.errors import ExitCode
from cdobs_cli.explain.pages import find, pages
from cdobs_cli.formats.json import json_text
from cdobs_cli.outcome import Message, Result

pages()  # read while there are descriptors left for it
_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """One run with one invocation."""
    failed = [message for result in results if result.status == "failed" for message in result.messages]
    messages = [message for result in results if result.status != "failed" for message in result.messages]
    rules = sorted({message.rule for message in messages})
    driver = {"name": "cdobs", "version": __version__, "rules": [_rule(rule) for rule in rules]}
    invocation = {
        "executionSuccessful": code != ExitCode.FAILED, "exitCode": int(code), "commandLine": f"cdobs {command}",
        "toolExecutionNotifications": [
            {"level": "error", "message": {"text": message.text}, "locations": _locations(message)}
            for message in failed
        ],
    }  # fmt: skip
    findings = [
        {
            "ruleId": message.rule, "ruleIndex": rules.index(message.rule), "level": message.severity,
            "message": {"text": message.told}, "locations": _locations(message),
        }
        for message in messages
    ]  # fmt: skip
    run = {
        "tool": {"driver": driver},
        "invocations": [invocation],
        "columnKind": "unicodeCodePoints",
        "results": findings,
    }
    return json_text({"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]})


def _locations(message: Message) -> list[dict[str, Any]]:
    if message.file is None:
        return []
    place: dict[str, Any] = {"artifactLocation": {"uri": _uri(PurePath(message.file))}}
    if message.line is not None:
        place["region"] = {"startLine": message.line, **({"startColumn": message.column} if message.column else {})}
    return [{"physicalLocation": place}]


def _uri(path: PurePath) -> str:
    """Relative paths stay relative; names that are not UTF-8 keep their bytes."""
    address = quote(os.fsencode(path.as_posix()))
    return f"file://{address}" if path.is_absolute() else address


def _rule(rule: str) -> dict[str, Any]:
    """With what `cdobs explain` says of it, which code scanning shows beside a finding."""
    described: dict[str, Any] = {"id": rule, "name": _pascal(rule)}
    page = find(rule)
    if page is not None:
        told = [f"{title}. {text}" for title, text in page.parts]
        described["shortDescription"] = {"text": page.first_sentence}
        described["help"] = {"text": "\n\n".join(told)}
    return described


def _pascal(rule: str) -> str:
    return "".join(part.capitalize() for part in rule.replace("-", ".").replace("_", ".").split("."))
