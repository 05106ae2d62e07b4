"""Symmetric matrices as vectors that keep inner products, as the solver reads them: a triangle by columns."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


@cache
def triangle(size: int) -> tuple[Any, Any]:
    """Rows and columns of the upper triangle, by columns."""
    j, i = np.tril_indices(size)
    return i, j


@cache
def _weights(size: int) -> Any:
    i, j = triangle(size)
    return np.where(i == j, 1.0, np.sqrt(2.0))


def svec(matrices: Array) -> Array:
    """(.., M, M) to (.., M (M + 1) / 2): entries off the diagonal times sqrt 2."""
    size = matrices.shape[-1]
    i, j = triangle(size)
    vectors: Array = matrices[..., i, j] * _weights(size)
    return vectors


def unsvec(vectors: Array, size: int) -> Array:
    """The symmetric matrices of these vectors: (.., size (size + 1) / 2) to (.., size, size)."""
    i, j = triangle(size)
    matrices = np.zeros((*vectors.shape[:-1], size, size))
    matrices[..., i, j] = matrices[..., j, i] = vectors / _weights(size)
    return matrices


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
