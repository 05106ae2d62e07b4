"""Parts of the clock's range, for each of which an error is bounded by a chain of its own."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import floor
from typing import Any

from cdobs_cli.certify.bernstein import restriction
from cdobs_cli.certify.methods.clock.form import Shape, combination
from cdobs_cli.certify.methods.mean_square.form import sums
from cdobs_cli.certify.texts import rational
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Window:
    """A part [start, end] of a piece of the clock's range; the piece is [0, 1]."""

    piece: int
    start: Fraction
    end: Fraction

    def inside(self, P: list[Any], form: Shape, number: Callable[[Fraction], Any] = Fraction) -> list[Any]:
        """The Bernstein coefficients of P on the window, with weights of this kind."""
        local = P[self.piece * form.d : (self.piece + 1) * form.d + 1]
        rows = restriction(form.d, self.start, self.end)
        return [combination(tuple(map(number, weights)), local) for weights in rows]

    def until_end(
        self, q: list[Any], form: Shape, lengths: list[Any], number: Callable[[Fraction], Any] = Fraction
    ) -> Any:
        """int q from tau = 0 to the end of the window."""
        first = Window(self.piece, Fraction(0), self.end).inside(q, form, number)
        part = sum(first[1:], first[0]) * lengths[self.piece] * number(self.end / (form.d + 1))
        return sums(q, form, lengths)[self.piece * (form.d + 1)] + part

    def spans(self, lengths: list[Any], number: Callable[[Fraction], Any] = Fraction) -> list[Any]:
        """How much of each piece lies before the end of the window."""
        before, behind = lengths[: self.piece], lengths[self.piece + 1 :]
        return [*before, lengths[self.piece] * number(self.end), *(h * 0 for h in behind)]

    def split(self) -> tuple[Window, Window]:
        middle = (self.start + self.end) / 2
        return Window(self.piece, self.start, middle), Window(self.piece, middle, self.end)


def windows(form: Shape, ends: list[str]) -> list[Window]:
    """The windows that end there; together they cover the pieces. Raises: ValueError where they do not."""
    made: list[Window] = []
    last = Fraction(0)
    for end in map(rational, ends):
        piece = floor(last)
        if not last < end <= piece + 1:
            raise ValueError("windows are parts of one piece each, one behind the other")
        made.append(Window(piece, last - piece, end - piece))
        last = end
    if last != form.pieces:
        raise ValueError("windows cover all of the clock's range")
    return made
