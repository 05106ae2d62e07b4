"""Artefacts on disk: whole or not there, and refused where they are not ours."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cdobs_cli.errors import ToolError
from cdobs_cli.store import Store, canonical, digest, write_atomically


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "design.json"
    write_atomically(target, b"old")

    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_an_unwritable_place_is_a_tool_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolError, match="cannot write"):
        write_atomically(tmp_path / "file" / "below", b"")


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"schema_version": 2}', '{"schema_version": 1}', '{"schema_version": 1, "claims": 3}', "\x00"]
)
def test_what_is_not_an_artefact_is_not_read(tmp_path: Path, content: str) -> None:
    for name in ("design.json", "check.json"):
        (tmp_path / name).write_text(content)
    store = Store(tmp_path)
    assert store.design() is None
    assert store.check() is None


def test_digests_do_not_depend_on_order() -> None:
    assert digest({"a": 1, "b": [1, 2]}) == digest({"b": [1, 2], "a": 1})
    assert digest({"a": 1}) != digest({"a": "1"})
    with pytest.raises(ValueError, match="JSON"):
        canonical({"a": float("nan")})
