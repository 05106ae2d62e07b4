"""Coordinates on ker C, where the error lives right after a jump with C K = I."""

from __future__ import annotations

from typing import Any

from flint import arb

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, fmpq_fraction, fraction_text
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Kernel:
    """N a basis of ker C, R N = I, C+ with C_r C+ = I and R C+ = 0, for C_r the independent rows of C.

    R picks the states that are not pivots. Shapes, with m = rank C: N (n, n - m); R (n - m, n);
    C_plus (n, m); C_r (m, n). `rows` are the indices of C_r in C, `pivots` the pivot states.
    """

    C: Matrix
    rows: tuple[int, ...]
    pivots: tuple[int, ...]
    others: tuple[int, ...]
    N: Matrix
    R: Matrix
    C_plus: Matrix
    C_r: Matrix

    @property
    def dimension(self) -> int:
        """n - rank C."""
        return len(self.others)

    def gain(self, Z: ExactMatrix | None, digits: int) -> ExactMatrix:
        """K = C+ + N Z, exactly where that ends as a decimal, else rounded to `digits`; zero columns for the
        outputs that repeat others. Z has shape (n - m, m), None where n = m."""
        K = self.C_plus if Z is None else self.C_plus + self.N @ Z.balls()
        n, p = K.shape[0], self.C.shape[0]
        rows: list[list[Exact]] = [[Exact(0)] * p for _ in range(n)]
        for i in range(n):
            for column, k in enumerate(self.rows):
                rows[i][k] = Exact(_decimal(K[i, column], K, digits))
        return ExactMatrix(rows)

    def nearest(self, K: ExactMatrix) -> ExactMatrix:
        """The gain with C_r K = I exactly whose rows off the pivots are those of K."""
        Z = [[K[i, k] for k in self.rows] for i in self.others]
        return self.gain(ExactMatrix(Z) if Z and self.rows else None, 15)

    def is_kept(self, K: ExactMatrix) -> bool:
        """Whether C e = 0 exactly after each jump: C_r (I - K C) = 0."""
        residual = self.C_r - self.C_r @ K.balls() @ self.C
        return all(is_zero(value) for row in residual.tolist() for value in row)


def kernel(C: ExactMatrix) -> Kernel:
    """Gaussian elimination, the largest entry of each row as its pivot (balls decide what is not 0)."""
    matrix = C.balls()
    p, n = C.shape
    table: list[list[Any]] = matrix.tolist()
    rows: list[int] = []
    pivots: list[int] = []
    for i in range(p):
        row = list(table[i])
        for done, j in zip(rows, pivots, strict=True):
            factor = row[j] / table[done][j]
            row = [value - factor * other for value, other in zip(row, table[done], strict=True)]
            row[j] = row[j] * 0
        table[i] = row
        free = [j for j in range(n) if j not in pivots and (row[j] > 0 or row[j] < 0)]
        if free:
            rows.append(i)
            pivots.append(max(free, key=lambda j: (abs(_float(row[j])), -j)))
    others = tuple(j for j in range(n) if j not in pivots)
    C_r = matrix[rows, :] if rows else Matrix.zeros(0, n)
    inverse = C_r[:, pivots].inverse() if rows else Matrix.zeros(0, 0)
    free_part = -(inverse @ C_r[:, list(others)]) if rows else Matrix.zeros(0, n)
    N = [[0] * len(others) for _ in range(n)]
    C_plus = [[0] * len(rows) for _ in range(n)]
    for a, i in enumerate(pivots):
        for b in range(len(others)):
            N[i][b] = free_part[a, b]
        for b in range(len(rows)):
            C_plus[i][b] = inverse[a, b]
    for b, i in enumerate(others):
        N[i][b] = 1
    R = [[int(j == i) for j in range(n)] for i in others]
    return Kernel(
        matrix,
        tuple(rows),
        tuple(pivots),
        others,
        _matrix(N, n, len(others)),
        _matrix(R, len(others), n),
        _matrix(C_plus, n, len(rows)),
        C_r,
    )


def _matrix(rows: list[list[Any]], height: int, width: int) -> Matrix:
    return Matrix.from_rows(rows) if height and width else Matrix.zeros(height, width)


def _float(value: Any) -> float:
    return float(arb(value).mid())


def is_zero(value: Any) -> bool:
    """Certainly 0."""
    return bool(value.is_zero()) if isinstance(value, arb) else bool(value == 0)


def _decimal(value: Any, K: Matrix, digits: int) -> str:
    if K.is_rational:
        exact = fmpq_fraction(value)
        text = fraction_text(exact)
        return text if "/" not in text and len(text) <= 40 else decimal_text(exact, digits)
    return decimal_text(_float(value), digits)
