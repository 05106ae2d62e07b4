"""Where designs, checks and runs live on disk: atomic writes, digests, nothing half-written, nothing edited.

Each artefact names the sha256 of what it came from, so a certificate cannot be shown beside another design, and
the sha256 of its own content, so that one which was edited or damaged counts as absent.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from cdobs_cli.certificate import Check
from cdobs_cli.codec import parse
from cdobs_cli.design import Design
from cdobs_cli.errors import ToolError
from cdobs_cli.records import dataclass
from cdobs_cli.regular import regular_bytes

T = TypeVar("T")
MAX_ARTEFACT_BYTES = 256 * 2**20
CONTENT = "content"  # the entry of `digests` for the artefact's own content
ARTEFACTS = ("design.json", "check.json", "simulation.json", "simulation.npz")
# A file on its way: .<name>.<process>.<random>.tmp
_TEMPORARY = re.compile(r"\..+\.([0-9]{1,10})\.[A-Za-z0-9_]{8}\.tmp", re.ASCII)
_STALE = 60.0  # s: no write takes as long


def canonical(document: Any) -> bytes:
    """The one byte string of a JSON document: sorted keys, no spaces."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def digest(document: Any) -> str:
    """sha256 of the canonical form, in hex."""
    return hashlib.sha256(canonical(document)).hexdigest()


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with the digest of its own content among its `digests`."""
    named = {name: text for name, text in document["digests"].items() if name != CONTENT}
    content = {**document, "digests": named}
    return {**content, "digests": {**named, CONTENT: digest(content)}}


def is_sealed(document: Mapping[str, Any]) -> bool:
    """Whether the document is what was sealed: schema version 1, and the digest of its content that it names."""
    named, version = document.get("digests"), document.get("schema_version")
    if type(version) is not int or version != 1:  # True and 1.0 are equal to 1
        return False
    if not isinstance(named, dict) or not all(isinstance(text, str) for text in named.values()):
        return False
    content: str = sealed(document)["digests"][CONTENT]
    return named.get(CONTENT) == content


def is_there(path: Path) -> bool:
    """Whether a regular file stands at the path.

    Raises:
        ToolError: what stands there is a folder, a named pipe, a device, or a link that leads nowhere.
    """
    if not os.path.lexists(path):
        return False
    try:
        mode, reason = path.stat().st_mode, ""
    except OSError as error:
        mode, reason = 0, f" ({(error.strerror or 'unreadable').lower()})"
    if not stat.S_ISREG(mode):
        raise ToolError(f"{path} is not a regular file{reason}; move it away")
    return True


def read_regular(path: Path) -> bytes | None:
    """The content of a regular file; None where there is none, or it cannot be read or is too large.

    Raises:
        ToolError: as `is_there`; what is no regular file is not opened.
    """
    if not is_there(path):
        return None
    try:
        content = regular_bytes(path, MAX_ARTEFACT_BYTES)
    except OSError:
        return None
    return content if len(content) <= MAX_ARTEFACT_BYTES else None


def sweep(folder: Path) -> None:
    """Take away what killed runs left half-written in a folder: files of ours whose process is gone, or that are
    older than any write takes. What another process is writing at this moment stays."""
    try:
        left = [entry for entry in os.scandir(folder) if entry.is_file(follow_symlinks=False)]
    except OSError:
        return
    for entry in left:
        named = _TEMPORARY.fullmatch(entry.name)
        try:
            if named and (not _is_alive(int(named[1])) or time.time() - entry.stat().st_mtime > _STALE):
                os.unlink(entry.path)
        except OSError:  # swept by another run, or not ours to take
            continue


def _is_alive(process: int) -> bool:
    if os.name != "posix":  # asking would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside the target and rename: a reader sees the old file or the new one, never half of one.

    Raises:
        ToolError: the folder cannot be made or written.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.{os.getpid()}.", suffix=".tmp", dir=path.parent)
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

    def open(self) -> None:
        """Make the folder ready for a run: what killed runs left half-written goes.

        Raises:
            ToolError: something that is not a regular file stands in the place of an artefact.
        """
        for folder in (self.folder, self.folder / "figures"):
            sweep(folder)
        for name in ARTEFACTS:
            is_there(self.folder / name)

    def has(self, name: str) -> bool:
        """Whether anything stands in the place of a file."""
        return os.path.lexists(self.folder / name)

    def read_bytes(self, name: str) -> bytes | None:
        """A file of the folder; None where there is none, or it cannot be read. Raises: ToolError, as `is_there`."""
        return read_regular(self.folder / name)

    def read(self, name: str) -> dict[str, Any] | None:
        """A JSON artefact; None where there is none, or what is there is not what was written."""
        content = self.read_bytes(name)
        try:
            document = None if content is None else parse(content)
        except ValueError:
            return None
        return document if isinstance(document, dict) and is_sealed(document) else None

    def write(self, name: str, document: Mapping[str, Any]) -> dict[str, Any]:
        """A JSON artefact, sealed, indented for people and diffs; returns it as it was written."""
        written = sealed(document)
        text = json.dumps(written, indent=1, ensure_ascii=False, allow_nan=False)
        write_atomically(self.folder / name, (text + "\n").encode())
        return written

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
    try:
        return None if document is None else reader(document)
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
