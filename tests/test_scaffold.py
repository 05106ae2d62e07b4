"""`cdobs init`: specs that say by which schema they are checked, and that schema beside them."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml
from command import forked

from cdobs_cli.errors import UsageError
from cdobs_cli.families import FAMILIES
from cdobs_cli.scaffold import SCHEMA_FILE, example, write_new
from cdobs_cli.spec.model import load


@pytest.mark.parametrize("family", ["auto", *FAMILIES])
def test_the_first_line_names_the_schema_that_is_written_beside(family: str, tmp_path: Path) -> None:
    done = forked(["init", family, "-o", "observers/first.yaml"], tmp_path)
    assert (done.returncode, done.stdout) == (0, "")
    spec = tmp_path / "observers" / "first.yaml"
    first, named = spec.read_text().splitlines()[0].split("$schema=")
    assert first == "# yaml-language-server: "
    jsonschema.validate(yaml.safe_load(spec.read_text()), json.loads(spec.with_name(named).read_text()))
    assert sorted(path.name for path in spec.parent.iterdir()) == [SCHEMA_FILE, "first.yaml"]


def test_nothing_is_overwritten_but_an_older_schema(tmp_path: Path) -> None:
    spec, schema = tmp_path / "s.yaml", tmp_path / SCHEMA_FILE
    schema.write_text("{}")
    write_new(spec, example())
    assert json.loads(schema.read_text())["title"] == "cdobs spec"
    for path in (spec, schema, tmp_path / "new" / SCHEMA_FILE):
        before = path.read_text() if path.exists() else None
        with pytest.raises(UsageError, match="choose another name"):
            write_new(path, "text")
        assert (path.read_text() if path.exists() else None) == before


def test_the_schema_is_printed_or_written(tmp_path: Path) -> None:
    printed = forked(["schema"], tmp_path).stdout
    assert forked(["schema", "-o", "one.json"], tmp_path).stdout == ""
    assert (tmp_path / "one.json").read_text() == printed


def test_the_shortest_spec_is_typed_in_its_own_coordinates_and_has_noise(tmp_path: Path) -> None:
    text = example()
    (tmp_path / "s.yaml").write_text(text)
    spec = load(tmp_path / "s.yaml")
    assert spec.choice is not None and spec.typed is not None and spec.plant.noise is not None
    assert len(text.splitlines()) <= min(len(family.example().splitlines()) for family in FAMILIES.values())
