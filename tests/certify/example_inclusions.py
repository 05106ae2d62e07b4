"""Error inclusions for the tests of `certify`: any A, C, slope box, impulsive or held innovation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView, corrected_copy
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


def _held(view: PlantView[Any]) -> ErrorMaps[Any]:
    A, C, L = view.A, view.C, view.gain["L"]
    n, p = A.shape[0], C.shape[0]
    zero = C.T * 0  # (n, p)
    F = A - L @ C
    base = block([[F, L], [C @ F, C @ L]])
    parts = tuple(block([[part, zero], [C @ part, C @ zero]]) for part in view.parts)
    if isinstance(A, Matrix):
        jump = Matrix.from_rows([[int(i == j and i < n) for j in range(n + p)] for i in range(n + p)])
    else:
        jump = np.diag([1.0] * n + [0.0] * p)
    return ErrorMaps(base, parts, view.lower, view.upper, jump)


def impulsive(made: Plant, K: Rows) -> HybridInclusion:
    """edot = (A + V) e, e+ = (I - K C) e."""
    return HybridInclusion(corrected_copy, made, {"K": ExactMatrix(K)}, made.sampling, made.slopes.quantities)


def held(made: Plant, L: Rows) -> HybridInclusion:
    """edot = (A + V - L C) e + L w, w = C (e - e(t_k))."""
    return HybridInclusion(_held, made, {"L": ExactMatrix(L)}, made.sampling, made.slopes.quantities)
