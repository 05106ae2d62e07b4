"""Standard streams that are closed, full or without a reader, and few descriptors: exit 3, no traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT

SHELL = "sh"
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")


def shell(folder: Path, line: str) -> tuple[int, str, str]:
    """Exit code, stdout, stderr of a line; `cdobs` is the tool."""
    tool = f'"{sys.executable}" -m cdobs_cli'
    done = subprocess.run(
        [SHELL, "-c", line.replace("cdobs", tool)], cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True, timeout=120, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert "Traceback" not in done.stdout + done.stderr
    assert "Exception ignored" not in done.stderr
    return done.returncode, done.stdout, done.stderr


@FULL
@pytest.mark.parametrize(
    "command",
    ["check p.yaml --format json", "check p.yaml", "theorems", "schema", "init interval", "--help", "--version"],
)
def test_a_full_disk_under_stdout(finished: Path, command: str) -> None:
    code, _, told = shell(finished, f"cdobs {command} > /dev/full")
    assert code == 3
    assert "No space left on device" in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("command", ["check p.yaml --format json", "validate p.yaml", "theorems"])
def test_a_closed_stdout(finished: Path, command: str) -> None:
    assert shell(finished, f"cdobs {command} >&-") == (3, "", "cdobs: stdout cannot be written: it is closed\n")


def test_a_closed_stdout_does_not_become_a_file(finished: Path, tmp_path: Path) -> None:
    """The next file that is opened would get descriptor 1, and what is printed."""
    (tmp_path / "p.yaml").write_text((finished / "p.yaml").read_text())
    assert shell(tmp_path, "cdobs synthesize p.yaml >&- <&-")[0] == 3
    assert [path.name for path in tmp_path.iterdir()] == ["p.yaml"]  # told at once, before any work


@pytest.mark.parametrize("stream", ["2>&-", pytest.param("2> /dev/full", marks=FULL)])
def test_without_stderr_the_document_tells(tmp_path: Path, stream: str) -> None:
    (tmp_path / "bad.yaml").write_text("[")
    code, out, _ = shell(tmp_path, f"cdobs validate bad.yaml --format json {stream}")
    assert code == 3
    document = json.loads(out)
    assert document["exit_code"] == 3
    assert document["results"][0]["messages"][0]["text"].startswith("stderr cannot be written: ")


@pytest.mark.parametrize("streams", [">&- 2>&-", ">&- 2>&- <&-", pytest.param("> /dev/full 2> /dev/full", marks=FULL)])
def test_without_any_stream_the_exit_code_tells(finished: Path, streams: str) -> None:
    assert shell(finished, f"cdobs check p.yaml --format json {streams}") == (3, "", "")


@pytest.mark.parametrize("most", [5, 6, 7, 8, 9, 10, 12])
def test_few_descriptors(tmp_path: Path, finished: Path, most: int) -> None:
    (tmp_path / "p.yaml").write_text((finished / "p.yaml").read_text())
    code, out, told = shell(tmp_path, f"ulimit -n {most}; cdobs run p.yaml --no-color --format json")
    if code == 0:
        assert json.loads(out)["exit_code"] == 0
        return
    assert code == 3
    assert "oo many open files" in told
    assert not out or json.loads(out)["exit_code"] == 3
