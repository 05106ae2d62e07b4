"""Homogeneous polynomials of degree d in z as a vector of their own.

With z^[d] the vector of all monomials of degree d, z+ = M z gives (z+)^[d] = M^[d] z^[d]: a quadratic function of
z^[d] is a form of degree 2 d in z. The entries of M^[d] are polynomials in those of M, so they are written once
for rationals, balls, polynomials and arrays.

Source: P. A. Parrilo, A. Jadbabaie, Approximation of the joint spectral radius using sum of squares, 2008
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from math import comb
from typing import Any

Monomial = tuple[int, ...]


def dimension(r: int, d: int) -> int:
    """Number of monomials of degree d in r variables."""
    return comb(r + d - 1, d)


def monomials(r: int, d: int, first: int = 0) -> list[Monomial]:
    """Each monomial as the sorted list of its variables, (0, 0, 1) is z_0^2 z_1; those in the first `first`
    variables only come first."""
    names = list(combinations_with_replacement(range(r), d))
    return sorted(names, key=lambda name: (name[-1] >= first, name))


def power(entries: Sequence[Sequence[Any]], d: int, first: int = 0) -> list[list[Any]]:
    """Rows of M^[d], the monomials in the order of `monomials`: each is the product of its variables' linear forms."""
    r = len(entries)
    names = monomials(r, d, first)
    index = {name: k for k, name in enumerate(names)}
    rows = []
    for name in names:
        form: dict[Monomial, Any] = {(j,): entries[name[0]][j] for j in range(r)}
        for i in name[1:]:
            product: dict[Monomial, Any] = {}
            for monomial, factor in form.items():
                for j in range(r):
                    key = tuple(sorted((*monomial, j)))
                    term = factor * entries[i][j]
                    product[key] = product[key] + term if key in product else term
            form = product
        row: list[Any] = [None] * len(names)
        for monomial, factor in form.items():
            row[index[monomial]] = factor
        rows.append(row)
    return rows
