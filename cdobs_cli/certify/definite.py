"""Definiteness of symmetric matrices: the only judge of sign."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from cdobs_cli.certificate import Status
from cdobs_cli.exact.matrix import Matrix


@dataclass(frozen=True)
class Definiteness:
    """proved, or undecided (LDL' in balls cannot refute a sufficient condition's use); `margin` m > 0 with
    M - m I > 0 proved, None otherwise."""

    status: Status
    margin: Fraction | None

    @property
    def proved(self) -> bool:
        return self.status == "proved"


def has_positive_pivots(M: Matrix) -> bool:
    """Whether M = M' > 0 is proved: every pivot of LDL' (no pivoting) is certainly positive.

    The upper triangle is not read: callers pass symmetric matrices by construction.
    """
    size = M.shape[0]
    rows: list[list[Any]] = M.tolist()
    for k in range(size):
        pivot = rows[k][k]
        if not pivot > 0:
            return False
        for i in range(k + 1, size):
            factor = rows[i][k] / pivot
            for j in range(k + 1, i + 1):
                rows[i][j] = rows[i][j] - factor * rows[j][k]
    return True


def positive_definite(M: Matrix) -> Definiteness:
    """Prove M > 0 for a symmetric matrix of rationals or balls, with a margin.

    The float eigenvalue only suggests which margin to try; the pivots decide.
    """
    import numpy as np

    if not all(value.is_finite() for row in M.balls().tolist() for value in row):
        return Definiteness("undecided", None)
    floats = M.floats
    if not np.all(np.isfinite(floats)):
        return Definiteness("undecided", None)
    smallest = float(np.linalg.eigvalsh((floats + floats.T) / 2)[0])
    for share in (0.99, 0.5):
        if smallest > 0:
            margin = Fraction(share * smallest)
            if has_positive_pivots(M - Matrix.identity(M.shape[0]) * margin):
                return Definiteness("proved", margin)
    return Definiteness("proved", Fraction(0)) if has_positive_pivots(M) else Definiteness("undecided", None)
