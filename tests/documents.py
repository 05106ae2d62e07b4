"""What well-formed output is, format by format: our own transcription of the rules that each reader sets."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from typing import Any

import jsonschema

_STATUSES = ["ok", "finding", "invalid", "failed"]
_TEXT = {"type": "string"}
_MAYBE_TEXT = {"type": ["string", "null"]}
_MAYBE_PLACE = {"type": ["integer", "null"], "minimum": 1}
_ARTEFACT = {"type": ["object", "null"]}


def _closed(properties: dict[str, Any], required: list[str] | None = None) -> dict[str, Any]:
    names = list(properties) if required is None else required
    return {"type": "object", "properties": properties, "required": names, "additionalProperties": False}


JSON_DOCUMENT = _closed(
    {
        "command": _TEXT,
        "exit_code": {"enum": [0, 1, 2, 3]},
        "results": {
            "type": "array",
            "items": _closed(
                {
                    "spec": _TEXT,
                    "status": {"enum": _STATUSES},
                    "messages": {
                        "type": "array",
                        "items": _closed(
                            {
                                "severity": {"enum": ["error", "warning", "note"]}, "file": _MAYBE_TEXT,
                                "line": _MAYBE_PLACE,
                                "column": _MAYBE_PLACE, "field": _MAYBE_TEXT,
                                "text": {"type": "string", "minLength": 1},
                            }
                        ),
                    },
                    "design": _ARTEFACT, "check": _ARTEFACT, "simulation": _ARTEFACT,
                }
            ),
        },
    }
)  # fmt: skip

# SARIF 2.1.0, Sections 3.13 run log, 3.14 run, 3.18-19 tool, 3.20 invocation, 3.27 result, 3.28 location, 3.29-30
# place and region, 3.49 rule, 3.58 notification: what this tool writes of them, and nothing beside it.
_MESSAGE = _closed({"text": {"type": "string", "minLength": 1}})
_LEVEL = {"enum": ["none", "note", "warning", "error"]}
_LOCATION = _closed(
    {
        "physicalLocation": _closed(
            {
                "artifactLocation": _closed(
                    {"uri": {"type": "string", "pattern": r"^[A-Za-z0-9\-._~:/?#@!$&'()*+,;=%]+$"}}
                ),
                "region": _closed(
                    {"startLine": {"type": "integer", "minimum": 1}, "startColumn": {"type": "integer", "minimum": 1}},
                    ["startLine"],
                ),
            },
            ["artifactLocation"],
        )
    }
)
_LOCATIONS = {"type": "array", "items": _LOCATION}
SARIF = _closed(
    {
        "$schema": {"type": "string", "format": "uri"},
        "version": {"const": "2.1.0"},
        "runs": {
            "type": "array",
            "minItems": 1,
            "maxItems": 1,
            "items": _closed(
                {
                    "tool": _closed(
                        {
                            "driver": _closed(
                                {
                                    "name": _TEXT, "version": {"type": "string", "pattern": r"^\d+\.\d+\.\d+"},
                                    "rules": {
                                        "type": "array", "uniqueItems": True,
                                        "items": _closed(
                                            {
                                                "id": _TEXT, "name": _TEXT, "shortDescription": _MESSAGE,
                                                "help": _MESSAGE,
                                            }
                                        ),
                                    },
                                }
                            )
                        }
                    ),
                    "invocations": {
                        "type": "array",
                        "items": _closed(
                            {
                                "executionSuccessful": {"type": "boolean"}, "exitCode": {"type": "integer"},
                                "commandLine": _TEXT,
                                "toolExecutionNotifications": {
                                    "type": "array",
                                    "items": _closed({"level": _LEVEL, "message": _MESSAGE, "locations": _LOCATIONS}),
                                },
                            }
                        ),
                    },
                    "columnKind": {"enum": ["utf16CodeUnits", "unicodeCodePoints"]},
                    "results": {
                        "type": "array",
                        "items": _closed(
                            {
                                "ruleId": _TEXT, "ruleIndex": {"type": "integer", "minimum": 0}, "level": _LEVEL,
                                "message": _MESSAGE, "locations": _LOCATIONS,
                            }
                        ),
                    },
                }
            ),
        },
    }
)  # fmt: skip

# JUnit XML: attributes that must be there, with the pattern of each; children in the order in which they stand.
_COUNT, _SECONDS, _TOKEN, _ANY = r"\d+", r"\d+(\.\d+)?", r"(?s)\s*\S.*", r"(?s).*"
_TESTSUITE = {
    "package": _TOKEN, "id": _COUNT, "name": _TOKEN, "timestamp": r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", "hostname": _TOKEN,
    "tests": _COUNT, "failures": _COUNT, "errors": _COUNT, "time": _SECONDS,
}  # fmt: skip
_TESTCASE = {"name": _TOKEN, "classname": _TOKEN, "time": _SECONDS}
_OUTCOME = {"message": _ANY, "type": _TOKEN}


def _element(element: ET.Element, tag: str, attributes: dict[str, str]) -> None:
    assert element.tag == tag
    assert set(element.attrib) == set(attributes), element.attrib
    for name, pattern in attributes.items():
        assert re.fullmatch(pattern, element.attrib[name]), (name, element.attrib[name])


def junit(text: str, exit_code: int) -> ET.Element:
    root = ET.fromstring(text)
    _element(root, "testsuites", {})
    for number, suite in enumerate(root):
        _element(suite, "testsuite", _TESTSUITE)
        assert suite.attrib["id"] == str(number)
        first, *cases, out, err = suite
        _element(first, "properties", {})
        _element(out, "system-out", {})
        _element(err, "system-err", {})
        for case in cases:
            _element(case, "testcase", _TESTCASE)
            assert len(case) <= 1
            for outcome in case:
                assert outcome.tag in ("failure", "error")
                _element(outcome, outcome.tag, _OUTCOME)
        assert len({case.attrib["name"] for case in cases}) == len(cases) == int(suite.attrib["tests"]) > 0
        assert int(suite.attrib["failures"]) == len(suite.findall("testcase/failure"))
        assert int(suite.attrib["errors"]) == len(suite.findall("testcase/error"))
    broken, failed = root.findall(".//error"), root.findall(".//failure")
    assert bool(broken) == (exit_code >= 2)
    assert exit_code != 1 or failed
    assert exit_code != 0 or not (broken or failed)
    return root


def sarif(text: str, exit_code: int) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    jsonschema.Draft7Validator(SARIF).validate(document)
    run = document["runs"][0]
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    assert all(rules[result["ruleIndex"]] == result["ruleId"] for result in run["results"])
    invocation = run["invocations"][0]
    assert invocation["exitCode"] == exit_code
    assert invocation["executionSuccessful"] == (exit_code != 3)
    assert bool(invocation["toolExecutionNotifications"]) == (exit_code == 3)
    errors = [result for result in run["results"] if result["level"] == "error"]
    assert exit_code not in (1, 2) or errors
    assert exit_code != 0 or not errors
    return document


_COMMAND = re.compile(r"::(error|warning|notice) ((?:[a-zA-Z]+=[^,:\r\n]*)(?:,[a-zA-Z]+=[^,:\r\n]*)*)::([^\r\n]+)")


def github(text: str, exit_code: int) -> list[tuple[str, dict[str, str], str]]:
    """(level, properties, text) of each annotation."""
    annotations = []
    for line in text.splitlines():
        found = _COMMAND.fullmatch(line)
        assert found, line
        properties = dict(part.split("=", 1) for part in found[2].split(","))
        assert set(properties) <= {"file", "line", "endLine", "col", "endColumn", "title"}
        assert all(re.fullmatch(r"[1-9]\d*", properties[name]) for name in ("line", "col") if name in properties)
        annotations.append((found[1], properties, found[3]))
    assert annotations[-1][0] == "notice"
    assert annotations[-1][2].endswith(f"exit code {exit_code}")
    assert any(level == "error" for level, *_ in annotations) == (exit_code != 0)
    return annotations


def json_document(text: str, exit_code: int) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    jsonschema.Draft7Validator(JSON_DOCUMENT).validate(document)
    assert document["exit_code"] == exit_code
    codes = [_STATUSES.index(result["status"]) for result in document["results"]]
    assert max(codes) == exit_code
    told = [any(message["severity"] == "error" for message in result["messages"]) for result in document["results"]]
    assert told == [result["status"] != "ok" for result in document["results"]]
    return document


def text(output: str, exit_code: int) -> str:
    assert "\033" not in output
    first = output.split()[0] if output else ""
    assert first in _STATUSES or (not output and exit_code)
    return output


CHECKS = {"text": text, "json": json_document, "junit": junit, "sarif": sarif, "github": github}
