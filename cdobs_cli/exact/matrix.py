"""Matrices of rationals or balls, written with the operators that numpy and cvxpy use.

An inequality is one pure function over `@`, `.T`, `+`, `-`, `*` and `block`; called with numpy arrays it
searches, called with a Matrix it proves.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from operator import add, mul, sub
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from flint import arb, arb_mat, fmpq, fmpq_mat

import cdobs_cli.exact.precision  # noqa: F401 - sets the working precision

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.exact.numbers import ExactMatrix

Scalar: TypeAlias = int | Fraction | fmpq | arb
T = TypeVar("T")


def _scalar(value: Scalar) -> fmpq | arb:
    if isinstance(value, arb | fmpq):
        return value
    value = Fraction(value)
    return fmpq(value.numerator, value.denominator)


class Matrix:
    """A matrix over fmpq where all its entries are rational, over arb otherwise.

    Products and sums of a rational and a ball matrix are ball matrices.
    """

    __array_ufunc__ = None  # numpy must not take `array @ Matrix` apart
    __slots__ = ("data",)

    def __init__(self, data: fmpq_mat | arb_mat) -> None:
        self.data = data

    @staticmethod
    def from_rows(rows: Iterable[Iterable[Scalar]]) -> Matrix:
        """Rational if every entry is, else balls."""
        table = [[_scalar(value) for value in row] for row in rows]
        height, width = len(table), len(table[0]) if table else 0
        flat = [value for row in table for value in row]
        if all(isinstance(value, fmpq) for value in flat):
            return Matrix(fmpq_mat(height, width, flat))
        return Matrix(arb_mat(height, width, [arb(value) for value in flat]))

    @staticmethod
    def from_exact(matrix: ExactMatrix) -> Matrix:
        return Matrix.from_rows([entry.scalar for entry in row] for row in matrix.rows)

    @staticmethod
    def from_floats(array: NDArray[np.float64] | Sequence[Sequence[float]]) -> Matrix:
        """Floats are dyadic rationals: nothing is rounded."""
        return Matrix.from_rows([Fraction(float(value)) for value in row] for row in array)

    @staticmethod
    def identity(size: int) -> Matrix:
        return Matrix(fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)]))

    @staticmethod
    def diagonal(entries: Sequence[Scalar]) -> Matrix:
        return Matrix.from_rows([[one if i == j else 0 for j in range(len(entries))] for i, one in enumerate(entries)])

    @staticmethod
    def zeros(height: int, width: int) -> Matrix:
        return Matrix(fmpq_mat(height, width))

    @property
    def is_rational(self) -> bool:
        return isinstance(self.data, fmpq_mat)

    @property
    def shape(self) -> tuple[int, int]:
        return self.data.nrows(), self.data.ncols()

    @property
    def T(self) -> Matrix:
        return Matrix(self.data.transpose())

    def balls(self) -> Matrix:
        """The same matrix over arb at the working precision."""
        return Matrix(self.arb)

    @property
    def arb(self) -> arb_mat:
        """The flint matrix over arb."""
        return arb_mat(self.data) if isinstance(self.data, fmpq_mat) else self.data

    def _with(self, other: Matrix) -> tuple[Any, Any]:
        return (self.data, other.data) if self.is_rational and other.is_rational else (self.arb, other.arb)

    def __matmul__(self, other: Matrix) -> Matrix:
        return Matrix(mul(*self._with(other)))

    def __add__(self, other: Matrix) -> Matrix:
        return Matrix(add(*self._with(other)))

    def __sub__(self, other: Matrix) -> Matrix:
        return Matrix(sub(*self._with(other)))

    def __neg__(self) -> Matrix:
        return self * -1

    def __mul__(self, scalar: Scalar) -> Matrix:
        scalar = _scalar(scalar)
        if isinstance(scalar, arb):
            return Matrix(self.arb * scalar)
        return Matrix(self.data * scalar) if self.is_rational else Matrix(self.arb * arb(scalar))

    __rmul__ = __mul__

    def __truediv__(self, scalar: Scalar) -> Matrix:
        quotient: Matrix = self * (1 / _scalar(scalar))
        return quotient

    def __getitem__(self, index: tuple[Any, Any]) -> Any:
        """An entry for two integers, a submatrix where either index is a slice or a list."""
        i, j = index
        height, width = self.shape
        if isinstance(i, int) and isinstance(j, int):
            return self.data[i % height, j % width]
        rows, columns = _positions(i, height), _positions(j, width)
        kind = fmpq_mat if self.is_rational else arb_mat
        return Matrix(kind(len(rows), len(columns), [self.data[a, b] for a in rows for b in columns]))

    def tolist(self) -> list[list[Any]]:
        rows: list[list[Any]] = self.data.tolist()
        return rows

    def exp(self, t: Scalar = 1) -> Matrix:
        """exp(M t), enclosed."""
        return Matrix((self.balls() * t).arb.exp())

    def inverse(self) -> Matrix:
        """Raises: ZeroDivisionError where the matrix may be singular."""
        return Matrix(self.data.inv())

    def solve(self, right: Matrix) -> Matrix:
        """Raises: ZeroDivisionError where the matrix may be singular."""
        left, other = self._with(right)
        return Matrix(left.solve(other))

    def trace(self) -> Any:
        return sum((self.data[i, i] for i in range(1, self.shape[0])), self.data[0, 0])

    @property
    def floats(self) -> NDArray[np.float64]:
        """Midpoints as floats."""
        import numpy as np

        return np.array([[float(arb(value).mid()) for value in row] for row in self.tolist()]).reshape(self.shape)


def _positions(index: Any, size: int) -> list[int]:
    if isinstance(index, slice):
        return list(range(size))[index]
    return [position % size for position in ([index] if isinstance(index, int) else index)]


def block(rows: Sequence[Sequence[T]]) -> T:
    """A block matrix of numpy arrays or stacks of them, Matrix objects, or cvxpy expressions."""
    parts: list[list[Any]] = [list(row) for row in rows]
    if isinstance(parts[0][0], Matrix):
        lines = [line for row in parts for line in zip(*(part.tolist() for part in row), strict=True)]
        table = [[value for part in line for value in part] for line in lines]
        return Matrix.from_rows(table)  # type: ignore[return-value]
    import numpy as np

    if all(isinstance(part, np.ndarray) for row in parts for part in row):
        # `np.block` takes several times as long for a few small parts.
        count = next((len(part) for row in parts for part in row if part.ndim == 3), 0)
        if count:  # stacks of matrices
            parts = [[np.broadcast_to(part, (count, *part.shape[-2:]), subok=True) for part in row] for row in parts]
        return np.concatenate([np.concatenate(row, axis=-1) for row in parts], axis=-2)  # type: ignore[return-value]
    import cvxpy

    stacked: T = cvxpy.bmat(parts)
    return stacked


def symmetric(M: Any) -> Any:
    """M + M'."""
    return M + M.T
