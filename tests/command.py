"""The command line as a user runs it: what tests of it share."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from cdobs_cli.batch import Settings, run
from cdobs_cli.outcome import STAGES, Job, Result

ROOT = Path(__file__).parent.parent
PENDULUM = """\
spec_version: 1
title: Pendulum
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
measurement:
  C: [[1, 0]]
  sampling: {period: 0.6}
observer:
  family: reachability
  method: set
simulation:
  horizon: 6
  initial_state: [1, 0]
  initial_estimate: [0, 0]
"""
Cdobs = Callable[..., "subprocess.CompletedProcess[str]"]


def made(folder: Path, text: str, stages: tuple[str, ...] = STAGES, effort: int = 0) -> Result:
    """What the stages make of a spec, in this process."""
    (folder / "s.yaml").write_text(text)
    return run(Job(folder / "s.yaml", folder / "out"), stages, Settings(out=folder, effort=effort))


@dataclass(frozen=True)
class Done:
    """A process that has ended."""

    returncode: int
    stdout: str
    stderr: str


def forked(arguments: list[str], folder: Path, before: Callable[[], None] = lambda: None, timeout: float = 60) -> Done:
    """The command in a process of its own that need not load its modules again.

    `before` is called in that process first: it may break what a test wants broken.
    """
    out, err = folder / ".stdout", folder / ".stderr"
    child = os.fork()
    if child == 0:
        code = 99
        try:
            code = _command(arguments, folder, out, err, before)
        finally:
            os._exit(code)
    deadline = time.monotonic() + timeout
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            raise AssertionError(f"{arguments} did not end within {timeout} s: {err.read_text()}")
        time.sleep(0.005)
    return Done(os.waitstatus_to_exitcode(status), out.read_text(encoding="utf-8"), err.read_text(encoding="utf-8"))


def _command(arguments: list[str], folder: Path, out: Path, err: Path, before: Callable[[], None]) -> int:
    os.chdir(folder)
    for number, path in ((1, out), (2, err)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout = io.TextIOWrapper(os.fdopen(1, "wb", closefd=False), encoding="utf-8")
    sys.stderr = io.TextIOWrapper(os.fdopen(2, "wb", closefd=False), encoding="utf-8", line_buffering=True)
    sys.argv = ["cdobs", *arguments]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    from cdobs_cli.cli import run as entry

    try:
        before()
        entry()
    except SystemExit as error:
        return int(error.code or 0)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return 0
