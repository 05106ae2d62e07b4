"""Specs and commands of the pages: specs are right, commands exist, numbers of the papers are those of the specs."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import typer
import yaml
from command import ROOT
from docs_pages import WRITTEN, blocks, commands

from cdobs_cli.cli import app
from cdobs_cli.spec.model import load
from cdobs_cli.spec.schema import json_schema

CLI: Any = typer.main.get_command(app)
PAPERS = WRITTEN["papers.md"]


def loose(schema: Any) -> Any:
    """The schema of a part of a spec: what a whole one requires may be left out."""
    if isinstance(schema, list):
        return [loose(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {}
    for key, part in schema.items():
        if key in ("anyOf", "oneOf") and all(set(one) == {"required"} for one in part):
            continue
        if key != "required":
            kept[key] = part if key == "if" else loose(part)
    return kept


PART = jsonschema.Draft7Validator(loose(json_schema()))


@pytest.mark.parametrize("block", blocks("yaml"))
def test_specs_are_right(block: str, tmp_path: Path) -> None:
    typed = yaml.safe_load(block)
    if "spec_version" in typed:
        (tmp_path / "s.yaml").write_text(block, encoding="utf-8")
        load(tmp_path / "s.yaml")
        jsonschema.validate(typed, json_schema())
    elif "jobs" in typed:
        for line in (step["run"] for step in typed["jobs"]["observers"]["steps"] if "run" in step):
            assert line == "pip install cdobs" or is_a_command(line)
    else:
        PART.validate(typed)


@pytest.mark.parametrize("part", ["measurement: {perod: 1}", "measurement: {sampling: {period: [1]}}", "plants: 1"])
def test_a_wrong_part_would_be_seen(part: str) -> None:
    assert not PART.is_valid(yaml.safe_load(part))


def is_a_command(line: str) -> bool:
    """Whether the command line takes it; nothing is run."""
    words = shlex.split(line.partition("||")[0].partition(" > ")[0])
    command = CLI.commands[words[1]]
    command.make_context(words[1], words[2:])
    return words[0] == "cdobs"


@pytest.mark.parametrize("block", blocks("console"))
def test_commands_exist_and_name_what_exists(block: str) -> None:
    assert commands(block)
    for line in commands(block):
        assert is_a_command(line)
        assert all((ROOT / word).exists() for word in shlex.split(line) if word.startswith("specs"))


def test_a_command_that_does_not_exist_would_be_seen() -> None:
    with pytest.raises(Exception, match=r"(?i)no such option"):
        is_a_command("cdobs check specs --quick")


FINDINGS = re.split(r"^(?=\*\*|## )", PAPERS, flags=re.MULTILINE)


@pytest.mark.parametrize("finding", [one for one in FINDINGS if re.search(r"\d\.\d", one)])
def test_numbers_of_the_papers_page_are_expected_by_the_specs_beside(finding: str) -> None:
    named = re.findall(r"^\$ cdobs check (specs/\S+)$", finding, re.MULTILINE)
    told = re.sub(r"^```console\n.*?^```$", "", finding, flags=re.MULTILINE | re.DOTALL)
    texts = "\n".join((ROOT / name).read_text(encoding="utf-8") for name in named)
    for number in re.findall(r"\d+\.\d+", told):
        assert number in texts, f"{number} stands in none of {named}"


def test_every_erratum_that_ships_is_told() -> None:
    shipped = {
        path.stem for path in (ROOT / "specs").glob("*.yaml") if re.search("_printed|_corrected|_sign", path.stem)
    }
    told = set(re.findall(r"specs/(\w+)\.yaml", PAPERS))
    assert shipped and shipped <= told
    for name in told:
        assert yaml.safe_load((ROOT / "specs" / f"{name}.yaml").read_text(encoding="utf-8"))["expect"]
