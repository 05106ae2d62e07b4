"""The state that a stored bound is about."""

from __future__ import annotations

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.plant import Plant


def number_of(text: str, plant: Plant) -> int:
    """Raises: ValueError where the plant has no such state."""
    number = int(text)
    if not 0 <= number < plant.n:
        raise ValueError("a state that the plant does not have")
    return number


def unit(size: int, i: int) -> Matrix:
    """Column i of the identity, shape (size, 1)."""
    column: Matrix = Matrix.identity(size)[:, [i]]
    return column
