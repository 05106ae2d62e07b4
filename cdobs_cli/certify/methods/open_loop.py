"""Errors that decay without any correction: with the gain 0 no period is too long.

    P > 0,    P A_v + A_v' P + 2 sigma P < 0    at every corner A_v = A + V of the slope class:

V = e'Pe falls at rate 2 sigma whenever samples come, or if none ever does.
"""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np

from cdobs_cli.certify.cuts import MOST_CORNERS, largest_margin
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.lmi import symmetric
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.clock.form import lyapunov
from cdobs_cli.certify.texts import rate_of, symmetric_from_upper, upper_texts
from cdobs_cli.exact.numbers import fraction_text
from cdobs_cli.records import dataclass

_DIGITS = 12


@dataclass(frozen=True)
class OpenLoop(Method):
    """sigma; P: the upper triangle, each row from the diagonal on."""

    sigma: str
    P: list[list[str]]

    name: ClassVar[str] = "open_loop"
    rung: ClassVar[str] = "open_loop"
    source: ClassVar[str] = "common quadratic function of the plant alone"
    how: ClassVar[str] = "pivots of LDL' in balls"
    statement: ClassVar[str] = "The error decays by itself, without any sample"
    reach: ClassVar[Reach] = "some gain"
    endless: ClassVar[bool] = True
    nonlinear_outputs: ClassVar[bool] = True
    multirate: ClassVar[bool] = True
    by_graph: ClassVar[bool] = True

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """It is about the gain 0, whatever the question's."""
        view = question.inclusion.view_floats
        if 2 ** len(view.quantities) > MOST_CORNERS:
            return None
        corners = np.array(view.vertices)
        size = float(np.abs(corners).max()) if np.all(np.isfinite(corners)) else 0.0
        if not size > 0:
            return None
        n, sigma = question.plant.n, float(question.rate)
        solution, margin = largest_margin(
            {"P": symmetric(n)},
            lambda x, A: -lyapunov(x["P"], A, sigma) / size,
            list(corners),
            (lambda x: x["P"],),
            lambda x: np.trace(x["P"]) - n,
        )
        if not margin > 0:
            return None
        alone = cls(question.law, fraction_text(question.rate), upper_texts(solution.values["P"], _DIGITS))
        return alone if alone._holds(question) else None

    def _prove(self, question: Question) -> Proof:
        known = self.law.is_bounded or self.law.has_sensors
        return Proof.of(known and self._holds(question), rate_of(self.sigma))

    def _holds(self, question: Question) -> bool:
        P, sigma = symmetric_from_upper(self.P), rate_of(self.sigma)
        if P.shape != (question.plant.n,) * 2 or not has_positive_pivots(P.balls()):
            return False
        corners = question.inclusion.view_balls.vertices
        return all(has_positive_pivots((-lyapunov(P, A, sigma)).balls()) for A in corners)


@dataclass(frozen=True)
class Uncorrected(OpenLoop):
    """The same of a design whose gain is 0: its observer is the plant's copy, and corrects nothing."""

    name: ClassVar[str] = "uncorrected"
    reach: ClassVar[Reach] = "convergence"
    endless: ClassVar[bool] = False

    @classmethod
    def applies(cls, question: Question) -> bool:
        gains = question.inclusion.gain.values()
        return all(entry.sign() == 0 for gain in gains for row in gain.rows for entry in row)

    def _prove(self, question: Question) -> Proof:
        return super()._prove(question) if self.applies(question) else NOTHING
