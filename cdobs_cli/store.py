"""Where designs, checks and runs live on disk: atomic writes, digests, nothing half-written.

Each artefact names the sha256 of what it came from, so a certificate cannot be shown beside another design.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.errors import ToolError

T = TypeVar("T")
MAX_ARTEFACT_BYTES = 256 * 2**20


def canonical(document: Any) -> bytes:
    """The one byte string of a JSON document: sorted keys, no spaces."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def digest(document: Any) -> str:
    """sha256 of the canonical form, in hex."""
    return hashlib.sha256(canonical(document)).hexdigest()


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside the target and rename: a reader sees the old file or the new one, never half of one.

    Raises:
        ToolError: the folder cannot be made or written.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise ToolError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


@dataclass(frozen=True)
class Store:
    """The folder `<out>/<stem>/` of one spec."""

    folder: Path

    def read(self, name: str) -> dict[str, Any] | None:
        """A JSON artefact; None where there is none, or what is there is not one."""
        path = self.folder / name
        try:
            if path.stat().st_size > MAX_ARTEFACT_BYTES:
                return None
            document = json.loads(path.read_bytes())
        except (OSError, ValueError, RecursionError):
            return None
        return document if isinstance(document, dict) else None

    def write(self, name: str, document: Mapping[str, Any]) -> None:
        """A JSON artefact, indented for people and diffs."""
        text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
        write_atomically(self.folder / name, (text + "\n").encode())

    def write_files(self, files: Mapping[str, bytes]) -> list[Path]:
        """Several files, each atomically; returns their paths."""
        for name, content in files.items():
            write_atomically(self.folder / name, content)
        return [self.folder / name for name in files]

    def design(self) -> Design | None:
        """The stored design; None where it is missing or unreadable."""
        return _read(Design.from_document, self.read("design.json"))

    def check(self) -> Check | None:
        """The stored check; None where it is missing or unreadable."""
        return _read(Check.from_document, self.read("check.json"))


def _read(reader: Callable[[dict[str, Any]], T], document: dict[str, Any] | None) -> T | None:
    if document is None or document.get("schema_version") != 1:
        return None
    try:
        return reader(document)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        return None
