"""The real matrices in a MATLAB file of version 5 or 7, from untrusted bytes: scipy's reader may crash on damaged ones.

A file is 128 bytes of text and then elements: a type, a number of bytes, and these, padded to 8; matrices may be
compressed by zlib. Of a matrix the elements are its flags, its dimensions, its name and its entries column by column.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

MAX_ENTRIES = 4096
_HEAD, _TEXT, _VERSION = 128, 124, {b"IM": ("<", 0x0100), b"MI": (">", 0x0100)}
_LONGEST = 1 << 20  # bytes that one compressed matrix may come to
_MATRIX, _COMPRESSED = 14, 15
# Types of entries: how struct calls them.
_FORMATS = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 9: "d", 12: "q", 13: "Q"}
_NUMERIC = range(6, 16)  # classes of arrays: double, single, and integers of 8 to 64 bits
_COMPLEX, _LOGICAL = 0x0800, 0x0200

Matrix = tuple[tuple[float, ...], ...]


class MatlabError(ValueError):
    """The bytes are no such file; its text says why."""


def real_matrices(data: bytes) -> dict[str, Matrix]:
    """The real matrices of numbers with 1 to 4096 entries, row by row, by name; what else there is is passed over.

    Raises: MatlabError.
    """
    if data[:10] == b"MATLAB 7.3":
        raise MatlabError("MATLAB files of version 7.3 are not read; save it with '-v7'")
    known = _VERSION.get(data[_TEXT + 2 : _HEAD])
    if known is None or struct.unpack_from(f"{known[0]}H", data, _TEXT)[0] != known[1]:
        raise MatlabError("this is no MATLAB file of version 5 or 7")
    order = known[0]
    found: dict[str, Matrix] = {}
    try:
        for kind, body in _elements(data[_HEAD:], order):
            if kind == _COMPRESSED:
                kind, body = next(_elements(_inflated(body), order))
            if kind == _MATRIX and (named := _matrix(body, order)) is not None:
                found[named[0]] = named[1]
    except (struct.error, zlib.error, StopIteration, UnicodeDecodeError):
        raise MatlabError("the MATLAB file is damaged") from None
    return found


def _inflated(body: bytes) -> bytes:
    return zlib.decompressobj().decompress(body, _LONGEST)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Types and contents; raises struct.error where one is cut off."""
    at = 0
    while at < len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        first = at + 8
        if kind >> 16:  # up to 4 bytes stand in the place of their number
            kind, length, first = kind & 0xFFFF, kind >> 16, at + 4
        if length > len(data) - first or (first == at + 4 and length > 4):
            raise struct.error
        yield kind, data[first : first + length]
        padded = length if kind == _COMPRESSED else -(-length // 8) * 8
        at = at + 8 if first == at + 4 else first + padded


def _matrix(body: bytes, order: str) -> tuple[str, Matrix] | None:
    parts = _elements(body, order)
    flags = struct.unpack_from(f"{order}I", next(parts)[1])[0]
    _, sizes = next(parts)
    name = next(parts)[1].decode("ascii")
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    if flags & 0xFF not in _NUMERIC or flags & (_COMPLEX | _LOGICAL) or len(shape) != 2:
        return None
    rows, columns = shape
    if rows < 1 or columns < 1 or not 1 <= rows * columns <= MAX_ENTRIES:
        return None
    kind, content = next(parts)
    entries = struct.unpack(f"{order}{rows * columns}{_FORMATS.get(kind, 'd')}", content)
    return name, tuple(tuple(float(entry) for entry in entries[i::rows]) for i in range(rows))
