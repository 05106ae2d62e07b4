"""Elementwise parts of a matrix, in floats and in balls: A^+, A^- and |A|, the diagonal and the rest.

Each function takes a numpy array or a Matrix and returns the same kind; balls that straddle zero stay enclosures.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from flint import arb, fmpq

from cdobs_cli.exact.matrix import Matrix

T = TypeVar("T")


def positive_part(A: T) -> T:
    """A^+ = max(0, A).

    Source: Efimov2016, (1)
    """
    return _entries(A, lambda i, j, value: _maximum(value, 0 * value))


def negative_part(A: T) -> T:
    """A^- = A^+ - A = max(0, -A).

    Source: Efimov2016, (1)
    """
    return _entries(A, lambda i, j, value: _maximum(-value, 0 * value))


def absolute(A: T) -> T:
    """|A| = A^+ + A^-.

    Source: Efimov2016, (1)
    """
    return _entries(A, lambda i, j, value: abs(value))


def diagonal_part(A: T) -> T:
    """The main diagonal, zeros elsewhere."""
    return _entries(A, lambda i, j, value: value if i == j else 0 * value)


def off_diagonal_part(A: T) -> T:
    """Everything but the main diagonal."""
    return _entries(A, lambda i, j, value: 0 * value if i == j else value)


def metzler_split(Q: T) -> tuple[T, T]:
    """(P, N) with Q = P - N, P Metzler and N >= 0: P keeps the diagonal.

        P = diag(Q) + offdiag(Q)^+,    N = offdiag(Q)^-

    Source: Efimov2016, (12)
    Deviates: the paper splits the diagonal of the first rows as well, which couples the two bounds needlessly
        where it is negative.
    """
    rest: Any = off_diagonal_part(Q)
    diagonal: Any = diagonal_part(Q)
    return diagonal + positive_part(rest), negative_part(rest)


def zeros_like(example: T, height: int, width: int) -> T:
    """A zero matrix in the arithmetic of another."""
    if isinstance(example, Matrix):
        return Matrix.zeros(height, width)  # type: ignore[return-value]
    import numpy as np

    return np.zeros((height, width))  # type: ignore[return-value]


def _maximum(a: Any, b: Any) -> Any:
    if isinstance(a, fmpq):
        return max(a, b)
    if isinstance(a, arb):
        return arb.max(a, b)
    return max(float(a), float(b))


def _entries(A: T, entry: Callable[[int, int, Any], Any]) -> T:
    values: Any = A
    if isinstance(values, Matrix):
        return Matrix.from_rows([[entry(i, j, value) for j, value in enumerate(row)] for i, row in enumerate(values.tolist())])  # type: ignore[return-value]
    import numpy as np

    floats: Any = np.array([[entry(i, j, value) for j, value in enumerate(row)] for i, row in enumerate(values)], dtype=float)
    return floats  # type: ignore[no-any-return]
