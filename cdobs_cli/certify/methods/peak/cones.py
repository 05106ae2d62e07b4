"""Semidefinite cones assembled as rows, for searches whose unknowns are many small matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.lmi import Cone, SparseColumns, ask_with_multipliers
from cdobs_cli.certify.svec import svec, triangle

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ITERATIONS = 80
_TOLERANCE = 1e-8


class Svec:
    """Symmetric matrices of one size as vectors: a triangle by columns, off-diagonals times sqrt 2."""

    def __init__(self, size: int) -> None:
        self.i, self.j = triangle(size)
        self.scale = np.where(self.i == self.j, 1.0, np.sqrt(2.0))
        self.size, self.length = size, len(self.i)
        self.unit = self.of(np.eye(size))

    def of(self, matrices: Array) -> Array:
        """(.., size, size) to (.., length)."""
        return svec(matrices)

    def matrices(self, vectors: Array) -> Array:
        """(k, length) to (k, size, size)."""
        full = np.zeros((len(vectors), self.size, self.size))
        full[:, self.i, self.j] = full[:, self.j, self.i] = vectors / self.scale
        return full

    def diagonal(self, start: int) -> Array:
        """The vectors of the units of the diagonal from `start` on."""
        return self.of(np.array([np.diag(row) for row in np.eye(self.size)[start:]]).reshape(-1, self.size, self.size))

    @property
    def basis(self) -> Array:
        """The matrices whose vectors are unit vectors."""
        return self.matrices(np.eye(self.length))


class Rows:
    """Blocks sum_k x_k F_k + F_0 in semidefinite cones, as rows b - A x."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.cones: list[Cone] = []
        self.right: list[Array] = []
        self.entries: list[tuple[Any, Any, Any]] = []
        self.height = 0

    def copy(self) -> Rows:
        other = Rows(self.size)
        other.cones, other.right, other.entries = list(self.cones), list(self.right), list(self.entries)
        other.height = self.height
        return other

    def add(self, dimension: int, parts: dict[int, Array], constant: Array) -> None:
        """A block: of the unknowns from each start on what they add, (unknowns, length), and what is there without."""
        for start, coefficients in parts.items():
            k, row = np.nonzero(coefficients)
            self.entries.append((self.height + row, start + k, -coefficients[k, row]))
        self.cones.append(("psd", dimension))
        self.right.append(constant)
        self.height += len(constant)

    def equate(self, parts: dict[int, Array], constant: Array) -> None:
        """Equations: the same combination is 0."""
        if len(constant):
            self.add(len(constant), parts, constant)
            self.cones[-1] = ("zero", len(constant))

    def columns(self) -> tuple[SparseColumns, Array]:
        rows, columns, data = (np.concatenate(part) for part in zip(*self.entries, strict=True))
        return SparseColumns.of(rows, columns, data, (self.height, self.size)), np.concatenate(self.right)

    def least(self, cost: Array) -> Array | None:
        """The x of least cost as the solver has it, however it ended; None where it says that there is none."""
        met = self.least_with_multipliers(cost)
        return None if met is None else met[0]

    def least_with_multipliers(self, cost: Array) -> tuple[Array, Array] | None:
        """`least`, and the multipliers z of the rows: where A moves, the least cost moves by z'dA x."""
        A, b = self.columns()
        x, z, record = ask_with_multipliers(cost, A, b, self.cones, _TOLERANCE, _ITERATIONS)
        return (x, z) if "Infeasible" not in record.status and bool(np.all(np.isfinite(x))) else None

    def image(self, x: Array) -> Array:
        """A x."""
        image = np.zeros(self.height)
        for rows, columns, data in self.entries:
            np.add.at(image, rows, data * x[columns])
        return image
