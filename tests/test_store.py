"""Artefacts on disk: whole or not there, and refused where they are not ours."""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cdobs_cli.errors import ToolError
from cdobs_cli.store import Store, canonical, digest, is_sealed, read_regular, sealed, sweep, write_atomically


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
    "content",
    ["", "[]", "{", '{"schema_version": 2}', '{"schema_version": 1}', '{"schema_version": 1, "claims": 3}', "\x00"],
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


DOCUMENT = {"schema_version": 1, "bounds": {"a": 0.5}, "digests": {"key": "k"}}


def test_a_sealed_document_is_what_was_sealed(tmp_path: Path) -> None:
    written = Store(tmp_path).write("check.json", DOCUMENT)
    assert Store(tmp_path).read("check.json") == written
    assert sealed(written) == written
    # White space and the order of keys are no content.
    (tmp_path / "check.json").write_text(json.dumps(dict(reversed(written.items()))))
    assert Store(tmp_path).read("check.json") == written


@pytest.mark.parametrize(
    "change",
    [
        {"bounds": {"a": 0.25}}, {"bounds": {}}, {"more": 1}, {"digests": []}, {"digests": {}},
        {"digests": {"content": 1}},
        {"schema_version": 2}, {"schema_version": True}, {"schema_version": 1.0}, {"schema_version": None},
    ],
)  # fmt: skip
def test_another_content_breaks_the_seal(change: dict[str, Any]) -> None:
    assert is_sealed(sealed(DOCUMENT))
    assert not is_sealed(sealed(DOCUMENT) | change)


@pytest.mark.parametrize("version", [2, True, 1.0, "1", None])
def test_a_seal_of_another_version_is_none(version: Any) -> None:
    assert not is_sealed(sealed(DOCUMENT | {"schema_version": version}))


def fifo(path: Path) -> None:
    os.mkfifo(path)


def listening(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        here = Path.cwd()
        os.chdir(path.parent)  # a socket's path is short
        try:
            one.bind(path.name)
        finally:
            os.chdir(here)


def linked_fifo(path: Path, pipe: Path) -> None:
    fifo(pipe)
    path.symlink_to(pipe.name)


STRANGE: dict[str, Callable[[Path], None]] = {
    "fifo": fifo, "folder": Path.mkdir, "socket": listening, "device": lambda path: path.symlink_to("/dev/zero"),
    "dangling link": lambda path: path.symlink_to("nowhere"), "loop": lambda path: path.symlink_to(path.name),
    "link to a fifo": lambda path: linked_fifo(path, path.with_suffix(".fifo")),
}  # fmt: skip


@pytest.mark.parametrize("kind", STRANGE)
def test_what_is_no_regular_file_is_refused_and_not_opened(tmp_path: Path, kind: str) -> None:
    for name in ("design.json", "check.json", "simulation.json", "simulation.npz"):
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        STRANGE[kind](folder / name)
        with pytest.raises(ToolError, match=f"{name} is not a regular file"):
            Store(folder).open()
        with pytest.raises(ToolError, match=f"{name} is not a regular file"):
            Store(folder).read_bytes(name)


def test_a_link_to_a_file_is_read_and_a_file_that_cannot_be_read_is_absent(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"text")
    (tmp_path / "b").symlink_to("a")
    assert read_regular(tmp_path / "b") == b"text"
    assert read_regular(tmp_path / "c") is None


def left(folder: Path, process: int, *, age: float = 0.0, name: str = "design.json") -> Path:
    path = folder / f".{name}.{process}.abcd1234.tmp"
    path.write_text("half")
    os.utime(path, (time.time() - age,) * 2)
    return path


def test_what_killed_runs_left_is_swept_and_nothing_else(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    dead, old = left(tmp_path, ended.pid), left(tmp_path, os.getpid(), age=120.0)
    now = left(tmp_path, os.getpid(), name="check.json")
    others = [
        tmp_path / name
        for name in (".design.json.abcd1234", f".notes.{ended.pid}.tmp", ".report.sha256", "design.json")
    ]
    for path in others:
        path.write_text("")
    figures = tmp_path / "figures"
    figures.mkdir()
    drawn = left(figures, ended.pid, name="states.svg")
    Store(tmp_path).open()
    assert not dead.exists()
    assert not old.exists()
    assert not drawn.exists()
    assert now.exists()
    assert all(path.exists() for path in others)
    sweep(tmp_path / "nowhere")


def _write_and_sweep(path: Path) -> None:
    for _ in range(60):
        write_atomically(path, b"content")
        sweep(path.parent)


def test_runs_side_by_side_do_not_sweep_each_other(tmp_path: Path) -> None:
    workers = [
        multiprocessing.get_context("fork").Process(target=_write_and_sweep, args=(tmp_path / "design.json",))
        for _ in range(3)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0, 0, 0]
    assert [path.name for path in tmp_path.iterdir()] == ["design.json"]


def test_a_killed_write_is_swept_by_the_next_run(tmp_path: Path) -> None:
    code = (
        "import os, signal; from pathlib import Path; from cdobs_cli.store import write_atomically;"
        "os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL); write_atomically(Path('design.json'), b'half')"
    )
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent.parent)},
        check=False,
    )
    assert len(list(tmp_path.iterdir())) == 1
    Store(tmp_path).open()
    assert not list(tmp_path.iterdir())
