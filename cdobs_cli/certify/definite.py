"""Definiteness of symmetric matrices: the only judge of sign."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb, fmpq

from cdobs_cli.certify.ball import is_finite
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.records import dataclass

_TIGHT = Fraction(1, 10**10)


@dataclass(frozen=True)
class Definiteness:
    """`margin`: m >= 0 with M > 0 and M >= m I proved; None where nothing is (LDL' in balls refutes nothing)."""

    margin: Fraction | None

    @property
    def proved(self) -> bool:
        return self.margin is not None


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
        _eliminate(rows, k)
    return True


def _eliminate(rows: list[list[Any]], k: int) -> None:
    """One step of LDL' on the lower triangle, in place."""
    pivot = rows[k][k]
    for i in range(k + 1, len(rows)):
        factor = rows[i][k] / pivot
        for j in range(k + 1, i + 1):
            rows[i][j] = rows[i][j] - factor * rows[j][k]


def is_semidefinite(M: Matrix) -> bool | None:
    """Whether M = M' >= 0; None where balls cannot tell. A pivot of LDL' that is 0 has a row of zeros below it.

    The upper triangle is not read: callers pass symmetric matrices.
    """
    size = M.shape[0]
    rows: list[list[Any]] = M.tolist()
    for k in range(size):
        pivot, below = rows[k][k], [rows[i][k] for i in range(k + 1, size)]
        if pivot < 0 or (pivot == 0 and any(entry != 0 for entry in below)):
            return False
        if pivot == 0 and all(entry == 0 for entry in below):
            continue
        if not pivot > 0:
            return None
        _eliminate(rows, k)
    return True


def positive_definite(M: Matrix) -> Definiteness:
    """Prove M > 0 for a symmetric matrix of rationals or balls, with a margin.

    The float eigenvalue only suggests which margin to try; the pivots decide.
    """
    floats = M.floats
    if not is_finite(M) or not np.all(np.isfinite(floats)):
        return Definiteness(None)
    smallest = float(np.linalg.eigvalsh((floats + floats.T) / 2)[0])
    for share in (0.99, 0.5):
        if smallest > 0:
            margin = Fraction(share * smallest)
            if has_positive_pivots(M - Matrix.identity(M.shape[0]) * margin):
                return Definiteness(margin)
    return Definiteness(Fraction(0) if has_positive_pivots(M) else None)


@dataclass(frozen=True)
class Range:
    """A number between two proved ends."""

    low: Any
    high: Any


def eigenvalue_range(M: Matrix, *, smallest: bool) -> Range:
    """The smallest (largest) eigenvalue of a symmetric matrix between two proved ends: a Rayleigh quotient
    on the inner side, the pivots of M - m I on the outer. Unbounded where nothing is proved."""
    if not smallest:
        mirrored = eigenvalue_range(-M, smallest=True)
        return Range(-mirrored.high, -mirrored.low)
    if not is_finite(M):
        return Range(arb("-inf"), arb("inf"))
    values, vectors = np.linalg.eigh(M.floats)
    v = Matrix.from_floats(vectors[:, [0]])
    high = (v.T @ M @ v)[0, 0] / (v.T @ v)[0, 0]
    size = Fraction(float(np.abs(values).max()) or 1.0)
    for tolerance in (_TIGHT, _TIGHT * 10**4, Fraction(1, 10), Fraction(2)):
        low = Fraction(float(values[0])) - tolerance * size
        if has_positive_pivots(M - Matrix.identity(M.shape[0]) * low):
            return Range(fmpq(low.numerator, low.denominator), high)
    return Range(arb("-inf"), high)
