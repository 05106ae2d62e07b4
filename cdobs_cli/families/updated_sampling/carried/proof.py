"""The floor of a carried Pi, proved in balls from the law as it runs and the plant as typed.

At a sample Pi+ >= F + C'Lambda C, with the Lambda of whichever output is read where one is chosen. Up to T_min
Pi(t; c) >= Pi(t; cbar), the solution from there at the largest slopes: B, Q and r rise with c, whatever c does, and
Riccati equations are ordered by them. If Pi(t; cbar) >= zeta F
on [0, T_min], and Pi - F > 0 with det(Pi - F) > epsilon det F at T_min, then Pi >= zeta F there, the next sample is
not due yet, and until it is Pi - F keeps its sign. At the sample Pi >= F, and so on: no sample comes before T_min.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from math import inf, log2

import numpy as np
from flint import arb, fmpq

from cdobs_cli.certify.ball import determinant as ball_determinant
from cdobs_cli.certify.definite import eigenvalue_range, has_positive_pivots
from cdobs_cli.certify.taylor import exponential
from cdobs_cli.exact.matrix import Matrix, symmetric
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.updated_sampling.carried.law import Law, after_sample, hamiltonian, strengths
from cdobs_cli.plant import Entry, Plant
from cdobs_cli.records import dataclass

SHARES = tuple(Fraction(k, 100) for k in (99, 97, 95, 92, 90, 85, 80, 70, 60, 40, 20, 10, 2))  # of F, before T_min
_PIECES = 16
_DEPTH = 6
_UNIT = arb(0).union(arb(1))
_MIDDLE = arb(1) / 2


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
    flows = _Flow.each(plant, law, largest)
    F = flows[0].scaled(F)
    kept = all(_is_kept(flow.at_end(), F, law) for flow in flows)
    shares = (one for one in SHARES if all(flow.stays_above(_always(F * one)) for flow in flows))
    share = next(shares, None) if kept else None
    return Floor(True, True, share, kept)


def least_eigenvalue(F: Matrix) -> arb:
    """A lower end of that of F > 0, rational: by the largest one of F^-1, which is near in relation to it."""
    largest = arb(eigenvalue_range(F.inverse(), smallest=False).high)
    return arb(fmpq(1)) / largest if largest > 0 else arb(0)


def keeps_inverse(
    plant: Plant, law: Law, largest: Mapping[Entry, Fraction], i: int, limit: Callable[[Fraction], arb]
) -> bool:
    """Whether (Pi(t; cbar)^-1)_ii < limit(t) on [0, T_min], for a limit that does not fall: Pi > e_i e_i' / limit."""
    flows, n = _Flow.each(plant, law, largest), plant.n
    unit = flows[0].scaled(Matrix.diagonal([int(k == i) for k in range(n)]))
    return all(flow.stays_above(lambda t: unit.balls() / limit(t)) for flow in flows)


def _always(G: Matrix) -> Callable[[Fraction], Matrix]:
    return lambda t: G


@dataclass(frozen=True)
class _Flow:
    """(X; Y) from F + C'Lambda C on at the largest slopes, in coordinates S^-1 Pi S^-1 with S near sqrt(F_ii)."""

    H: Matrix
    start: Matrix
    back: Matrix
    T: Fraction

    @staticmethod
    def each(plant: Plant, law: Law, largest: Mapping[Entry, Fraction]) -> list[_Flow]:
        """From what each choice of outputs leaves."""
        return [_Flow.of(plant, law, largest, weights) for weights in law.readings]

    @staticmethod
    def of(plant: Plant, law: Law, largest: Mapping[Entry, Fraction], weights: Sequence[Exact]) -> _Flow:
        F = law.F.balls()
        scalars = [one.scalar for one in weights]
        first = Matrix.from_rows(after_sample(F.tolist(), plant.C.balls().tolist(), scalars))
        to, back = _scales(F)
        whole = _stacked_diagonal(to, back)
        H = whole @ _hamiltonian(plant, law, largest) @ whole.inverse()
        start = _stacked(Matrix.identity(plant.n), back @ first @ back)
        return _Flow(H, start, back, law.T_min.rational or Fraction(0))

    def scaled(self, G: Matrix) -> Matrix:
        return self.back @ G @ self.back

    def at_end(self) -> Matrix:
        """(X; Y) at T_min."""
        return self.H.exp(self.T) @ self.start.balls()

    def stays_above(self, G: Callable[[Fraction], Matrix]) -> bool:
        """Whether Pi(t) > G(a) on each piece [a, b] of [0, T_min], for a G that does not rise. X stays regular then:
        X v = 0 would make the form 0."""
        ends = [self.T * k / _PIECES for k in range(_PIECES + 1)]
        return all(self._holds_on(G, a, b, _DEPTH) for a, b in pairwise(ends))

    def _holds_on(self, G: Callable[[Fraction], Matrix], a: Fraction, b: Fraction, depth: int) -> bool:
        terms = exponential(Matrix.identity(self.H.shape[0]), self.H, self.start, a, b)
        if terms is not None:
            basis = _basis(_form_over(terms, G(a), _MIDDLE))
            if basis is None:
                return False  # not even in the middle, in floats
            if has_positive_pivots(_form_over([Z @ basis for Z in terms], G(a), _UNIT)):
                return True
        if depth == 0:
            return False
        middle = (a + b) / 2
        return all(self._holds_on(G, low, high, depth - 1) for low, high in ((a, middle), (middle, b)))


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


def _hamiltonian(plant: Plant, law: Law, largest: Mapping[Entry, Fraction]) -> Matrix:
    """That of the largest slopes: q_ij = 1, r = 1."""
    bounds = {entry: fmpq(bound.numerator, bound.denominator) for entry, bound in largest.items()}
    cl = {entry: bound * law.split[entry].scalar for entry, bound in bounds.items()}
    c_over_l = {entry: bound / law.split[entry].scalar for entry, bound in bounds.items()}
    B, Q = strengths(plant.n, cl, c_over_l, [one.scalar for one in law.gamma.rows[0]], fmpq(0))
    return Matrix.from_rows(hamiltonian(plant.A.balls().tolist(), B, Q, law.sigma.scalar, fmpq(0)))


def _stacked(top: Matrix, low: Matrix) -> Matrix:
    return Matrix.from_rows([*top.tolist(), *low.tolist()])


def _above(Z: Matrix, G: Matrix) -> Matrix:
    """X'(Y - G X): it is definite where Pi - G is."""
    n = G.shape[0]
    X, Y = Z[:n, :], Z[n:, :]
    return symmetric(X.T @ (Y - G.balls() @ X)) / 2  # type: ignore[no-any-return]


def _is_kept(Z: Matrix, F: Matrix, law: Law) -> bool:
    """Pi - F > 0 and det(Pi - F) > epsilon det F: det(X'(Y - F X)) > epsilon det F det(X)^2."""
    over = _above(Z, F)
    if not has_positive_pivots(over):
        return False
    least = arb(law.epsilon.scalar) * arb(ball_determinant(F)) * arb(ball_determinant(Z[: F.shape[0], :])) ** 2
    return bool(arb(ball_determinant(over)) > least)


def _basis(form: Matrix) -> Matrix | None:
    """S, near which S' form S = I: where Pi is close to G in some direction only, balls stay narrow in it."""
    try:
        return Matrix.from_floats(np.linalg.inv(np.linalg.cholesky(form.floats)).T).balls()
    except (np.linalg.LinAlgError, ValueError, OverflowError):
        return None


def _form_over(terms: Sequence[Matrix], G: Matrix, u: arb) -> Matrix:
    """X'(Y - G X) for u in a ball of [0, 1]: the products of the coefficients, summed."""
    n = G.shape[0]
    X, D = [Z[:n, :] for Z in terms], [Z[n:, :] - G.balls() @ Z[:n, :] for Z in terms]
    total = symmetric(X[0].T @ D[0]) / 2
    for degree in range(1, 2 * len(terms) - 1):
        pairs = ((k, degree - k) for k in range(len(terms)) if 0 <= degree - k < len(terms))
        term = reduce(lambda one, other: one + other, (X[i].T @ D[j] for i, j in pairs))
        total = total + symmetric(term) / 2 * u**degree
    return total  # type: ignore[no-any-return]
