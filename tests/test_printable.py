"""What a terminal, a log, a CI service or a page would obey is never printed raw, wherever it was typed."""

from __future__ import annotations

import json
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from command import PENDULUM, forked

from cdobs_cli.batch import Settings, run
from cdobs_cli.cli import Format
from cdobs_cli.console import Console
from cdobs_cli.errors import ExitCode
from cdobs_cli.formats import render
from cdobs_cli.outcome import STAGES, Job
from cdobs_cli.printable import line, lines, page, printable

PLANT = "\x1b]0;owned\x07\n::error::planted\r\x9b31m\u202e\u2028\x7f##[error]x\n##vso[task]\u200b"
OBEYED = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)
COMMANDS = re.compile(r"^\s*::(?!(error|warning|notice) )|^\s*::(error|warning|notice)::|##[\[A-Za-z]", re.MULTILINE)
SPEC = (
    PENDULUM
    + "expect: [{quantity: verdict, equals: refuted, source: somewhere}, {quantity: claims.x.y, equals: word}]\n"
)


def harmless(text: str) -> bool:
    return not OBEYED.search(text) and not COMMANDS.search(text)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain é λ 你 👍 a\\b", "plain é λ 你 👍 a\\b"),
        ("a\x1b[31mb", r"a\x1b[31mb"), ("a\nb\tc\r", r"a\nb\tc\r"), ("\x9b\x7f", r"\x9b\x7f"),
        ("\u202e\u2066\u2028\u2029\ufeff", r"\u202e\u2066\u2028\u2029\ufeff"),
        ("\udcff\U000e0041", r"\udcff\U000e0041"),
    ],
)  # fmt: skip
def test_what_is_obeyed_becomes_an_escape(text: str, shown: str) -> None:
    assert printable(text) == line(text) == shown


def test_no_line_is_a_command() -> None:
    assert line("::error::x") == r"\x3a:error::x"
    assert line("  ::set-output name=x::y") == r"  \x3a:set-output name=x::y"
    assert line("a::b: c") == "a::b: c"
    assert line("a ##[group] ##vso[x] # b ## c") == r"a \x23#[group] \x23#vso[x] # b ## c"
    assert lines("a\n::b\x1b") == "a\n\\x3a:b\\x1b"
    assert page("<p>\n::b\x1b</p>") == "<p>\n::b\\x1b</p>"
    assert harmless(lines(PLANT))


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], bool]]:
    """Every value of a document that is text, and every key (True)."""
    if isinstance(value, dict):
        for name, entry in value.items():
            yield (*path, name), True
            yield from places(entry, (*path, name))
    elif isinstance(value, list):
        for number, entry in enumerate(value):
            yield from places(entry, (*path, number))
    else:
        yield path, False


def planted(path: tuple[Any, ...], key: bool) -> str:
    """The spec with the plant in one place."""
    document = yaml.safe_load(SPEC)
    inside = document
    for part in path[:-1]:
        inside = inside[part]
    if key:
        renamed = {(PLANT if name == path[-1] else name): entry for name, entry in inside.items()}
        inside.clear()
        inside.update(renamed)
    else:
        inside[path[-1]] = f"{inside[path[-1]]}{PLANT}" if path[-1] == "source" else PLANT
    return yaml.safe_dump(document, sort_keys=False)


EVERYWHERE = sorted(set(places(yaml.safe_load(SPEC))), key=str)


def told(command: str, result: Any, capsys: pytest.CaptureFixture[str]) -> Iterator[str]:
    """All that is printed of a result: for people, and in every format."""
    code = ExitCode(result.exit_code)
    for several in (False, True):
        console = Console(verbose=True)
        console.show(result, several=several)
        console.finish(command, [result, result], code)
    yield from capsys.readouterr()
    for name in set(Format) - {Format.text}:
        document = render(name, command, [result], code)
        if name in ("json", "sarif"):
            json.loads(document)
        if name == "junit":
            ET.fromstring(document)
        yield document


@pytest.mark.parametrize(("path", "key"), EVERYWHERE, ids=str)
def test_every_place_of_a_spec(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], path: tuple[Any, ...], key: bool
) -> None:
    spec = tmp_path / "p.yaml"
    spec.write_text(planted(path, key), encoding="utf-8")
    result = run(Job(spec, tmp_path / "p"), (), Settings())
    assert result.status in ("ok", "invalid")
    for text in told("validate", result, capsys):
        assert harmless(text), text


def test_what_is_accepted_reaches_reports_as_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A title, the sources and the words of `expect`, and the names of the file and its folder are free text."""
    document = yaml.safe_load(SPEC)
    document["title"] = f"<b>{PLANT}"
    for entry in document["expect"]:
        entry["source"] = PLANT
    document["expect"][1]["equals"] = PLANT
    folder = tmp_path / "::warning::\x1b[2J\n::error::x\u202e"
    folder.mkdir()
    os.chdir(folder)
    Path("p.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    result = run(Job(folder / "p.yaml", tmp_path / "out"), STAGES, Settings(out=tmp_path, effort=0))
    assert result.status == "finding"
    texts = list(told("run", result, capsys))
    assert any(r"\n::error::planted\r\x9b31m" in text for text in texts)
    files = [path for path in (tmp_path / "out").rglob("*") if path.suffix in (".md", ".html", ".svg", ".csv")]
    assert len(files) > 3
    for path in files:
        assert not OBEYED.search(path.read_text(encoding="utf-8")), path
    assert "\n::" not in (tmp_path / "out" / "report.md").read_text()
    for text in texts:
        assert harmless(text), text


@pytest.mark.parametrize(
    "name",
    ["\x1b[31m.yaml", "::error::x.yaml", "a\n::error::b.yaml", os.fsdecode(b"bytes \xff\xfe.yaml"), "\u202e.yaml"],
)
def test_names_of_files(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(PENDULUM.replace("period: 0.6", "period: 0.6\n  unknown: 1"))
    for output in Format:
        done = forked(["validate", name, "--format", output], tmp_path)
        assert done.returncode == 2
        assert harmless(done.stdout + done.stderr), done
    assert harmless(forked(["validate", "."], tmp_path).stdout)
    (tmp_path / name).write_text(PENDULUM)
    done = forked(["run", name, "--effort", "0"], tmp_path)
    assert done.returncode == 0
    assert harmless(done.stdout + done.stderr)


@pytest.mark.parametrize(
    "arguments",
    [["\x1b[31m"], ["validate", "--\x1b[31m"], ["init", "\x1b[31m"], ["validate", "p", "--jobs", "\x1b\n::error::x"]],
)
def test_command_lines(tmp_path: Path, arguments: list[str]) -> None:
    done = forked(arguments, tmp_path)
    assert done.returncode == 2
    assert harmless(done.stdout + done.stderr)


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "folder.yaml").mkdir()
    for name in ("pipe.yaml", "folder.yaml", "/dev/zero", "/dev/tty", "."):
        assert forked(["validate", name], tmp_path, timeout=10).returncode == 2
