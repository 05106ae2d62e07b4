"""The gains with K_1 = 1 of a planar plant with a measured first state: the exact limit of the period for all of
them."""

from __future__ import annotations

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.planar.extremals import (
    Planar,
    PlanarClass,
    best_gain,
    cleared_gain,
    last_proved,
    limit_any_gain,
    planar_class,
)
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text

LETTER = "K"
DIGITS = (5, 7, 9, 11)


def open_class(question: Question) -> PlanarClass | None:
    """The planar class of a plant with two states, y = x_1 times a number, x_1' = b x_2 and slopes in the last row,
    under a constant period; None for any other question. The gain of the question is not read."""
    C = question.plant.C
    if not question.law.is_periodic or C.shape != (1, 2) or C[0, 0].sign() in (0, None) or C[0, 1].sign() != 0:
        return None
    planar = planar_class(question.inclusion) if C[0, 0].rational is not None else None
    return None if planar is None else planar[0]


def covers(question: Question, K: ExactMatrix | None) -> bool:
    """Whether the exact limit is known for this gain; for the gains with K_1 = 1 where none is given."""
    if open_class(question) is None:
        return False
    return K is None or cleared_gain(question.with_gain({LETTER: K}).inclusion) is not None


def gain_at(question: Question) -> tuple[ExactMatrix, Planar] | None:
    """The gain in the middle of those that no extremal defeats at the question's period, with its certificate."""
    K_2 = None if open_class(question) is None else best_gain(question.inclusion)
    if K_2 is None:
        return None
    c = question.plant.C[0, 0].rational
    assert c is not None
    for digits in DIGITS:
        K = ExactMatrix([[1 / c], [Exact(decimal_text(K_2 / c, digits))]])
        certificate = Planar.propose(question.with_gain({LETTER: K}))
        if certificate is not None:
            return K, certificate
    return None


def longest_any(question: Question) -> tuple[ExactMatrix, Planar] | None:
    """The largest period at which some gain is proved, and that gain."""
    family = open_class(question)
    if family is None:
        return None
    return last_proved(
        lambda below: limit_any_gain(family, below), lambda T: gain_at(question.at(T)), question.law.T_max
    )
