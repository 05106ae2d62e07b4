"""The floor of a carried Pi, proved in balls from the law as it runs and the plant as typed.

At a sample Pi+ >= F + C'Lambda C. Up to T_min Pi(t; c) >= Pi(t; cbar), the solution from F + C'Lambda C at the largest
slopes: B, Q and r rise with c, whatever c does, and Riccati equations are ordered by them. If Pi(t; cbar) >= zeta F
on [0, T_min], and Pi - F > 0 with det(Pi - F) > epsilon det F at T_min, then Pi >= zeta F there, the next sample is
not due yet, and until it is Pi - F keeps its sign. At the sample Pi >= F, and so on: no sample comes before T_min.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from math import inf, log2

from flint import arb, fmpq

from cdobs_cli.certify.ball import determinant as ball_determinant
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.taylor import exponential
from cdobs_cli.exact.matrix import Matrix, symmetric
from cdobs_cli.families.updated_sampling.carried.law import Law, after_sample, hamiltonian, strengths
from cdobs_cli.plant import Entry, Plant

SHARES = tuple(Fraction(text) for text in ("0.99", "0.95", "0.9", "0.8", "0.6", "0.4", "0.2", "0.1", "0.02"))
_PIECES = 16
_DEPTH = 6
_UNIT = arb(0).union(arb(1))


@dataclass(frozen=True)
class Floor:
    """What was proved of a law. fits: shapes and signs are right; positive: F > 0; share: zeta with Pi >= zeta F at
    all times, None where none was; kept: Pi - F > 0, and det(Pi - F) > epsilon det F, at T_min."""

    fits: bool
    positive: bool = False
    share: Fraction | None = None
    kept: bool = False

    @property
    def holds(self) -> bool:
        return self.fits and self.positive and self.kept and self.share is not None


def floor(plant: Plant, law: Law, largest: Mapping[Entry, Fraction]) -> Floor:
    """What holds for every c(t) with c_ij <= cbar_ij, jumps of c included."""
    if not law.fits(plant.n, plant.p, tuple(largest)):
        return Floor(False)
    F = law.F.balls()
    if not has_positive_pivots(F):
        return Floor(True)
    first = Matrix.from_rows(after_sample(F.tolist(), plant.C.balls().tolist(), _weights(law)))
    to, back = _scales(F)
    H = _hamiltonian(plant, law, largest)
    n, whole = plant.n, _stacked_diagonal(to, back)
    H = whole @ H @ whole.inverse()
    F, first = back @ F @ back, back @ first @ back
    start = _stacked(Matrix.identity(n), first)
    T = law.T_min.rational or Fraction(0)
    kept = _is_kept(n, _at(H, start, T), F, law)
    share = next((one for one in SHARES if _stays(H, start, F * one, Fraction(0), T)), None) if kept else None
    return Floor(True, True, share, kept)


def _scales(F: Matrix) -> tuple[Matrix, Matrix]:
    """S and S^-1, powers of 2 near sqrt(F_ii): S^-1 Pi S^-1 has entries around 1, which keeps the balls narrow."""
    sizes = [float(arb(F[i, i]).mid()) for i in range(F.shape[0])]
    powers = [round(log2(size) / 2) if 0 < size < inf else 0 for size in sizes]
    to = [fmpq(2) ** power for power in powers]
    return Matrix.diagonal(to), Matrix.diagonal([1 / one for one in to])


def _stacked_diagonal(top: Matrix, low: Matrix) -> Matrix:
    n = top.shape[0]
    entries = [one[i, i] for one in (top, low) for i in range(n)]
    return Matrix.diagonal(entries)


def _weights(law: Law) -> list[fmpq]:
    return [one.scalar for one in law.Lambda.rows[0]]


def _hamiltonian(plant: Plant, law: Law, largest: Mapping[Entry, Fraction]) -> Matrix:
    """That of the largest slopes: q_ij = 1, r = 1."""
    bounds = {entry: fmpq(bound.numerator, bound.denominator) for entry, bound in largest.items()}
    cl = {entry: bound * law.split[entry].scalar for entry, bound in bounds.items()}
    c_over_l = {entry: bound / law.split[entry].scalar for entry, bound in bounds.items()}
    B, Q = strengths(plant.n, cl, c_over_l, [one.scalar for one in law.gamma.rows[0]], fmpq(0))
    return Matrix.from_rows(hamiltonian(plant.A.balls().tolist(), B, Q, law.sigma.scalar, fmpq(0)))


def _stacked(top: Matrix, low: Matrix) -> Matrix:
    return Matrix.from_rows([*top.tolist(), *low.tolist()])


def _at(H: Matrix, start: Matrix, t: Fraction) -> Matrix:
    """(X; Y) at t."""
    return H.exp(t) @ start.balls()


def _above(Z: Matrix, G: Matrix) -> Matrix:
    """X'(Y - G X): it is definite where Pi - G is."""
    n = G.shape[0]
    X, Y = Z[:n, :], Z[n:, :]
    return symmetric(X.T @ (Y - G.balls() @ X)) / 2  # type: ignore[no-any-return]


def _is_kept(n: int, Z: Matrix, F: Matrix, law: Law) -> bool:
    """Pi - F > 0 and det(Pi - F) > epsilon det F: det(X'(Y - F X)) > epsilon det F det(X)^2."""
    over = _above(Z, F)
    if not has_positive_pivots(over):
        return False
    least = arb(law.epsilon.scalar) * arb(ball_determinant(F)) * arb(ball_determinant(Z[:n, :])) ** 2
    return bool(arb(ball_determinant(over)) > least)


def _stays(H: Matrix, start: Matrix, G: Matrix, a: Fraction, b: Fraction) -> bool:
    """Whether Pi(t) > G on all of [a, b], piece by piece. X stays regular then: X v = 0 would make the form 0."""
    pieces = [(a + (b - a) * k / _PIECES, a + (b - a) * (k + 1) / _PIECES) for k in range(_PIECES)]
    return all(_holds_on(H, start, G, low, high, _DEPTH) for low, high in pieces)


def _holds_on(H: Matrix, start: Matrix, G: Matrix, a: Fraction, b: Fraction, depth: int) -> bool:
    terms = exponential(Matrix.identity(H.shape[0]), H, start, a, b)
    if terms is not None and has_positive_pivots(_form_over(terms, G)):
        return True
    if depth == 0:
        return False
    middle = (a + b) / 2
    return all(_holds_on(H, start, G, low, high, depth - 1) for low, high in ((a, middle), (middle, b)))


def _form_over(terms: Sequence[Matrix], G: Matrix) -> Matrix:
    """X'(Y - G X) over a piece: the products of its coefficients, summed with u in [0, 1]."""
    n = G.shape[0]
    X, D = [Z[:n, :] for Z in terms], [Z[n:, :] - G.balls() @ Z[:n, :] for Z in terms]
    total = symmetric(X[0].T @ D[0])
    for degree in range(1, 2 * len(terms) - 1):
        pairs = ((k, degree - k) for k in range(len(terms)) if 0 <= degree - k < len(terms))
        term = reduce(lambda one, other: one + other, (X[i].T @ D[j] for i, j in pairs))
        total = total + symmetric(term) * _UNIT**degree
    return total  # type: ignore[no-any-return]
