"""Units in which the numbers of a search are about 1: time by the fastest rate, errors by what the outputs show of them
within that time against the thresholds, outputs by how far they may leave their predictions."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import fmpq, fmpq_mat

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.on_change.form import deltas, noise_sizes
from cdobs_cli.certify.methods.peak.signals import acting, acting_sizes
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_SMALLEST = 1e-9  # of what the outputs show of a state, against the state that they show most of


@dataclass(frozen=True)
class Scaled:
    """The error e = S z over the time omega t: z' = A z + E w in Co of the corners, |C_i z| <= 1 between messages,
    |w_k| <= 1. S holds powers of 2; h is the time between comparisons, 0 where outputs are compared all the time.

    Shapes: corners (vertices, n, n), C (p, n), E (n, q), S (n,); reach (p,), d0 (q,): the sizes that became 1.
    """

    corners: Array
    C: Array
    E: Array
    S: Array
    omega: float
    h: float
    reach: Array
    d0: Array

    @staticmethod
    def of(question: Question) -> Scaled | None:
        """None where something is beyond floats."""
        inclusion, plant = question.inclusion, question.plant
        view, d = inclusion.view_floats, acting(plant.disturbance)
        flows = np.array(list(inclusion.floats.corners()))
        reach = np.array([float(a) + float(b) for a, b in zip(deltas(plant), noise_sizes(plant), strict=True)])
        d0 = np.array([float(size) for size in acting_sizes(plant.disturbance)])
        C, E = view.C / reach[:, None], inclusion.noise_floats.drive[:, d] * d0
        if not all(np.all(np.isfinite(one)) for one in (flows, C, E)):
            return None
        omega = _fastest(flows, C, E)
        S = _sizes(flows / omega, C)
        corners = flows * S[None, None, :] / S[None, :, None] / omega
        h = float(question.law.T_max) * omega
        return Scaled(corners, C * S, E / S[:, None] / omega, S, omega, h, reach, d0)

    @property
    def n(self) -> int:
        return len(self.S)

    @cached_property
    def exact_scale(self) -> list[Fraction]:
        """S, which floats hold exactly."""
        return [Fraction(float(size)) for size in self.S]


def _fastest(flows: Array, C: Array, E: Array) -> float:
    """The fastest rate of a corner, or in which the disturbance reaches a threshold."""
    rates = [float(np.abs(np.linalg.eigvals(A)).max()) for A in flows]
    middle, column = flows.mean(axis=0), E
    for order in range(1, len(middle) + 1):
        moved = float(np.abs(C @ column).max(initial=0.0))
        if moved > 0:
            rates.append(moved ** (1 / order))
            break
        column = middle @ column
    rates = [rate for rate in rates if 0 < rate < np.inf]
    return max(rates, default=1.0)


def _sizes(flows: Array, C: Array) -> Array:
    """Errors that the outputs show as 1 or so within the time 1; powers of 2."""
    n = C.shape[1]
    shown: Array = np.zeros(n)
    for A in flows:
        rows, factor = C, 1.0
        for order in range(n):
            shown += (rows**2).sum(axis=0) * factor**2 / len(flows)
            rows, factor = rows @ A, factor / (order + 1)
    floor = _SMALLEST * shown.max(initial=0.0)
    size = np.where(shown > floor, shown, max(floor, 1e-300)) ** -0.5
    powers: Array = np.exp2(np.clip(np.round(np.log2(size)), -300, 300))
    return powers


@dataclass(frozen=True)
class Family:
    """All symmetric P with P K_i = l_i C_i' for some l_i, in the errors z: P = sum_k x_k basis[k]."""

    basis: list[Matrix]

    @cached_property
    def floats(self) -> Array:
        return np.array([one.floats for one in self.basis])

    def at(self, x: list[Fraction]) -> Matrix:
        total = self.basis[0] * x[0]
        for value, one in zip(x[1:], self.basis[1:], strict=True):
            total = total + one * value
        return total


def admissible(question: Question, scaled: Scaled) -> Family | None:
    """The family of a gain as it is run; None where there is none but 0, or the data are not rational."""
    C, K = question.plant.C.balls(), question.gain("K").balls()
    if not (C.is_rational and K.is_rational):
        return None
    S = scaled.exact_scale
    n, p = K.shape
    places = {pair: k for k, pair in enumerate((i, j) for i in range(n) for j in range(i, n))}
    size = len(places)
    rows: list[list[Any]] = []
    for i in range(p):
        for j in range(n):
            row: list[Any] = [fmpq(0)] * (size + p)
            for k in range(n):
                at = places[min(j, k), max(j, k)]
                row[at] = row[at] + K[k, i] / _fmpq(S[k])
            row[size + i] = -C[i, j] * _fmpq(S[j])
            rows.append(row)
    basis = [_symmetric(vector, places, n) for vector in _null_space(fmpq_mat(rows))]
    basis = [one for one in basis if any(value != 0 for row in one.tolist() for value in row)]
    return Family(basis) if basis else None


def _fmpq(value: Fraction) -> fmpq:
    return fmpq(value.numerator, value.denominator)


def _null_space(M: fmpq_mat) -> list[list[fmpq]]:
    """A basis of the x with M x = 0."""
    reduced, rank = M.rref()
    width = M.ncols()
    pivots = [next(j for j in range(width) if reduced[i, j] != 0) for i in range(rank)]
    vectors = []
    for free in (j for j in range(width) if j not in pivots):
        vector = [fmpq(0)] * width
        vector[free] = fmpq(1)
        for i, pivot in enumerate(pivots):
            vector[pivot] = -reduced[i, free]
        vectors.append(vector)
    return vectors


def _symmetric(vector: list[fmpq], places: dict[tuple[int, int], int], n: int) -> Matrix:
    entries = [[vector[places[min(i, j), max(i, j)]] for j in range(n)] for i in range(n)]
    most = max(abs(float(value.p) / float(value.q)) for row in entries for value in row)
    # A power of 2 keeps the numbers of the search about 1.
    power = Fraction(2) ** -round(float(np.log2(most))) if 0 < most < np.inf else Fraction(1)
    return Matrix.from_rows([[value * _fmpq(power) for value in row] for row in entries])
