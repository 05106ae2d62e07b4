"""Elementwise parts of a matrix, A^+, A^- and |A|, the diagonal and the rest, and what else takes either arithmetic.

Each function takes a numpy array or a Matrix and returns the same kind; balls that straddle zero stay enclosures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import reduce
from typing import Any, TypeAlias

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.exact.matrix import Matrix, block

M: TypeAlias = Any  # a numpy array or a Matrix


def positive_part(A: M) -> M:
    """A^+ = max(0, A).

    Source: Efimov2016, (1)
    """
    return _each(A, lambda value: arb.max(value, arb(0)) if isinstance(value, arb) else max(value, 0), _above_0)


def negative_part(A: M) -> M:
    """A^- = A^+ - A = max(0, -A).

    Source: Efimov2016, (1)
    """
    return positive_part(-A)


def absolute(A: M) -> M:
    """|A| = A^+ + A^-.

    Source: Efimov2016, (1)
    """
    return _each(A, abs, np.abs)


def diagonal_part(A: M) -> M:
    """The main diagonal, zeros elsewhere."""
    return _where(A, lambda i, j: i == j)


def off_diagonal_part(A: M) -> M:
    """Everything but the main diagonal."""
    return _where(A, lambda i, j: i != j)


def metzler_split(Q: M) -> tuple[M, M]:
    """(P, N) with Q = P - N, P Metzler and N >= 0: P keeps the diagonal.

        P = diag(Q) + offdiag(Q)^+,    N = offdiag(Q)^-

    Source: Efimov2016, (12)
    Deviates: the paper splits the diagonal of the first rows as well, which couples the two bounds needlessly
        where it is negative.
    """
    rest = off_diagonal_part(Q)
    return diagonal_part(Q) + positive_part(rest), negative_part(rest)


def both_sides(M: Any) -> Any:
    """[M^+ M^-; M^- M^+]: distances from both ends of a box of v, as distances of M v from both ends of its box."""
    plus, minus = positive_part(M), negative_part(M)
    return block([[plus, minus], [minus, plus]])


def zeros_like(example: M, height: int, width: int) -> M:
    """A zero matrix in the arithmetic of another."""
    return Matrix.zeros(height, width) if isinstance(example, Matrix) else np.zeros((height, width))


def identity_like(example: M, size: int) -> M:
    """An identity in the arithmetic of another matrix."""
    return Matrix.identity(size) if isinstance(example, Matrix) else np.eye(size)


def symmetrised(M: Matrix) -> Matrix:
    """(M + M')/2: stored matrices are symmetric up to what someone typed."""
    return (M + M.T) * Fraction(1, 2)


def solve(A: Any, b: Any) -> Any:
    """A^-1 b in the arithmetic of A."""
    return A.solve(b) if isinstance(A, Matrix) else np.linalg.solve(A, b)


def column(values: Iterable[Any]) -> Matrix:
    """Numbers as one column."""
    return Matrix.from_rows([[value] for value in values])


def entries(v: Matrix) -> list[arb]:
    """The entries of a column in balls."""
    return [arb(row[0]) for row in v.tolist()]


def lower_of(one: Matrix, other: Matrix) -> Matrix:
    """Entry by entry an upper bound of the smaller of two columns."""
    return column(arb.min(a, b).upper() for a, b in zip(entries(one), entries(other), strict=True))


def highest(columns: Iterable[Matrix]) -> Matrix:
    """Entry by entry an upper bound of the largest of some columns."""
    highest = [[value.upper() for value in entries(one)] for one in columns]
    return column(reduce(arb.max, row) for row in zip(*highest, strict=True))


def _above_0(floats: Array) -> Array:
    return np.maximum(floats, 0.0)


def _each(A: M, entry: Callable[[Any], Any], floats: Callable[[Any], Any]) -> M:
    if isinstance(A, Matrix):
        return Matrix.from_rows([[entry(value) for value in row] for row in A.tolist()])
    return floats(np.asarray(A, dtype=float))


def _where(A: M, kept: Callable[[Any, Any], Any]) -> M:
    if isinstance(A, Matrix):
        rows = [[value if kept(i, j) else 0 for j, value in enumerate(row)] for i, row in enumerate(A.tolist())]
        return Matrix.from_rows(rows)
    floats = np.asarray(A, dtype=float)
    return np.where(np.fromfunction(kept, floats.shape), floats, 0.0)
