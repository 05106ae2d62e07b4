"""Linear matrix inequalities given block by block: each says which unknowns it reads, and with which matrices.

    minimise c'x    subject to    F_b + sum_k x[columns_bk] F_bk >= 0,

in stacks of alike blocks, so that hundreds of small inequalities over hundreds of unknowns cost no Python loop. What
the solver returns is a guess: `definite.py` decides.
"""

from __future__ import annotations

from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.lmi import Cone, SparseColumns, ask_with_multipliers
from cdobs_cli.certify.svec import svec
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ITERATIONS = 100
# Of the cost's largest entry: with a cost of 1 the solver stops short of its tolerance on chains of functions.
_COST = 1e-3


@dataclass
class BlockProgram:
    """Unknowns x of this size, and the blocks required of them so far."""

    size: int
    _height: int = 0
    _rows: list[Any] = field(default_factory=list)
    _columns: list[Any] = field(default_factory=list)
    _data: list[Array] = field(default_factory=list)
    _right: list[Array] = field(default_factory=list)
    _cones: list[Cone] = field(default_factory=list)

    def copy(self) -> BlockProgram:
        """The same, to which more may be added."""
        return BlockProgram(
            self.size, self._height, list(self._rows), list(self._columns), list(self._data), list(self._right),
            list(self._cones),
        )  # fmt: skip

    def require(self, columns: Any, coefficients: Array, constants: Array) -> None:
        """constants[b] + sum_k x[columns[b, k]] coefficients[b, k] >= 0 for each b.

        Shapes: columns (b, k), coefficients (b, k, M, M), constants (M, M) or (b, M, M)."""
        stack, _, M, _ = coefficients.shape
        entries = svec(coefficients)
        block, which, row = np.nonzero(entries)
        height = M * (M + 1) // 2
        self._rows.append(self._height + block * height + row)
        self._columns.append(columns[block, which])
        self._data.append(-entries[block, which, row])
        self._right.append(svec(np.broadcast_to(constants, (stack, M, M))).reshape(-1))
        self._cones += [("psd", M)] * stack
        self._height += stack * height

    def at_least(self, rows: Array, right: Any) -> None:
        """rows x >= right, shapes (b, size) and (b,)."""
        columns = np.broadcast_to(np.arange(self.size), rows.shape)
        self.require(columns, rows[:, :, None, None], -np.asarray(right, dtype=float).reshape(-1, 1, 1))

    def minimise(self, cost: Array, tolerance: float = 1e-9) -> Array | None:
        """The solver's last iterate; None where it is no number."""
        met = self.minimise_with_multipliers(cost, tolerance)
        return None if met is None else met[0]

    def minimise_with_multipliers(self, cost: Array, tolerance: float = 1e-9) -> tuple[Array, Array] | None:
        """The same with the multipliers z of what is required: where its data move, the least cost moves by
        -z'd(slack)."""
        A = SparseColumns.of(*self._entries, (self._height, self.size))
        size = float(np.abs(cost).max()) / _COST or 1.0
        x, z, record = ask_with_multipliers(
            cost / size, A, np.concatenate(self._right), self._cones, tolerance, _ITERATIONS
        )  # fmt: skip
        usable = np.all(np.isfinite(x)) and "Infeasible" not in record.status
        return (x, z * size) if usable else None

    @property
    def _entries(self) -> tuple[Any, Any, Array]:
        """Rows, columns and data of A, in b - A x."""
        rows, columns, data = (np.concatenate(part) for part in (self._rows, self._columns, self._data))
        return rows, columns, data

    def slack(self, x: Array) -> Array:
        """b - A x, which is in the cones where all is met."""
        rows, columns, data = self._entries
        left: Array = np.concatenate(self._right) - np.bincount(rows, data * x[columns], self._height)
        return left
