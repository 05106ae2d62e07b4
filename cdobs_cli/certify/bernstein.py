"""Bernstein polynomials: degree elevation and derivatives as rational matrices acting on coefficients.

A polynomial of degree d on a piece has coefficients p_0 .. p_d; its values stay in their convex hull, so a
matrix polynomial is negative definite on the piece if every coefficient is.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise

Rows = tuple[tuple[Fraction, ...], ...]


@cache
def elevation(d: int, D: int) -> Rows:
    """(D + 1, d + 1): the same polynomial in degree D >= d."""
    rows = _identity(d + 1)
    for degree in range(d, D):
        step = tuple(
            tuple(
                Fraction(i, degree + 1) if j == i - 1 else 1 - Fraction(i, degree + 1) if j == i else Fraction(0)
                for j in range(degree + 1)
            )
            for i in range(degree + 2)
        )
        rows = _product(step, rows)
    return rows


@cache
def derivative(d: int, D: int) -> Rows:
    """(D + 1, d + 1): the derivative with respect to the piece's own variable in [0, 1], in degree D >= d - 1 >= 0."""
    difference = tuple(tuple(Fraction((j == i + 1) - (j == i)) * d for j in range(d + 1)) for i in range(d))
    return _product(elevation(d - 1, D), difference)


@cache
def restriction(d: int, start: Fraction, end: Fraction) -> Rows:
    """(d + 1, d + 1): the same polynomial's coefficients on the part [start, end] of its piece [0, 1]."""
    return tuple(
        tuple(_blossom(d, column, [start] * (d - k) + [end] * k) for column in range(d + 1)) for k in range(d + 1)
    )


def _blossom(d: int, column: int, arguments: list[Fraction]) -> Fraction:
    """De Casteljau's scheme on the coefficients of one Bernstein polynomial, an argument a step."""
    values = [Fraction(j == column) for j in range(d + 1)]
    for t in arguments:
        values = [(1 - t) * left + t * right for left, right in pairwise(values)]
    return values[0]


def _identity(size: int) -> Rows:
    return tuple(tuple(Fraction(i == j) for j in range(size)) for i in range(size))


def _product(left: Rows, right: Rows) -> Rows:
    columns = tuple(zip(*right, strict=True))
    return tuple(
        tuple(sum((x * y for x, y in zip(row, column, strict=True)), Fraction(0)) for column in columns) for row in left
    )
