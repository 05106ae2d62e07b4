"""What bounds of one state's error say, by the kind of what is declared: at most, or in mean square."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from cdobs_cli.certify.methods.base import Reach
from cdobs_cli.certify.methods.peak.state import number_of
from cdobs_cli.plant import Plant


class OfState:
    """A bound `<head>.<state>`; state: its number, from 0."""

    state: str

    of_one_state: ClassVar[bool] = True
    head: ClassVar[str]

    @classmethod
    @abstractmethod
    def is_about(cls, plant: Plant) -> bool:
        """Whether what is declared is of its kind."""

    def quantity(self, plant: Plant) -> str:
        """Raises: ValueError where the plant has no such state."""
        return f"{self.head}.{plant.states[number_of(self.state, plant)]}"


class UnderBounded(OfState):
    """Of bounded disturbance and noise."""

    head: ClassVar[str] = "error"
    rung: ClassVar[str] = "peak"
    statement: ClassVar[str] = "The error stays bounded"
    reach: ClassVar[Reach] = "error bound"

    @classmethod
    def is_about(cls, plant: Plant) -> bool:
        return plant.has_only_bounded


class UnderWhite(OfState):
    """Where one of disturbance and noise is white, or both."""

    head: ClassVar[str] = "rms"
    rung: ClassVar[str] = "mean_square"
    statement: ClassVar[str] = "The mean square of the error stays bounded"
    reach: ClassVar[Reach] = "mean square"

    @classmethod
    def is_about(cls, plant: Plant) -> bool:
        return plant.has_white
