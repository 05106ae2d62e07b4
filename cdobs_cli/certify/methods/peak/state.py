"""What a bound of the largest error is about: a state, and the errors that it starts from."""

from __future__ import annotations

from typing import ClassVar

from flint import arb

from cdobs_cli.certify.methods.base import Method, Question, Reach
from cdobs_cli.certify.methods.clock.certificate import is_small
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Box, Plant


class PeakOfState(Method):
    """A bound of one state's error under bounded disturbance and noise.

    state: number of the state, from 0. start: the intervals of the errors before the first sample, where the bound is
    one for all time from them.
    """

    state: str
    start: list[list[str]] | None

    rung: ClassVar[str] = "peak"
    how: ClassVar[str] = "exact Bernstein coefficients"
    statement: ClassVar[str] = "The error stays bounded"
    reach: ClassVar[Reach] = "error bound"
    of_one_state: ClassVar[bool] = True

    @classmethod
    def takes(cls, question: Question) -> bool:
        """Whether all that is declared is bounded, periods are, and corners are few enough."""
        inclusion = question.inclusion
        known = inclusion.assemble_noise is not None and question.plant.has_only_bounded
        return known and is_small(inclusion) and question.law.is_bounded

    def quantity(self, plant: Plant) -> str:
        """`error.<state>`, `error_transient.<state>`."""
        return f"error{'' if self.start is None else '_transient'}.{plant.states[number_of(self.state, plant)]}"

    def since(self, plant: Plant) -> str:
        """`from e_x(0) in [-1, 1], e_v(0) in [0, 0]`."""
        if self.start is None:
            return ""
        ends = zip(plant.states, self.start, strict=True)
        return "from " + ", ".join(f"e_{name}(0) in [{low}, {high}]" for name, (low, high) in ends)

    def holds_from(self, start: Box) -> bool:
        if self.start is None or len(self.start) != len(start.lower):
            return False
        ends = zip(self.start, start.lower, start.upper, strict=True)
        return all(Exact(low).is_at_most(below) and above.is_at_most(Exact(high)) for (low, high), below, above in ends)


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


def before_first_sample(start: Box, i: int) -> arb:
    """max |e_i| before the first sample."""
    return arb(start.sizes[i])
