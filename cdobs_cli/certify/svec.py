"""Symmetric matrices as vectors that keep inner products, as the solver reads them: a triangle by columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


def triangle(size: int) -> tuple[Any, Any]:
    """Rows and columns of the upper triangle, by columns."""
    j, i = np.tril_indices(size)
    return i, j


def svec(matrices: Array) -> Array:
    """(.., M, M) to (.., M (M + 1) / 2): entries off the diagonal times sqrt 2."""
    i, j = triangle(matrices.shape[-1])
    return matrices[..., i, j] * np.where(i == j, 1.0, np.sqrt(2.0))


def symmetric_basis(size: int) -> Array:
    """(t, size, size) with t = size (size + 1) / 2: the symmetric matrices whose vectors are unit vectors."""
    i, j = triangle(size)
    basis = np.zeros((len(i), size, size))
    value = np.where(i == j, 1.0, np.sqrt(0.5))
    basis[np.arange(len(i)), i, j] = value
    basis[np.arange(len(i)), j, i] = value
    return basis


def full_basis(rows: int, columns: int) -> Array:
    """(rows columns, rows, columns): the matrices with one entry 1."""
    return np.eye(rows * columns).reshape(-1, rows, columns)
