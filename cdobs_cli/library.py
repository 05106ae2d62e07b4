"""C compiled to a library by the machine's compiler, kept by its content.

Only what this user wrote, in a folder that nobody else may write, is ever loaded.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import stat
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

COMPILERS = ("cc", "gcc", "clang")
# Sums keep their order and products are not fused: the same bits for every run, wherever it stands.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared", "-w")
_TIMEOUT = 120  # seconds for one file
VARIABLE = "CDOBS_COMPILER"


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """The path of the compiler: what CDOBS_COMPILER names (nothing: none), else the first that is there."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return shutil.which(named) if named else None
    return next((path for name in COMPILERS if (path := shutil.which(name))), None)


def library(source: str) -> tuple[ctypes.CDLL, Path] | None:
    """The library made of a source, and its file; None where there is no compiler, or it does not take the source."""
    path = compiled(source)
    try:
        return None if path is None else (ctypes.CDLL(str(path)), path)
    except OSError:
        return None


def compiled(source: str) -> Path | None:
    """The file alone."""
    command, folder = compiler(), _folder()
    if command is None or folder is None:
        return None
    content = "\n".join([command, _version(command), *FLAGS, source])
    path = folder / f"{hashlib.sha256(content.encode()).hexdigest()}.so"
    return path if _is_own(path) or _compile(command, source, path) else None


@lru_cache(maxsize=4)
def _version(command: str) -> str:
    try:
        told = subprocess.run(  # noqa: S603 - the machine's compiler
            [command, "--version"], capture_output=True, text=True, timeout=_TIMEOUT, check=False
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return told.stdout


def _folder() -> Path | None:
    """Where libraries are kept: of this user alone, or none."""
    base = os.environ.get("XDG_CACHE_HOME") or ""
    try:
        home = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        folder = home / "cdobs"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return folder if _is_own(folder) else None
    except (OSError, RuntimeError):
        return None


def _is_own(path: Path) -> bool:
    """Whether it is there, of this user, and no other may write it."""
    try:
        told = path.lstat()
    except OSError:
        return False
    right = stat.S_ISREG(told.st_mode) or stat.S_ISDIR(told.st_mode)
    return right and told.st_uid == os.geteuid() and not told.st_mode & 0o022


def _compile(command: str, source: str, path: Path) -> bool:
    try:
        with tempfile.TemporaryDirectory(dir=path.parent) as work:
            written, made = Path(work) / "loop.c", Path(work) / "loop.so"
            written.write_text(source, encoding="ascii")
            line = [command, *FLAGS, "-o", str(made), str(written), "-lm"]
            done = subprocess.run(  # noqa: S603 - the machine's compiler, on our own text
                line, stdin=subprocess.DEVNULL, capture_output=True, timeout=_TIMEOUT, check=False, cwd=work
            )
            if done.returncode != 0:
                return False
            made.chmod(0o700)
            made.replace(path)
    except (OSError, subprocess.SubprocessError):
        return False
    return True
