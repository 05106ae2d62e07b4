"""One plant with one gain in z = S x, in balls and in floats: what every certificate and claim reads."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

from flint import arb

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.errors import ErrorSystem
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.families.interval.positivity import PositivityLimit, positivity_limit
from cdobs_cli.families.interval.theorems import (
    Coordinates,
    ObserverLoop,
    assumption_3,
    coordinates,
    observer_loop,
    width_matrix,
)
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class System:
    """A plant with S and L, and K_lower and K_upper where there is feedback. Its sampling law is not read.

    cut: whether measured rows of z are intersected with y at samples.
    """

    plant: Plant
    gain: Mapping[str, ExactMatrix]
    cut: bool = False
    effort: int = 1

    @staticmethod
    def of(question: Question) -> System:
        """The system of a question, kept for its other periods."""
        known: System | None = question.memory.get(System)
        if known is None or known.gain is not question.inclusion.gain:
            cut = question.card is not None and question.card.tighten == "intersect"
            known = System(question.plant, question.inclusion.gain, cut, question.level)
            question.memory[System] = known
        return known

    @property
    def n(self) -> int:
        return self.plant.n

    @cached_property
    def z(self) -> Coordinates:
        """Raises: ZeroDivisionError where S may be singular."""
        S, L = self.gain["S"].balls(), self.gain["L"].balls()
        return coordinates(self.plant.A.balls(), self.plant.C.balls(), S, S.inverse(), L)

    @cached_property
    def floats(self) -> Coordinates:
        S, L = self.gain["S"].floats, self.gain["L"].floats
        return coordinates(self.plant.A.floats, self.plant.C.floats, S, self.z.R.floats, L)

    @cached_property
    def Mtot(self) -> Matrix:
        Mtot: Matrix = width_matrix(self.z.Q0, self.z.Q1)
        return Mtot

    @cached_property
    def structure(self) -> tuple[str, ...]:
        """What of Assumption 3 fails."""
        return assumption_3(self.z.Q1)

    @cached_property
    def rows(self) -> dict[int, Matrix]:
        """Rows of z that the output sees, whether or not they are cut."""
        return measured_rows(self.plant.C.balls(), self.z.S)

    @cached_property
    def cut_rows(self) -> dict[int, Matrix]:
        return self.rows if self.cut else {}

    @cached_property
    def errors(self) -> ErrorSystem:
        return ErrorSystem.of(self.z, *self.widths, self.cut_rows)

    @cached_property
    def limit(self) -> PositivityLimit:
        return positivity_limit(self.errors.M, self.errors.N1, self.effort)

    @cached_property
    def widths(self) -> tuple[Matrix, Matrix]:
        """upper - lower of disturbance and noise, zeros where none is declared; shapes (n, 1) and (p, 1)."""
        return _width(self.plant.disturbance, self.n), _width(self.plant.noise, self.plant.p)

    @cached_property
    def delta_width(self) -> Matrix:
        """|S| (d_upper - d_lower) + |S L| (v_upper - v_lower)."""
        disturbance, noise = self.widths
        width: Matrix = absolute(self.z.S) @ disturbance + absolute(self.z.SL) @ noise
        return width

    @cached_property
    def predicted(self) -> tuple[Matrix, Matrix]:
        """A and A - L C."""
        A = self.plant.A.balls()
        return A, A - self.gain["L"].balls() @ self.plant.C.balls()

    @cached_property
    def held_loop(self) -> tuple[Matrix, Matrix]:
        """A and A + B (K_lower + K_upper) S."""
        assert self.plant.B is not None
        A, B, (K_lower, K_upper) = self.plant.A.balls(), self.plant.B.balls(), (K.balls() for K in self._K)
        return A, A + B @ (K_lower + K_upper) @ self.gain["S"].balls()

    @cached_property
    def loop(self) -> ObserverLoop:
        """(17) in balls."""
        assert self.plant.B is not None
        return observer_loop(self.z, self.z.S @ self.plant.B.balls(), *(K.balls() for K in self._K))

    @cached_property
    def float_loop(self) -> ObserverLoop:
        """(17) in floats."""
        assert self.plant.B is not None
        return observer_loop(self.floats, self.floats.S @ self.plant.B.floats, *(K.floats for K in self._K))

    @property
    def _K(self) -> tuple[ExactMatrix, ExactMatrix]:
        return self.gain["K_lower"], self.gain["K_upper"]


def _width(box: Box | None, size: int) -> Matrix:
    if box is None:
        return Matrix.zeros(size, 1)
    return ExactMatrix([[high - low] for low, high in zip(box.lower, box.upper, strict=True)]).balls()


def singular(S: ExactMatrix) -> str | None:
    """Why S has no inverse; None where it has one."""
    determinant = arb(S.balls().data.det())
    if not determinant.contains(0):
        return None
    if S.balls().is_rational:
        return "S is singular (det S = 0), so z = S x does not determine x"
    middle, radius = float(determinant.mid()), float(determinant.rad())
    return f"S may be singular: det S is only known to be within {radius:.1g} of {middle:.1g}"
