"""Functions of u in [0, 1] as polynomials with what is left out enclosed.

A Taylor holds f(u) = c_0 + c_1 u + .. + c_K u^K with balls c_k. Terms beyond K are kept as balls in c_1: there
u^k = u theta with theta in [0, 1]. So c_0 stays f(0), and (f(u) - f(0)) / u is as well known as f.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import comb
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

    def coefficient(self, k: int) -> arb:
        """c_k."""
        return arb(self.polynomial[k])


def exponential(Y: Matrix, F: Matrix, X: Matrix, a: Fraction, b: Fraction) -> list[list[Taylor]] | None:
    """Y exp(F (a + (b - a) u)) X, entry by entry; None where b - a is too long for the series.

    exp(F a) exp(h u) with h = F (b - a): the terms h^k u^k / k! up to k = ORDER, and a rest of norm at most
    |h|^(K+1) / (K+1)! / (1 - |h| / (K+2)) times u^(K+1).
    """
    h = F.balls() * fraction_ball(b - a)
    size = frobenius(h).upper()
    if not size < 2:
        return None
    start = F.exp(a)
    term = start @ X
    left = Y.balls()
    terms = [left @ term]
    for k in range(1, ORDER + 1):
        term = h @ term / k
        terms.append(left @ term)
    rest = size ** (ORDER + 1) / arb(ORDER + 1).gamma() / (ORDER + 1) / (1 - size / (ORDER + 2))
    bound = (rest * frobenius(start @ X) * frobenius(left)).upper()
    beyond = arb(0, bound)
    rows = [matrix.arb.table() for matrix in terms]
    height, width = terms[0].shape
    return [
        [
            Taylor(arb_poly([rows[0][i][j], rows[1][i][j] + beyond, *(rows[k][i][j] for k in range(2, ORDER + 1))]))
            for j in range(width)
        ]
        for i in range(height)
    ]  # fmt: skip


@cache
def bernstein_weights(degree: int) -> tuple[tuple[arb, ...], ...]:
    """(j, k): C(j, k) / C(degree, k), the weight of c_k in Bernstein coefficient j."""
    return tuple(
        tuple(fraction_ball(Fraction(comb(j, k), comb(degree, k))) for k in range(j + 1)) for j in range(degree + 1)
    )  # fmt: skip
