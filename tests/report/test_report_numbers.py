"""Numbers for people: shortened, and never to the unsafe side."""

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cdobs_cli.certificate import Bound
from cdobs_cli.chart import Table
from cdobs_cli.report.numbers import bracket_text, end_text, ends_text, implicit_sentence, margin_text, number_text
from cdobs_cli.report.sections import _table


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.123456789, "0.12346"), (12345678.0, "1.2346e7"), (1e-9, "1e-9"), (0.0, "0"), (3, "3"), (None, "–"),
     ("word", "word"), (float("inf"), "∞"), (float("nan"), "not a number"), (-2.5, "-2.5")],
)  # fmt: skip
def test_number_text(value: float | int | str | None, text: str) -> None:
    assert number_text(value) == text


def test_ends_are_rounded_to_the_safe_side() -> None:
    assert ends_text(Bound("1.71304318276", "1.71309999999")) == ("1.713043", "1.7131")
    assert ends_text(Bound("0.66815999", "inf")) == ("0.668159", "∞")
    assert ends_text(Bound(None, "2.00000001")) == ("–", "2.00001")


def test_a_bound_where_less_is_better_is_rounded_the_other_way() -> None:
    assert ends_text(Bound("3.80000001", "3.1234567", "1", better="less")) == ("3.80001", "3.12345")


def test_a_single_end_goes_to_its_safe_side_too() -> None:
    assert ends_text(Bound("4.7095651535", None, "1", better="less")) == ("4.70957", "–")
    assert ends_text(Bound(None, "4.7095651535", "1", better="less")) == ("–", "4.70956")


def test_a_bound_in_a_table_is_rounded_like_everywhere() -> None:
    table = Table("periods", "", "", ("method", "proved", "refuted"), (("clock", Bound("1.03119", "1.0311948")),))
    assert _table(table).rows == (("clock", "1.03119", "1.0311948"),)


def test_a_narrow_bracket_keeps_its_two_ends_apart() -> None:
    assert bracket_text(Bound("1.57079632679", "1.57079632680", "s")) == "[1.57079632679, 1.5707963268] s"


def test_margins_are_rounded_down() -> None:
    assert margin_text("0.0312999") == "0.03129"
    assert margin_text("-0.00012341") == "-0.0001235"
    assert margin_text(None) == "–"


@given(st.decimals(min_value=Decimal("1e-12"), max_value=Decimal("1e12"), places=20), st.integers(1, 12))
def test_shortened_ends_stay_on_their_side(value: Decimal, digits: int) -> None:
    text = str(value)
    assert Decimal(end_text(text, digits, up=False)) <= value <= Decimal(end_text(text, digits, up=True))


@pytest.mark.parametrize(
    ("implicit", "runs", "start"), [(1, 1, "the run is"), (1, 5, "1 of 5 runs is"), (2, 5, "2 of 5 runs are")]
)
def test_runs_of_the_implicit_method_are_counted(implicit: int, runs: int, start: str) -> None:
    assert implicit_sentence(implicit, runs).startswith(f"{start} stiff and w")
