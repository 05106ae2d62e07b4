"""The working precision of every ball: 128 bits, more where a proof asks for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from flint import ctx

WORKING_BITS = 128
ctx.prec = WORKING_BITS


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Balls at another precision inside the block."""
    before = ctx.prec
    ctx.prec = bits
    try:
        yield
    finally:
        ctx.prec = before
