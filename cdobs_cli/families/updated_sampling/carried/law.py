"""The law of a carried certificate: its constants, and the Riccati equation in any arithmetic.

    Pi' = -Pi A - A'Pi - Pi B Pi - Q - 2 sigma r Pi,
    B = diag_i(sum_j c_ij l_ij + gamma_i),  Q = diag_j(sum_i c_ij / l_ij)

With q_ij = c_ij / cbar_ij in [0, 1]: c_ij l_ij = cbar_ij l_ij(cbar) q^(1 - theta), c_ij / l_ij = cbar_ij / l_ij(cbar)
q^(1 + theta), and r = max(idle, sqrt(q)) in (0, 1]. All of B, Q and r rise with c.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import combinations
from typing import Any

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Entry
from cdobs_cli.records import dataclass

LAW = "law"  # the entry of a design's `details`
MATRICES = ("F", "split", "Lambda", "gamma")
NUMBERS = ("sigma", "theta", "idle", "T_min", "epsilon")
CHOICES = ("reset", "one")
Table = list[list[Any]]


@dataclass(frozen=True)
class Law:
    """What the observer runs by.

    F (n, n): Pi >= F at every sample. split (n, n): l of each slope, at the largest c. Lambda (1, p): the weight of
    each output. gamma (1, n): of each disturbance. sigma: the rate of decay at the largest c, 1 / time; theta, idle:
    how l and r follow c. T_min: no sample comes sooner. epsilon: a sample is due when det(Pi - F) <= epsilon det F.
    kappa: or when the integral of r since the last one reaches it; None: only then. reset: Pi+ = F + C'Lambda C.
    one: at a sample one output is read, which of them Pi says; Lambda has its weight alone then.
    """

    F: ExactMatrix
    split: ExactMatrix
    Lambda: ExactMatrix
    gamma: ExactMatrix
    sigma: Exact
    theta: Exact
    idle: Exact
    T_min: Exact
    epsilon: Exact
    kappa: Exact | None
    reset: bool
    one: bool

    def document(self) -> dict[str, Any]:
        """As a design keeps it."""
        told: dict[str, Any] = {name: getattr(self, name).texts() for name in MATRICES}
        told |= {name: str(getattr(self, name)) for name in NUMBERS}
        return told | {"kappa": None if self.kappa is None else str(self.kappa), "reset": self.reset, "one": self.one}

    @staticmethod
    def read(document: Mapping[str, Any]) -> Law:
        """Raises: KeyError, TypeError, ValueError, ExpressionError on anything `document` did not write."""
        known = {*MATRICES, *NUMBERS, "kappa", *CHOICES}
        if set(document) != known or not all(isinstance(document[name], bool) for name in CHOICES):
            raise ValueError("no law of a carried certificate")
        kappa = document["kappa"]
        parts: dict[str, Any] = {name: ExactMatrix.from_document(document[name]) for name in MATRICES}
        parts |= {name: Exact(document[name]) for name in NUMBERS}
        return Law(**parts, kappa=None if kappa is None else Exact(kappa), reset=document["reset"], one=document["one"])

    def fits(self, n: int, p: int, entries: Sequence[Entry]) -> bool:
        """Whether shapes and signs are what the proof takes for granted: F symmetric, l > 0 at the slopes, Lambda > 0,
        gamma >= 0, sigma > 0, 0 <= theta < 1, 0 < idle <= 1, T_min > 0, epsilon > 0, all rational."""
        shapes = (self.F.shape, self.split.shape, self.Lambda.shape, self.gamma.shape)
        if shapes != ((n, n), (n, n), (1, p), (1, n)):
            return False
        every = [one for name in MATRICES for row in getattr(self, name).rows for one in row]
        every += [getattr(self, name) for name in NUMBERS] + ([] if self.kappa is None else [self.kappa])
        if any(one.rational is None for one in every):
            return False
        positive = [self.sigma, self.idle, self.T_min, self.epsilon, *self.Lambda.rows[0]]
        positive += [self.split[i, j] for i, j in entries] + ([] if self.kappa is None else [self.kappa])
        one = Exact(1)
        return (
            all(self.F[i, j] == self.F[j, i] for i in range(n) for j in range(i))
            and all(value.sign() == 1 for value in positive)
            and all(value.sign() in (0, 1) for value in (self.theta, *self.gamma.rows[0]))
            and (self.theta - one).sign() == -1
            and self.idle.is_at_most(one)
        )

    @property
    def readings(self) -> tuple[tuple[Exact, ...], ...]:
        """The weights of the outputs at a sample, of each choice that there is."""
        weights = self.Lambda.rows[0]
        if not self.one:
            return (tuple(weights),)
        zero = Exact(0)
        return tuple(tuple(one if k == chosen else zero for k, one in enumerate(weights))
                     for chosen in range(len(weights)))  # fmt: skip

    @property
    def exponents(self) -> tuple[Fraction, Fraction]:
        """1 - theta and 1 + theta, of c in c l and in c / l."""
        theta = self.theta.rational or Fraction(0)
        return 1 - theta, 1 + theta


def strengths(
    n: int, cl: Mapping[Entry, Any], c_over_l: Mapping[Entry, Any], gamma: Sequence[Any], zero: Any
) -> tuple[list[Any], list[Any]]:
    """The diagonals of B and Q, from c_ij l_ij and c_ij / l_ij of each slope."""
    B, Q = [zero + one for one in gamma], [zero] * n
    for (i, j), value in cl.items():
        B[i] = B[i] + value
        Q[j] = Q[j] + c_over_l[i, j]
    return B, Q


def riccati(Pi: Table, A: Table, B: Sequence[Any], Q: Sequence[Any], two_sigma: Any) -> Table:
    """-Pi A - A'Pi - Pi B Pi - Q - 2 sigma Pi, entry by entry."""
    n = len(Pi)

    def entry(i: int, j: int) -> Any:
        flows = [Pi[i][k] * A[k][j] + A[k][i] * Pi[k][j] + Pi[i][k] * B[k] * Pi[k][j] for k in range(n)]
        total = sum(flows[1:], flows[0]) + two_sigma * Pi[i][j]
        return -(total + Q[i]) if i == j else -total

    return [[entry(i, j) for j in range(n)] for i in range(n)]


def hamiltonian(A: Table, B: Sequence[Any], Q: Sequence[Any], sigma: Any, zero: Any) -> Table:
    """[[A + sigma I, B], [-Q, -(A + sigma I)']]: Pi = Y X^-1 solves `riccati` where (X; Y)' is this times (X; Y)."""
    n = len(A)
    shifted = [[A[i][j] + (sigma if i == j else zero) for j in range(n)] for i in range(n)]
    top = [[*shifted[i], *(B[i] if i == j else zero for j in range(n))] for i in range(n)]
    low = [[*(-Q[i] if i == j else zero for j in range(n)), *(-shifted[j][i] for j in range(n))] for i in range(n)]
    return top + low


def after_sample(Pi: Table, C: Table, weights: Sequence[Any]) -> Table:
    """Pi + C'Lambda C."""
    n = len(Pi)

    def entry(i: int, j: int) -> Any:
        total = Pi[i][j]
        for row, weight in zip(C, weights, strict=True):
            total = total + row[i] * weight * row[j]
        return total

    return [[entry(i, j) for j in range(n)] for i in range(n)]


def determinant(M: Table) -> Any:
    """By minors of the first rows, each of them once: polynomial, so that it goes through 0 as it should."""
    known: dict[tuple[int, ...], Any] = {(j,): M[0][j] for j in range(len(M))}
    for i in range(1, len(M)):
        known = dict(_minors(known, M[i]))
    return known[tuple(range(len(M)))]


def _minors(known: Mapping[tuple[int, ...], Any], row: Sequence[Any]) -> Iterator[tuple[tuple[int, ...], Any]]:
    """Those of one more row, by columns, from those of the rows before it."""
    size = len(next(iter(known))) + 1
    for columns in combinations(range(len(row)), size):
        total: Any = None
        for position, j in enumerate(columns):
            term = row[j] * known[columns[:position] + columns[position + 1 :]]
            term = -term if (size - 1 - position) % 2 else term
            total = term if total is None else total + term
        yield columns, total


def solve(M: Table, right: Table, divide: Callable[[Any, Any], Any]) -> Table:
    """M^-1 right for M > 0, by elimination without pivoting."""
    rows = [[*row, *extra] for row, extra in zip(M, right, strict=True)]
    n = len(rows)
    for k in range(n):
        for i in range(k + 1, n):
            factor = divide(rows[i][k], rows[k][k])
            rows[i][k + 1 :] = [a - factor * b for a, b in zip(rows[i][k + 1 :], rows[k][k + 1 :], strict=True)]
    for k in reversed(range(n)):
        for j in range(n, len(rows[k])):
            total = rows[k][j]
            for i in range(k + 1, n):
                total = total - rows[k][i] * rows[i][j]
            rows[k][j] = divide(total, rows[k][k])
    return [row[n:] for row in rows]
