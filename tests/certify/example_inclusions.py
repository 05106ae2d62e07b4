"""Error inclusions for the tests of `certify`: any A, C, slope box, impulsive or held innovation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

Rows = Sequence[Sequence[Any]]


def periodic(T: Any) -> SamplingLaw:
    return SamplingLaw.periodic(Exact(T))


def aperiodic(low: Any, high: Any) -> SamplingLaw:
    return SamplingLaw("aperiodic", Exact(low), Exact(high))


def plant(A: Rows, lower: Rows, upper: Rows, C: Rows, sampling: SamplingLaw) -> Plant:
    n = len(A)
    return Plant(
        states=tuple(f"x{i}" for i in range(n)), inputs=(), A=ExactMatrix(A), phi=(Exact(0).expression,) * n, B=None,
        C=ExactMatrix(C), slopes=Slopes(ExactMatrix(lower), ExactMatrix(upper)), sampling=sampling,
    )  # fmt: skip


def canonical(c: Sequence[Any], sampling: SamplingLaw) -> Plant:
    """A chain of integrators with |d phi_n / d x_j| <= c_j, C = [1 0 .. 0]."""
    n = len(c)
    A = [[1 if j == i + 1 else 0 for j in range(n)] for i in range(n)]
    zero = [[0] * n for _ in range(n - 1)]
    return plant(A, [*zero, [(-Exact(x)) for x in c]], [*zero, [Exact(x) for x in c]], [[1] + [0] * (n - 1)], sampling)


def _slopes(view: PlantView[Any]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    return tuple(view.unit(i) for i, _ in view.entries), tuple(view.unit(j).T for _, j in view.entries)


def _impulsive(view: PlantView[Any]) -> ErrorMaps[Any]:
    n = view.A.shape[0]
    left, right = _slopes(view)
    identity = view.unit(0) @ view.unit(0).T
    for i in range(1, n):
        identity = identity + view.unit(i) @ view.unit(i).T
    return ErrorMaps(view.A, left, right, view.lower, view.upper, identity - view.gain["K"] @ view.C)


def _held(view: PlantView[Any]) -> ErrorMaps[Any]:
    A, C, L = view.A, view.C, view.gain["L"]
    n, p = A.shape[0], C.shape[0]
    left, right = _slopes(view)
    zero = C @ view.unit(0) * 0  # (p, 1)
    F = A - L @ C
    base = block([[F, L], [C @ F, C @ L]])
    left = tuple(block([[column], [C @ column]]) for column in left)
    right = tuple(block([[row, zero.T]]) for row in right)
    if isinstance(A, Matrix):
        jump = Matrix.from_rows([[int(i == j and i < n) for j in range(n + p)] for i in range(n + p)])
    else:
        import numpy as np

        jump = np.diag([1.0] * n + [0.0] * p)
    return ErrorMaps(base, left, right, view.lower, view.upper, jump)


def impulsive(made: Plant, K: Rows) -> HybridInclusion:
    """edot = (A + V) e, e+ = (I - K C) e."""
    return HybridInclusion(_impulsive, made, {"K": ExactMatrix(K)}, made.sampling, made.slopes.uncertain)


def held(made: Plant, L: Rows) -> HybridInclusion:
    """edot = (A + V - L C) e + L w, w = C (e - e(t_k))."""
    return HybridInclusion(_held, made, {"L": ExactMatrix(L)}, made.sampling, made.slopes.uncertain)
