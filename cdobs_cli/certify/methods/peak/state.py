"""What a stored bound is about: a state, and the errors that it starts from."""

from __future__ import annotations

from flint import arb

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Box, Plant


def number_of(text: str, plant: Plant) -> int:
    """Raises: ValueError where the plant has no such state."""
    number = int(text)
    if not 0 <= number < plant.n:
        raise ValueError("a state that the plant does not have")
    return number


def quantity_of(text: str, start: list[list[str]] | None, plant: Plant) -> str:
    """`error.<state>`, `error_transient.<state>`."""
    return f"error{'' if start is None else '_transient'}.{plant.states[number_of(text, plant)]}"


def unit(size: int, i: int) -> Matrix:
    """Column i of the identity, shape (size, 1)."""
    column: Matrix = Matrix.identity(size)[:, [i]]
    return column


def start_texts(start: Box | None) -> list[list[str]] | None:
    """[lower, upper] of each component."""
    if start is None:
        return None
    return [[str(low), str(high)] for low, high in zip(start.lower, start.upper, strict=True)]


def start_box(texts: list[list[str]] | None, plant: Plant) -> Box | None:
    """Raises: ValueError, ExpressionError on what is no box of errors of this plant."""
    if texts is None:
        return None
    ends = [(Exact(low), Exact(high)) for low, high in texts]
    if len(ends) != plant.n or any((high - low).sign() not in (0, 1) for low, high in ends):
        raise ValueError("a box has an interval for each state")
    return Box(tuple(low for low, _ in ends), tuple(high for _, high in ends))


def since(texts: list[list[str]] | None, plant: Plant) -> str:
    """`from e_x(0) in [-1, 1], e_v(0) in [0, 0]`."""
    if texts is None:
        return ""
    ends = zip(plant.states, texts, strict=True)
    return "from " + ", ".join(f"e_{name}(0) in [{low}, {high}]" for name, (low, high) in ends)


def holds_from(texts: list[list[str]] | None, start: Box) -> bool:
    """Whether the box of these texts holds another one."""
    if texts is None or len(texts) != len(start.lower):
        return False
    ends = zip(texts, start.lower, start.upper, strict=True)
    return all(Exact(low).is_at_most(below) and above.is_at_most(Exact(high)) for (low, high), below, above in ends)


def before_first_sample(start: Box, i: int) -> arb:
    """max |e_i| before the first sample."""
    return arb(start.sizes[i])
