"""Numbers of a certificate as the decimal strings that design.json holds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# What searches write: read without the parser, which takes a hundred times as long.
_DECIMAL = re.compile(r"-?\d{1,40}(\.\d{1,40})?(e-?\d{1,2})?", re.ASCII)


def rational(text: str) -> Fraction:
    """Raises: ExpressionError, ValueError on what is no rational, or one beyond all bounds."""
    if isinstance(text, str) and _DECIMAL.fullmatch(text):
        return Fraction(text)
    value = Exact(text).rational
    if value is None:
        raise ValueError("a certificate holds rationals")
    return value


def rate_of(text: str) -> Fraction:
    """A decay rate sigma >= 0. Raises: ExpressionError, ValueError."""
    sigma = rational(text)
    if sigma < 0:
        raise ValueError("a rate below 0 is no decay")
    return sigma


def rationals(rows: Sequence[Sequence[str]]) -> Matrix:
    """A matrix from rows of decimals. Raises: ExpressionError, ValueError."""
    return Matrix.from_rows([[rational(text) for text in row] for row in rows])


def symmetric(rows: list[list[str]], size: int) -> Matrix:
    """A symmetric matrix of this size from all its rows. Raises: ExpressionError, ValueError."""
    matrix = ExactMatrix(rows)
    if matrix.shape != (size, size) or any(matrix[i, j] != matrix[j, i] for i in range(size) for j in range(i)):
        raise ValueError("a symmetric matrix is expected")
    return matrix.balls()


def symmetric_from_upper(rows: Sequence[Sequence[str]]) -> Matrix:
    """The symmetric matrix with this upper triangle, each row from the diagonal on. Raises: as `rational`."""
    size, upper = len(rows), [[rational(text) for text in row] for row in rows]
    return Matrix.from_rows([[upper[min(i, j)][abs(i - j)] for j in range(size)] for i in range(size)])


def upper_texts(P: NDArray[np.float64], digits: int) -> list[list[str]]:
    """The upper triangle of a symmetric matrix of floats, each row from the diagonal on, rounded to decimals."""
    return [[decimal_text(float(P[i, j]), digits) for j in range(i, len(P))] for i in range(len(P))]
