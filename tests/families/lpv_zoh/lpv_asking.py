"""What the tests of this family ask of its methods."""

from __future__ import annotations

from fractions import Fraction

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.plant import Plant

inclusion = LpvZeroOrderHold().inclusion


def asked(plant: Plant, L: ExactMatrix, T: Exact | str | None = None, sigma: str | Fraction = "0") -> Question:
    """The error system of a gain, at the plant's law or its period replaced, and a rate."""
    question = Question(inclusion(plant, {"L": L}), rate=Fraction(sigma))
    return question if T is None else question.at(T if isinstance(T, Exact) else Exact(T))


def of_every_gain(plant: Plant) -> Question:
    """For methods that read no gain."""
    return asked(plant, ExactMatrix([[0] * plant.p for _ in range(plant.n)]))
