"""Functions of u in [0, 1] as polynomials with what is left out enclosed.

A Taylor holds f(u) = c_0 + c_1 u + .. + c_K u^K with balls c_k. Terms beyond K are kept as balls in c_1: there
u^k = u theta with theta in [0, 1]. So c_0 stays f(0), and (f(u) - f(0)) / u is as well known as f.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb, factorial
from typing import Any

from flint import arb, arb_poly

from cdobs_cli.certify.ball import frobenius
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix

ORDER = 10
_UNIT = arb(0).union(arb(1))


class Taylor:
    """A polynomial of degree at most ORDER in u with ball coefficients."""

    __slots__ = ("polynomial",)

    def __init__(self, polynomial: Any) -> None:
        self.polynomial = polynomial

    def __add__(self, other: Taylor) -> Taylor:
        return Taylor(self.polynomial + other.polynomial)

    def __sub__(self, other: Taylor) -> Taylor:
        return Taylor(self.polynomial - other.polynomial)

    def __mul__(self, other: Taylor | arb) -> Taylor:
        if isinstance(other, arb):
            return Taylor(self.polynomial * arb_poly([other]))
        product = self.polynomial * other.polynomial
        if product.degree() <= ORDER:
            return Taylor(product)
        coefficients = product.coeffs()
        for beyond in coefficients[ORDER + 1 :]:
            coefficients[1] = coefficients[1] + beyond * _UNIT
        return Taylor(arb_poly(coefficients[: ORDER + 1]))

    def combination(self, weights: tuple[arb, ...]) -> arb:
        """sum_k weights[k] c_k."""
        return sum((weight * c for weight, c in zip(weights, self.polynomial.coeffs(), strict=False)), arb(0))


def exponential(Y: Matrix, F: Matrix, X: Matrix, a: Fraction, b: Fraction) -> list[Matrix] | None:
    """Coefficients c_0 .. c_K of Y exp(F (a + (b - a) u)) X, matrices of balls; None where b - a is too long.

    exp(F a) exp(h u) with h = F (b - a): the terms h^k u^k / k! up to k = K = ORDER, and a rest of norm at most
    |h|^(K+1) / (K+1)! / (1 - |h| / (K+2)) times u^(K+1), kept in c_1.
    """
    h = F.balls() * fraction_ball(b - a)
    size = frobenius(h).upper()
    if not size < 2:
        return None
    start = F.exp(a) @ X
    left, term = Y.balls(), start
    terms = [left @ term]
    for k in range(1, ORDER + 1):
        term = h @ term / k
        terms.append(left @ term)
    rest = size ** (ORDER + 1) / arb(factorial(ORDER + 1)) / (1 - size / (ORDER + 2))
    beyond = arb(0, (rest * frobenius(start) * frobenius(left)).upper())
    height, width = terms[0].shape
    terms[1] = terms[1] + Matrix.from_rows([[beyond] * width for _ in range(height)])
    return terms


def entries(coefficients: list[Matrix]) -> list[list[Taylor]]:
    """The matrix polynomial entry by entry."""
    tables = [matrix.arb.table() for matrix in coefficients]
    height, width = coefficients[0].shape
    return [[Taylor(arb_poly([table[i][j] for table in tables])) for j in range(width)] for i in range(height)]


@cache
def bernstein_weights(degree: int) -> tuple[tuple[arb, ...], ...]:
    """(j, k): C(j, k) / C(degree, k), the weight of c_k in Bernstein coefficient j."""
    return tuple(
        tuple(fraction_ball(Fraction(comb(j, k), comb(degree, k))) for k in range(j + 1)) for j in range(degree + 1)
    )  # fmt: skip
