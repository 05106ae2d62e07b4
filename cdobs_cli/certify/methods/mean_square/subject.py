"""What a mean square bound is about: the errors of all states, or one state's."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Self

import numpy as np

from cdobs_cli.certify.methods.base import Method, Question, Reach
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.setting import EPSILONS, Setting, errors_only, shape
from cdobs_cli.certify.methods.peak.state import number_of
from cdobs_cli.plant import Plant


class MeanSquareOfAll(Method):
    """A bound of the root of the time average of E sum_i e_i^2."""

    how: ClassVar[str] = "exact Bernstein coefficients"
    reach: ClassVar[Reach] = "mean square"
    nonlinear_outputs: ClassVar[bool] = True

    def quantity(self, plant: Plant) -> str:
        return "rms"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The guess of the least margin that is proved; none where the question is about one state."""
        if question.state is not None or not cls.applies(question):
            return None
        setting = Setting.of(question, errors_only(question.inclusion, np.ones(question.plant.n)))
        if setting is None:
            return None
        form = shape(question, setting)
        guesses = (cls._guess(question, setting, form, epsilon) for epsilon in EPSILONS)
        return next((made for made in guesses if made is not None and made.prove(question).holds), None)

    @classmethod
    @abstractmethod
    def _guess(cls, question: Question, setting: Setting, form: Shape, epsilon: float) -> Self | None:
        """What the solver finds with this margin; None where it finds nothing."""


class MeanSquareOfState(Method):
    """A bound of the root of E e_i^2 at the worst time.

    state: number of the state, from 0.
    """

    state: str

    how: ClassVar[str] = "exact Bernstein coefficients"
    reach: ClassVar[Reach] = "mean square"
    of_one_state: ClassVar[bool] = True

    def quantity(self, plant: Plant) -> str:
        """`rms.<state>`. Raises: ValueError."""
        return f"rms.{plant.states[number_of(self.state, plant)]}"

    def since(self, plant: Plant) -> str:
        """What a bound at every time asks of the periods, where they are not all one."""
        return "" if self.law.is_periodic else "where periods do not depend on noise and disturbance"
