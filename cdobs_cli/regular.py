"""The bytes of a regular file: nothing else is opened, and nothing is waited for."""

from __future__ import annotations

import os
import stat
from pathlib import Path


class IrregularError(OSError):
    """What stands at a path is no regular file; its text says what."""


def regular_bytes(path: Path, limit: int) -> bytes:
    """The content, of a file longer than `limit` its first limit + 1 bytes.

    Raises:
        IrregularError: a folder, a named pipe, a device.
        OSError, ValueError: there is none, it cannot be read, or its name is none.
    """
    _refuse_irregular(os.stat(path).st_mode)  # opening a device may already do something
    # Should a named pipe take its place just now, O_NONBLOCK does not wait for a writer.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as stream:
        _refuse_irregular(os.fstat(handle).st_mode)
        return stream.read(limit + 1)


def _refuse_irregular(mode: int) -> None:
    if not stat.S_ISREG(mode):
        raise IrregularError("a directory" if stat.S_ISDIR(mode) else "not a regular file")
