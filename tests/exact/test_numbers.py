"""Exact numbers: what was typed is what is held, and printed bounds lie on the stated side."""

from __future__ import annotations

from fractions import Fraction

import pytest
from flint import arb, fmpq
from hypothesis import given
from hypothesis import strategies as st

from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text


@pytest.mark.parametrize(
    "text", ["0.1", "-2e-4", "1/3", "sqrt(2)", "1e6", "123456789e10", "2*pi/3", "0", "-7/8", "1e-30"]
)
def test_text_reads_back_to_the_same_number(text: str) -> None:
    assert Exact(str(Exact(text))) == Exact(text)


@given(st.fractions())
def test_every_rational_reads_back(value: Fraction) -> None:
    assert Exact(str(Exact(value))).rational == value


def test_signs() -> None:
    assert [Exact(text).sign() for text in ("0", "-1e-300", "sqrt(2)", "1 - sqrt(2)")] == [0, -1, 1, -1]


def test_a_scalar_is_the_rational_or_a_ball_round_the_number() -> None:
    assert Exact("1/3").scalar == fmpq(1, 3)
    root = Exact("sqrt(2)").scalar
    assert isinstance(root, arb) and root * root - 2 < arb("1e-30") and (root * root).contains(2)


def test_a_number_has_no_variables() -> None:
    with pytest.raises(ExpressionError):
        Exact("x")


@given(st.floats(allow_nan=False, allow_infinity=False), st.integers(2, 17))
def test_bounds_are_rounded_to_the_safe_side(value: float, digits: int) -> None:
    ball = arb(value)
    assert Fraction(lower_text(ball, digits)) <= Fraction(value) <= Fraction(upper_text(ball, digits))


def test_unbounded_ends_are_words() -> None:
    assert upper_text(arb("inf")) == "inf"
    assert lower_text(arb("-inf")) == "-inf"


def test_rounding_to_short_decimals() -> None:
    assert decimal_text(1.83614999, 5) == "1.8361"
    assert ExactMatrix.from_floats([[1 / 3], [-2e-7 / 3]], 4).texts() == [["0.3333"], ["-6.667e-8"]]


def test_matrix_views() -> None:
    matrix = ExactMatrix([["0.1", "sqrt(2)"], [1, "-1/3"]])
    assert not matrix.balls().is_rational
    assert ExactMatrix([["0.1", 1]]).balls().is_rational
    assert matrix.floats[0, 1] == pytest.approx(2**0.5)
    with pytest.raises(ValueError, match="read-only"):
        matrix.floats[0, 0] = 1
    with pytest.raises(ValueError, match="one length"):
        ExactMatrix([[1, 2], [3]])
