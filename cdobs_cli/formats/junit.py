"""JUnit XML: a test suite for each spec, a test case for each required claim, each `expect` entry, and the rest."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from datetime import UTC, datetime

from cdobs_cli.errors import ExitCode
from cdobs_cli.outcome import Message, Result
from cdobs_cli.printable import line, lines

# Characters that XML 1.0 cannot hold.
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def document(command: str, results: list[Result], code: ExitCode) -> str:
    """<testsuites> with one <testsuite> a spec; findings are failures, the rest errors.

    Every attribute and child that the strictest schema in use asks of a suite is there, and none that one forbids.
    """
    root = ET.Element("testsuites")
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    for number, result in enumerate(results):
        root.append(_suite(command, number, result, now))
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode")


def _suite(command: str, number: int, result: Result, now: str) -> ET.Element:
    cases = _cases(result)
    kind = "failure" if result.status == "finding" else "error"
    broken = sum(bool(messages) for messages in cases.values())
    suite = ET.Element(
        "testsuite", package=f"cdobs.{command}", id=str(number), name=_clean(result.spec), timestamp=now,
        hostname="localhost", tests=str(len(cases)), failures=str(broken if kind == "failure" else 0),
        errors=str(broken if kind == "error" else 0), time=f"{result.seconds:.3f}",
    )  # fmt: skip
    ET.SubElement(suite, "properties")
    for name, messages in cases.items():
        case = ET.SubElement(suite, "testcase", name=_clean(name), classname=_clean(result.spec), time="0")
        if messages:
            told = ET.SubElement(case, kind, message=_clean(messages[0].text), type=_clean(messages[0].rule))
            told.text = _clean("\n".join(line(str(message)) for message in messages))
    ET.SubElement(suite, "system-out").text = _clean("\n".join(map(line, result.summary)))
    ET.SubElement(suite, "system-err")
    return suite


def _cases(result: Result) -> dict[str, list[Message]]:
    """Test case name -> its findings: none where it holds. A suite is never empty."""
    cases: dict[str, list[Message]] = {"spec": []}
    for claim in (result.check or {}).get("claims", ()):
        if claim["required"]:
            cases[claim["id"]] = []
    cases.update({name: [] for name in result.expected})
    for message in (message for message in result.messages if message.severity == "error"):
        name = message.field or message.rule if message.rule in ("expect", "spec") else message.rule
        cases.setdefault(name, []).append(message)
    return cases


def _clean(text: str) -> str:
    return _FORBIDDEN.sub("?", lines(text))
