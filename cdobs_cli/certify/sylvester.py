"""Coordinates in which a plant with output injection takes a wished-for form: T A - Lambda T = G C.

Row i of T is g_i C (A - lambda_i I)^-1 for a lambda_i that is no eigenvalue of A; with the rows Gamma C on
top, S = [Gamma C; T] turns A into an arrow-like matrix and L = S^-1 [diag(q) Gamma; 0] acts on the measured
coordinates only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.exact.matrix import Matrix


def is_observable(A: Matrix, C: Matrix) -> bool | None:
    """Whether (A, C) is observable: exactly for rational data; None where balls cannot tell."""
    from flint import fmpq_mat

    from cdobs_cli.exact.matrix import block

    rows = [C]
    for _ in range(A.shape[0] - 1):
        rows.append(rows[-1] @ A)
    stacked = block([[row] for row in rows])
    if isinstance(stacked.data, fmpq_mat):
        return bool(stacked.data.rank() == A.shape[0])
    gram = stacked.T @ stacked
    from flint import arb

    return True if not arb(gram.data.det()).contains(0) else None


def sylvester_rows(A: Array, C: Array, rates: Array, G: Array) -> Array | None:
    """T with T A - diag(rates) T = G C: row i solves t (A - lambda_i I) = g_i C.

    Args:
        rates: lambda_i, shape (k,). G: shape (k, p).
    Returns:
        T, shape (k, n), each row scaled to unit length (a row may be scaled freely); None where some
        lambda_i is (nearly) an eigenvalue of A.
    Source: Efimov2016, Assumption 3
    """
    import numpy as np

    n = len(A)
    rows = []
    for rate, g in zip(rates, G, strict=True):
        try:
            row = np.linalg.solve((A - rate * np.eye(n)).T, C.T @ g)
        except np.linalg.LinAlgError:
            return None
        length = float(np.linalg.norm(row))
        if not (np.isfinite(length) and length > 0):
            return None
        rows.append(row / length)
    return np.array(rows).reshape(len(rates), n)


def residual(A: Array, C: Array, T: Array, rates: Array, G: Array) -> float:
    """The largest entry of T A - diag(rates) T - D G C relative to |T| |A| + |C|, with the row scalings D that
    fit best: how far printed rows are from solving the Sylvester equation."""
    import numpy as np

    worst = 0.0
    for t, rate, g in zip(T, rates, G, strict=True):
        left, right = t @ A - rate * t, g @ C
        scale = float(left @ right) / max(float(right @ right), 1e-300)
        size = float(np.abs(left).max() + np.abs(t).max() * max(1.0, float(np.abs(A).max())))
        worst = max(worst, float(np.abs(left - scale * right).max()) / max(size, 1e-300))
    return worst
