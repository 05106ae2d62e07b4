"""The gain of a flow, as a held innovation's, for which the clock certificate reaches furthest: an ascent of where its
margin ends, shape by shape. Floats and the solver: nothing is proved here.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.ascent import Ascent, Height
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import shapes
from cdobs_cli.certify.methods.clock.edges import at_period, at_rate, height_in_period, height_in_rate
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.exact.numbers import ExactMatrix

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 12
_WIDTH = 3e-4  # a rise of the end, relative, that is too small to go on for


def longest(
    question: Question, letter: str, start: Array, unit: Array, steps: int, share: float, goal: float = inf
) -> tuple[Array, float] | None:
    """The gain met of the longest period, and about its end, from a gain and the question's period.

    Args:
        unit: sizes of the gain's entries that count as alike, as the gain.
        steps: programs of the first shape that gives an ascent, half as many of each that follows.
        share: the rate is at least this over the period; goal: a period that is enough.
    """

    def height(shape: Shape) -> Callable[[Array, float], Height | None]:
        def at(gain: Array, T: float) -> Height | None:
            about = _with(question, letter, gain, start.shape)
            if not (about.law.is_periodic or float(about.law.T_min) < T):
                return None
            return height_in_period(at_period(about, T, share), shape, share, letter)

        return at

    return _climbed(question, height, start, unit, steps, float(question.law.T_max), goal)


def fastest(
    question: Question, letter: str, start: Array, unit: Array, steps: int, sigma: float
) -> tuple[Array, float] | None:
    """The gain met of the largest rate, and about its end, from a gain of about the rate sigma; unit and steps as for
    `longest`."""

    def height(shape: Shape) -> Callable[[Array, float], Height | None]:
        def at(gain: Array, sigma: float) -> Height | None:
            return height_in_rate(at_rate(_with(question, letter, gain, start.shape), sigma), shape, letter)

        return at

    return _climbed(question, height, start, unit, steps, sigma, inf)


def _climbed(
    question: Question,
    height: Callable[[Shape], Callable[[Array, float], Height | None]],
    start: Array,
    unit: Array,
    steps: int,
    value: float,
    goal: float,
) -> tuple[Array, float] | None:
    size = np.abs(start)
    scale = np.maximum(size, 0.05 * unit * (size / unit).max()).reshape(-1)
    best, inverse, left = None, None, steps
    x, v = start.reshape(-1), value
    for shape in shapes(question):
        ascent = Ascent(height(shape), scale, _WIDTH, left, goal, inverse)
        met = ascent.run(x, v)
        if met is None:
            continue
        rise = met[1] / v - 1
        inverse, left = ascent.inverse, steps // 2
        x, v = met
        if best is not None and rise < _WIDTH:
            break
        best = met
    return None if best is None else (x.reshape(start.shape), v)


def _with(question: Question, letter: str, gain: Array, shape: tuple[int, ...]) -> Question:
    return question.with_gain({letter: ExactMatrix.from_floats(gain.reshape(shape), _DIGITS)})
