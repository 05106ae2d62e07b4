"""How large an error can become on the way: level sets of a clock-dependent function.

V = e'P(tau)e never rises, so  e_j(t)^2 <= (P(tau)^-1)_jj V  for all t after the first sample, with V what it is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from itertools import product
from typing import Any

from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.certify.bernstein import elevation
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box

_ELEVATIONS = (0, 6, 18, 40)
MAX_VERTICES = 2**12


@dataclass(frozen=True)
class Level:
    """V just after the first sample is e_0'M e_0 for an error e_0 before it; afterwards e_j^2 <= reach[j] V.

    M: shape (n, n). reach: n upper ends.
    """

    M: Matrix
    reach: tuple[arb, ...]

    def largest(self, start: Box) -> arb:
        """The largest V over a box of e_0: a convex function, at a vertex. Infinite where there are too many."""
        ends = [(low.ball(), high.ball()) for low, high in zip(start.lower, start.upper, strict=True)]
        if 2 ** len(ends) > MAX_VERTICES:
            return arb.pos_inf()
        vertices = (Matrix.from_rows([[value] for value in vertex]) for vertex in product(*ends))
        return _largest(arb((e.T @ self.M @ e)[0, 0]) for e in vertices)

    def bounds(self, start: Box) -> tuple[arb, ...]:
        """Upper ends of |e_j(t)|, for all t after the first sample, from any error of the box before it."""
        V = self.largest(start)
        return tuple((reach * V).sqrt().upper() if V.is_finite() else arb.pos_inf() for reach in self.reach)


def clock_level(inclusion: HybridInclusion, certificate: Certificate) -> Level | None:
    """The level sets of a clock certificate that is proved again; None where it is not, or shows none.

    Elements beyond the n states of the plant (held errors) are 0 just after a sample, or reset by its jump.
    """
    if certificate.method != clock.METHOD or not clock.prove(inclusion, certificate).proved:
        return None
    n, data = inclusion.plant.n, certificate.data
    S = Matrix.from_rows([[Fraction(text) for text in row] for row in data["basis"]])
    back, jump = S.inverse(), inclusion.balls.jump
    P = [clock.symmetric_from_upper(rows) for rows in data["P"]]
    J = jump[:, :n]
    reach: list[arb] | None = None
    degree = int(data["degree"])
    for start in range(0, len(P) - degree, degree):
        piece = _reach(P[start : start + degree + 1], S, n)
        if piece is None:
            return None
        reach = piece if reach is None else [a.max(b) for a, b in zip(reach, piece, strict=True)]
    return None if reach is None else Level(J.T @ back.T @ P[0] @ back @ J, tuple(reach))


def constant_level(P: ExactMatrix) -> Level:
    """The level sets of a function that is e'Pe at samples and never below it: P > 0, shape (n, n)."""
    exact = P.balls()
    inverse = exact.inverse()
    return Level(exact, tuple(arb(inverse[j, j]).upper() for j in range(exact.shape[0])))


def _reach(coefficients: Sequence[Matrix], S: Matrix, n: int) -> list[arb] | None:
    """Upper ends of (P(tau)^-1)_jj on one piece, in the states: a convex function of P, so at most its largest value
    over coefficients that are definite; None where no elevation tried makes them so."""
    for more in _ELEVATIONS:
        elevated = list(_elevated(coefficients, more))
        if all(has_positive_pivots(P.balls()) for P in elevated):
            covariances = [S @ P.inverse() @ S.T for P in elevated]
            return [_largest(arb(covariance[j, j]) for covariance in covariances) for j in range(n)]
    return None


def _largest(values: Iterator[arb]) -> arb:
    return reduce(lambda a, b: a.max(b), values).upper()


def _elevated(coefficients: Sequence[Matrix], more: int) -> Iterator[Matrix]:
    degree = len(coefficients) - 1
    for weights in elevation(degree, degree + more):
        total: Any = coefficients[0] * 0
        for weight, coefficient in zip(weights, coefficients, strict=True):
            total = total + coefficient * weight
        yield total
