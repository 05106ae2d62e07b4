"""Condition (ii) of Theorem 2': the largest growth g over tau in [0, alpha], in floats and as a proof.

Both matrices in it are polynomials of tau, so their Bernstein coefficients over a piece of [0, alpha] bound
them there; pieces are halved until every coefficient is positive definite.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np
from flint import arb_mat, fmpq, fmpq_mat

from cdobs_cli.arrays import Array
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    held,
    is_definite,
    last_row_bound,
    sign_corners,
    theorem_2_prime_ii,
    transported,
)

POINTS = 13
_DEPTH = 12
_BATCH = 256


def clock_points(alpha: float) -> Array:
    """Values of tau in [0, alpha], denser at the ends."""
    points: Array = alpha * (1 - np.cos(np.pi * np.arange(POINTS) / (POINTS - 1))) / 2
    return points


@lru_cache(maxsize=8)
def corner_arrays(n: int) -> Array:
    """`sign_corners` as one array, shape (2^(2n - 1), n, n)."""
    return np.array(list(sign_corners(n)), dtype=float)


def growth_at(P: Array, corners: Array, tau: float) -> Array:
    """lambda_max(P(tau) G + G'P(tau), P(tau)) for each corner G, shape (corners,)."""
    T = transported(Chain.floats(len(P)), corners, tau)
    inverse = np.linalg.inv(np.linalg.cholesky(P))
    S = P @ T
    values: Array = np.linalg.eigvalsh(inverse @ (S + np.swapaxes(S, -1, -2)) @ inverse.T)[:, -1]
    return values


def largest_growth(P: Array, alpha: float, variant: str) -> float:
    """g of (ii) at the points of `clock_points`: a guess, which `proves_ii` confirms with a little room."""
    n = len(P)
    if variant == "triangular":
        corners = corner_arrays(n)
        return max(float(growth_at(P, corners, tau).max()) for tau in clock_points(alpha))
    return max(last_row_growth(held(Chain.floats(n), P, tau))[0] for tau in clock_points(alpha))


def last_row_growth(P_tau: Array) -> tuple[float, float]:
    """(g, mu): the least over mu > 0 of lambda_max(P(tau) e_n e_n' P(tau) / mu + mu I, P(tau)), convex in mu."""
    inverse = np.linalg.inv(np.linalg.cholesky(P_tau))
    column = inverse @ P_tau[:, [-1]]
    outer, ball = column @ column.T, inverse @ inverse.T

    middle = np.log(np.linalg.norm(column) / np.sqrt(np.linalg.norm(ball, 2)))
    low, high = middle - 6.0, middle + 6.0
    while high - low > 1e-7:
        mu = float(np.exp((low + high) / 2))
        v = np.linalg.eigh(outer / mu + ball * mu)[1][:, -1]
        # A subgradient along log mu says on which side the least value is.
        low, high = (low, np.log(mu)) if v @ ball @ v * mu > v @ outer @ v / mu else (np.log(mu), high)
    mu = float(np.exp((low + high) / 2))
    return float(np.linalg.eigvalsh(outer / mu + ball * mu)[-1]), mu


@lru_cache(maxsize=16)
def _to_bernstein(degree: int) -> tuple[tuple[fmpq, ...], ...]:
    """The map from values at k / degree to Bernstein coefficients on [0, 1], exact."""
    d, size = degree, degree + 1
    entries = [fmpq(comb(d, i) * k**i * (d - k) ** (d - i), d**d) for k in range(size) for i in range(size)]
    return tuple(map(tuple, fmpq_mat(size, size, entries).inv().tolist()))


def _coefficients(values: list[Matrix]) -> list[Matrix]:
    """Bernstein coefficients of a matrix polynomial from its values at equidistant points."""
    zero, rows = Matrix.zeros(*values[0].shape), _to_bernstein(len(values) - 1)
    return [sum((value * weight for weight, value in zip(row, values, strict=True)), zero) for row in rows]


def _halves(coefficients: list[Matrix]) -> tuple[list[Matrix], list[Matrix]]:
    """de Casteljau at the middle."""
    left, right, row = [coefficients[0]], [coefficients[-1]], coefficients
    while len(row) > 1:
        row = [(a + b) / 2 for a, b in pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


def _positive_on(coefficients: list[Matrix], depth: int = _DEPTH) -> bool:
    if is_definite(*coefficients):
        return True
    if depth == 0 or not is_definite(coefficients[0], coefficients[-1]):
        return False
    return all(_positive_on(half, depth - 1) for half in _halves(coefficients))


def _nodes(alpha: Any, n: int) -> list[Any]:
    degree = 2 * (n - 1)
    return [alpha * k / max(degree, 1) for k in range(degree + 1)]


def proves_ii(P: Matrix, alpha: Any, g: Any, variant: str) -> bool:
    """Whether (ii) is proved for this g, for every tau in [0, alpha] and every slope of the class.

    Args:
        P: (n, n), rational or balls; alpha, g: fmpq or arb.
    """
    n = P.shape[0]
    chain = Chain.exact(n)
    if variant != "triangular":
        return _last_row_on(chain, _coefficients([held(chain, P, tau) for tau in _nodes(alpha, n)]), g)
    return all(_positive_on(coefficients) for coefficients in _corner_coefficients(chain, P, alpha, g))


def _corner_coefficients(chain: Chain[Matrix], P: Matrix, alpha: Any, g: Any) -> Iterator[list[Matrix]]:
    """Bernstein coefficients of (ii) on [0, alpha] for each corner: g P plus the sum of G_ij times those of the
    unit slopes, for many corners in one product."""
    n = chain.n
    entries = [(i, j) for i in range(n) for j in range(i + 1)]
    nodes = _nodes(alpha, n)
    responses = []
    for i, j in entries:
        unit = Matrix.from_rows([[int((a, b) == (i, j)) for b in range(n)] for a in range(n)])
        at_nodes = [theorem_2_prime_ii(P, transported(chain, unit, tau), 0) for tau in nodes]
        responses.append([value for one in _coefficients(at_nodes) for row in one.balls().tolist() for value in row])
    size = n * n
    linear = arb_mat(len(responses[0]), len(entries), [value for row in zip(*responses, strict=True) for value in row])
    constant = (P * g).arb
    corners = list(sign_corners(n))
    for start in range(0, len(corners), _BATCH):
        chosen = corners[start : start + _BATCH]
        signs = arb_mat(len(entries), len(chosen), [G[i][j] for i, j in entries for G in chosen])
        for column in (linear * signs).transpose().tolist():
            yield [Matrix(constant + arb_mat(n, n, column[k * size : (k + 1) * size])) for k in range(len(nodes))]


def _last_row_on(chain: Chain[Matrix], coefficients: list[Matrix], g: Any, depth: int = _DEPTH) -> bool:
    """(ii) for the last row on one piece, with the mu that is best in its middle."""
    left, right = _halves(coefficients)
    mu = Fraction(last_row_growth(left[-1].floats)[1]).limit_denominator(10**6)
    unit, one = chain.identity[:, chain.n - 1], Matrix.identity(1)
    if mu > 0 and is_definite(*(last_row_bound(P, unit, chain.identity, g, mu, one) for P in coefficients)):
        return True
    return depth > 0 and _last_row_on(chain, left, g, depth - 1) and _last_row_on(chain, right, g, depth - 1)
