"""Linear matrix inequalities handed to Clarabel without a modelling layer.

An inequality is a pure function of its unknowns; because it is affine, its coefficients are read off by
evaluation at unit vectors. What the solver returns is a guess: `definite.py` decides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import field
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Literal

from cdobs_cli import progress
from cdobs_cli.certify import lapack
from cdobs_cli.design import SolverRecord
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_LOG: ContextVar[list[SolverRecord] | None] = ContextVar("solver log", default=None)
Cone = tuple[Literal["zero", "psd"], int]
Affine = Callable[[Mapping[str, "Array"]], "Array"]


@dataclass(frozen=True)
class Unknown:
    """A matrix unknown: `symmetric`, `full` or `diagonal`, shape (rows, columns)."""

    kind: Literal["symmetric", "full", "diagonal"]
    rows: int
    columns: int

    @property
    def size(self) -> int:
        """Number of free entries."""
        if self.kind == "symmetric":
            return self.rows * (self.rows + 1) // 2
        return self.rows if self.kind == "diagonal" else self.rows * self.columns

    def matrix(self, entries: Array) -> Array:
        """The matrix with these free entries."""
        import numpy as np

        if self.kind == "full":
            return entries.reshape(self.rows, self.columns)
        if self.kind == "diagonal":
            return np.diag(entries)
        matrix: Array = entries[_places(self.rows)]
        return matrix

    @property
    def units(self) -> Array:
        """The matrices of the unit vectors, shape (size, rows, columns)."""
        return _units(self)


@cache
def _places(size: int) -> Array:
    """Which free entry of a symmetric matrix stands where: the upper triangle row by row."""
    import numpy as np

    places = np.zeros((size, size), dtype=int)
    places[np.triu_indices(size)] = range(size * (size + 1) // 2)
    return np.maximum(places, places.T)


@cache
def _units(unknown: Unknown) -> Array:
    import numpy as np

    return np.array([unknown.matrix(row) for row in np.eye(unknown.size)])


def symmetric(size: int) -> Unknown:
    return Unknown("symmetric", size, size)


def full(rows: int, columns: int) -> Unknown:
    return Unknown("full", rows, columns)


def diagonal(size: int) -> Unknown:
    return Unknown("diagonal", size, size)


@dataclass(frozen=True)
class SparseColumns:
    """A compressed-column matrix with the attributes Clarabel reads (scipy.sparse takes long to import)."""

    data: Any
    indices: Any
    indptr: Any
    shape: tuple[int, int]
    has_canonical_format: bool = True
    has_sorted_indices: bool = True

    @staticmethod
    def of(rows: Any, columns: Any, data: Array, shape: tuple[int, int]) -> SparseColumns:
        """From its entries in any order; where one is met twice it is the sum."""
        import numpy as np

        order = np.lexsort((rows, columns))
        rows, columns, data = rows[order], columns[order], data[order]
        fresh = np.ones(len(rows), dtype=bool)
        fresh[1:] = (rows[1:] != rows[:-1]) | (columns[1:] != columns[:-1])
        data = np.add.reduceat(data, np.flatnonzero(fresh)) if len(data) else data
        rows, columns = rows[fresh], columns[fresh]
        pointers = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=shape[1]))])
        return SparseColumns(data, rows, pointers, shape)


@dataclass(frozen=True)
class Solution:
    """A guess. `solved` is true only for the status Solved: AlmostSolved and the rest are kept apart. multipliers: of
    the semidefinite requirements, in their order."""

    solved: bool
    values: Mapping[str, Array]
    objective: float
    record: SolverRecord
    multipliers: Sequence[Array] = ()


@dataclass
class Program:
    """maximise c(x) subject to F_k(x) >= 0 (semidefinite) and g(x) = 0, all affine in the unknowns.

    Example: Program({"P": symmetric(n), "t": full(1, 1)}), then `require`, `equate`, `maximise`, `solve`.
    """

    unknowns: Mapping[str, Unknown]
    _semidefinite: list[tuple[Array, Array]] = field(default_factory=list)
    _equalities: list[tuple[Array, Array]] = field(default_factory=list)
    _cost: Array | None = None

    @property
    def size(self) -> int:
        return sum(unknown.size for unknown in self.unknowns.values())

    def _split(self, x: Array) -> dict[str, Array]:
        values, start = {}, 0
        for name, unknown in self.unknowns.items():
            values[name] = unknown.matrix(x[start : start + unknown.size].copy())
            start += unknown.size
        return values

    def read(self, function: Affine) -> tuple[Array, Array]:
        """(offset, coefficients): function(x) = offset + sum_i x_i coefficients[i]."""
        import numpy as np

        offset = np.atleast_2d(np.asarray(function(self._split(np.zeros(self.size))), dtype=float))
        coefficients = np.empty((self.size, *offset.shape))
        for i, values in enumerate(self._at_units):
            coefficients[i] = np.atleast_2d(function(values)) - offset
        return offset, coefficients

    @cached_property
    def _at_units(self) -> list[dict[str, Array]]:
        """The unknowns at each unit vector: all 0 but for one free entry of one of them."""
        import numpy as np

        zeros = self._split(np.zeros(self.size))
        return [{**zeros, name: unit} for name, unknown in self.unknowns.items() for unit in unknown.units]

    def require(self, inequality: Affine) -> None:
        """inequality(x) >= 0 in the semidefinite order (a symmetric matrix; 1 x 1 for a scalar)."""
        self._semidefinite.append(self.read(inequality))

    def require_at_once(self, inequality: Affine) -> None:
        """`require` of an inequality made by +, -, products, .T and `block`, which take stacks of matrices: it is read
        at all unit vectors at once."""
        import numpy as np

        offset = np.asarray(inequality(self._split(np.zeros(self.size))))
        self._semidefinite.append((offset, np.asarray(inequality(self._stacks)) - offset))

    @cached_property
    def _stacks(self) -> dict[str, Array]:
        """`_at_units`, of each unknown one stack (size, rows, columns)."""
        import numpy as np

        from cdobs_cli.arrays import Stack

        stacks: dict[str, Array] = {}
        for name in self.unknowns:
            stacks[name] = np.array([values[name] for values in self._at_units]).view(Stack)
        return stacks

    def require_read(self, offset: Array, coefficients: Array) -> None:
        """`require` of an inequality in the form that `read` gives it."""
        self._semidefinite.append((offset, coefficients))

    def equate(self, equation: Affine) -> None:
        """equation(x) = 0, entry by entry."""
        self._equalities.append(self.read(equation))

    def maximise(self, objective: Affine) -> None:
        """The linear objective (its value must be one number)."""
        _, coefficients = self.read(objective)
        self._cost = -coefficients.reshape(self.size)

    def solve(self, *, tolerance: float = 1e-9, iterations: int = 200) -> Solution:
        """Ask Clarabel, one thread."""
        import numpy as np

        from cdobs_cli.certify.svec import svec, unsvec

        rows, right = [], []
        cones: list[Cone] = []
        for offset, coefficients in self._equalities:
            rows.append(-coefficients.reshape(self.size, -1).T)
            right.append(offset.reshape(-1))
            cones.append(("zero", offset.size))
        for offset, coefficients in self._semidefinite:
            rows.append(-svec(coefficients).T)
            right.append(svec(offset))
            cones.append(("psd", offset.shape[0]))
        cost = np.zeros(self.size) if self._cost is None else self._cost
        A, b = compressed(np.vstack(rows)), np.concatenate(right)
        x, z, record = ask_with_multipliers(cost, A, b, cones, tolerance, iterations)
        ends = np.cumsum([len(part) for part in right])
        places = [(end, cone) for end, (kind, cone) in zip(ends, cones, strict=True) if kind == "psd"]
        multipliers = [unsvec(z[end - size * (size + 1) // 2 : end], size) for end, size in places]
        return Solution(record.status == "Solved", self._split(x), -float(cost @ x), record, multipliers)


def ask_clarabel(
    cost: Array, A: SparseColumns, b: Array, cones: list[Cone], tolerance: float = 1e-9, iterations: int = 200
) -> tuple[Array, SolverRecord]:
    """minimise cost' x subject to b - A x in the product of cones; one thread. The last iterate and how it went:
    not a number, and `Panicked`, where the solver did.

    Cones: ("zero", size) or ("psd", dimension), a triangle by columns with off-diagonals times sqrt 2."""
    x, _, record = ask_with_multipliers(cost, A, b, cones, tolerance, iterations)
    return x, record


def ask_with_multipliers(
    cost: Array, A: SparseColumns, b: Array, cones: list[Cone], tolerance: float = 1e-9, iterations: int = 200,
    *, refined: bool = True,
) -> tuple[Array, Array, SolverRecord]:  # fmt: skip
    """`ask_clarabel` with z, the multipliers of b - A x: where data move, the least cost moves by z'(dA x - db).
    refined: whether the linear equations of each step are solved again for what rounding left of them, a fifth of the
    time."""
    import clarabel
    import numpy as np

    lapack.load()
    size = len(cost)
    zero = SparseColumns(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(size + 1, dtype=np.int64), (size, size))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.max_iter = iterations
    settings.iterative_refinement_enable = refined
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    kinds = {"zero": clarabel.ZeroConeT, "psd": clarabel.PSDTriangleConeT}
    product = [kinds[kind](count) for kind, count in cones]
    try:
        result = clarabel.DefaultSolver(zero, cost, A, b, product, settings).solve()
        x, z, status, count = np.array(result.x), np.array(result.z), str(result.status), int(result.iterations)
    except BaseException as panic:  # what Rust panics with is no Exception, and has a class that cannot be imported
        if type(panic).__name__ != "PanicException":
            raise
        x, z, status, count = np.full(size, np.nan), np.full(len(b), np.nan), "Panicked", 0
    record = SolverRecord("clarabel", clarabel.__version__, status, count)
    log = _LOG.get()
    if log is not None:
        log.append(record)
    progress.called()
    return x, z, record


@contextmanager
def solver_log() -> Iterator[list[SolverRecord]]:
    """Every call of the solver inside the block, in order."""
    records: list[SolverRecord] = []
    token = _LOG.set(records)
    try:
        yield records
    finally:
        _LOG.reset(token)
        outer = _LOG.get()
        if outer is not None:
            outer.extend(records)


def summary(records: Sequence[SolverRecord]) -> SolverRecord | None:
    """One record for many calls: the last status, iterations of all."""
    if not records:
        return None
    last = records[-1]
    return SolverRecord(last.name, last.version, last.status, sum(record.iterations for record in records))


_RAN_OUT = ("MaxIterations", "MaxTime", "NumericalError", "InsufficientProgress", "Panicked")


def ran_out(records: Sequence[SolverRecord]) -> str | None:
    """Where more than half of the calls ended without an answer: how many, and with which status most often."""
    lost = [record.status for record in records if record.status in _RAN_OUT]
    if 2 * len(lost) <= len(records) or not lost:
        return None
    most = max(sorted(set(lost)), key=lost.count)
    return f"the solver {records[-1].name} ran out in {len(lost)} of {len(records)} calls ({most})"


def compressed(A: Array) -> SparseColumns:
    """A dense array in compressed columns, exact zeros left out."""
    import numpy as np

    rows, columns = np.nonzero(A)
    return SparseColumns.of(rows, columns, A[rows, columns], A.shape)
