"""exp and spectral radius of stacks of matrices, in floats: where to look, never what is true."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


def exponentials(batch: Array) -> Array:
    """exp of each matrix of a stack (k, N, N), in floats: scaling to norms below 1/8, a Taylor polynomial, squaring."""
    import numpy as np

    norms = np.abs(batch).sum(axis=-1).max(axis=-1) if batch.size else np.zeros(len(batch))
    squarings = int(max(0, np.ceil(np.log2(max(norms.max(initial=0.0), 1e-300))) + 3))
    if squarings > 40:  # overflow or far beyond any use
        return np.full_like(batch, np.nan)
    scaled = batch / 2.0**squarings
    identity = np.broadcast_to(np.eye(batch.shape[-1]), batch.shape)
    total = identity.copy()
    for k in range(9, 0, -1):
        total = identity + scaled @ total / k
    with np.errstate(all="ignore"):
        for _ in range(squarings):
            total = total @ total
    return total


def spectral_radii(batch: Array) -> Array:
    """rho of each matrix of a stack in floats; infinite where an entry is."""
    import numpy as np

    finite = np.isfinite(batch).all(axis=(-1, -2))
    radii = np.full(len(batch), np.inf)
    if finite.any():
        radii[finite] = np.abs(np.linalg.eigvals(batch[finite])).max(axis=-1)
    return radii
