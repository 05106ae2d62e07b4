"""A stored P(tau): Bernstein coefficients as decimals, the units of its states, and its inequalities proved.

Pdot + P A_v + A_v'P + Z < 0    on [0, T_max], at all corners v,        P(0) > 0,
rho^2 P(tau) - J'P_(0)(0)J > 0    on [T_min, T_max], at all corners of J.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

from flint import arb, fmpq

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape, flow_coefficients, in_basis, jump_gap, lyapunov
from cdobs_cli.certify.methods.mean_square.form import instants, paid, sample_instants, sums
from cdobs_cli.certify.methods.peak.form import driven_block, jump_block
from cdobs_cli.certify.methods.peak.signals import acting, acting_sizes
from cdobs_cli.certify.texts import rational, symmetric_from_upper, upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import fraction_text
from cdobs_cli.hybrid import ErrorMaps, NoiseMaps
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

DIGITS = 13
_MOST_DEGREES = 64
Texts = list[list[list[str]]]


def positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def exact_scalar(value: Fraction) -> fmpq:
    """As flint computes with it."""
    return fmpq(value.numerator, value.denominator)


def unit_texts(states: Array) -> list[str]:
    """Powers of 2 as they are stored."""
    return [fraction_text(Fraction(float(value))) for value in states]


def texts(coefficients: Array) -> Texts:
    """The coefficients (count, N, N) of P, rounded."""
    return [upper_texts(P, DIGITS) for P in coefficients]


def matrices(rows: Texts, shape: Shape, size: int) -> list[Matrix]:
    """What `texts` wrote. Raises: ValueError on another number or size of them."""
    P = [symmetric_from_upper(one) for one in rows]
    if len(P) != shape.count or any(one.shape != (size, size) for one in P):
        raise ValueError("another number of coefficients is expected")
    return P


def shape_texts(shape: Shape) -> list[str]:
    return [str(value) for value in (shape.d, shape.D, shape.before, shape.after)]


def shape_of(values: list[str], law: SamplingLaw) -> Shape:
    """Raises: ValueError where pieces do not cover [0, T_max] with T_min a break point."""
    d, D, before, after = (int(value) for value in values)
    if D > _MOST_DEGREES:
        raise ValueError("a degree beyond all use")
    shape = Shape(d, D, before, after)
    if law.is_updated or not 1 <= d <= D or min(before, after) < 0 or law.T_max.sign() != 1:
        raise ValueError("no shape of a polynomial")
    if law.is_periodic:
        wanted = before > 0 and after == 0
    elif (law.T_max - law.T_min).sign() != 1:
        raise ValueError("no law")
    else:
        wanted = after > 0 and (before == 0 if law.from_zero else law.T_min.sign() == 1 and before > 0)
    if not wanted:
        raise ValueError("no shape for this law")
    return shape


@dataclass(frozen=True)
class Proved:
    """The error system in the units of a certificate, in exact numbers or balls, and what is proved of its P."""

    question: Question
    shape: Shape
    units: tuple[Fraction, ...]

    @staticmethod
    def of(question: Question, shape: Shape, units: list[str]) -> Proved:
        """Raises: ValueError on units that are none."""
        values = tuple(rational(text) for text in units)
        if len(values) != question.inclusion.balls.base.shape[0] or any(value <= 0 for value in values):
            raise ValueError("one unit for each state")
        return Proved(question, shape, values)

    @property
    def N(self) -> int:
        return len(self.units)

    @cached_property
    def S(self) -> Matrix:
        return Matrix.diagonal(self.units)

    @cached_property
    def back(self) -> Matrix:
        return Matrix.diagonal([1 / value for value in self.units])

    @cached_property
    def maps(self) -> ErrorMaps[Matrix]:
        return in_basis(self.question.inclusion.balls, self.S, self.back)

    @cached_property
    def noise(self) -> NoiseMaps[Matrix]:
        maps = self.question.inclusion.noise_balls
        return NoiseMaps(self.back @ maps.drive, self.back @ maps.kick)

    @cached_property
    def corners(self) -> list[Matrix]:
        return list(self.maps.corners())

    @cached_property
    def jumps(self) -> list[Matrix]:
        return list(self.maps.jumps())

    @cached_property
    def lengths(self) -> list[Any]:
        law = self.question.law
        return self.shape.lengths(law.T_min.scalar, law.T_max.scalar)

    def weight(self, Z: Matrix) -> Matrix:
        """A form of e as one of z."""
        return self.S.T @ Z @ self.S

    @cached_property
    def driven(self) -> tuple[Matrix, Matrix]:
        """(B, G) of the bounded signals that are not 0, shapes (N, r), (N, q)."""
        plant = self.question.plant
        return self.noise.drive[:, acting(plant.disturbance)], self.noise.kick[:, acting(plant.noise)]

    def prices(self, rows: list[str], count: int) -> Matrix:
        """The diagonal matrix of so many prices. Raises: ValueError on another number of them."""
        if len(rows) != count:
            raise ValueError("one price for each signal")
        return Matrix.diagonal([rational(text) for text in rows])

    def power(self, mu: Matrix) -> arb:
        """sum_j mu_j d0_j^2."""
        return _weighted(mu, self.question.plant.disturbance)

    def kicked(self, nu: Matrix) -> arb:
        """sum_j nu_j v0_j^2."""
        return _weighted(nu, self.question.plant.noise)

    @cached_property
    def spread(self) -> Matrix:
        """G R G', (N, N): what the noise of a sample adds; 0 without a covariance."""
        R = self.question.plant.covariance
        G = self.noise.kick
        return Matrix.zeros(self.N, self.N) if R is None else G @ R.balls() @ G.T

    @cached_property
    def drift(self) -> Matrix:
        """B Q B', (N, N): what the disturbance adds per time; 0 without an intensity."""
        Q = self.question.plant.intensity
        B = self.noise.drive
        return Matrix.zeros(self.N, self.N) if Q is None else B @ Q.balls() @ B.T

    def flows(
        self, P: list[Matrix], Z: Matrix | None = None, until: int | None = None, B: Matrix | None = None,
        mu: list[Matrix] | None = None,
    ) -> bool:  # fmt: skip
        """Pdot + P A + A'P + Z < 0 at every corner, on the first `until` pieces; its block with what drives through B
        and is paid for with mu, a diagonal matrix for each piece, where that is not empty."""
        covered = self.shape.pieces if until is None else until
        zero, driven = Matrix.zeros(self.N, self.N), B is not None and B.shape[1] > 0
        coefficients = list(flow_coefficients(P, self.shape, self.lengths))[: covered * (self.shape.D + 1)]
        for number, (slope, value) in enumerate(coefficients):
            piece = number // (self.shape.D + 1)
            h = self.lengths[piece]
            paid_for = zero if Z is None else Z * h
            for A in self.corners:
                gap = paid(slope, lyapunov(value, A, 0), paid_for)
                if driven:
                    assert B is not None and mu is not None
                    gap = driven_block(gap, value @ B, mu[piece] * h)
                if not positive(gap):
                    return False
        return True

    def falls(
        self, P_after: Matrix, P_before: list[Matrix], share: Fraction = Fraction(1), G: Matrix | None = None,
        nu: Matrix | None = None,
    ) -> bool:  # fmt: skip
        """share P_before(tau) - J'P_after J > 0 on [T_min, T_max], at every corner of J; its block with what kicks
        through G and is paid for with nu, a diagonal matrix, where that is not empty."""
        for number in range(self.shape.jump_from, self.shape.count):
            for J in self.jumps:
                P = P_before[number] * share
                kicked = G is not None and nu is not None and G.shape[1] > 0
                if not positive(jump_block(P, P_after, J, G, nu) if kicked else jump_gap(P_after, P, J)):
                    return False
        return True

    def traces(self, P: list[Matrix], M: Matrix) -> list[Matrix]:
        """tr(P M) of each coefficient, (1, 1) each."""
        return [Matrix.from_rows([[(one @ M).trace()]]) for one in P]

    def sums(self, q: list[Matrix]) -> list[Matrix]:
        """The coefficients of int_0^tau q."""
        return sums(q, self.shape, self.lengths)

    @cached_property
    def times(self) -> list[Any]:
        return instants(self.shape, self.lengths)

    def average(self, P: list[Matrix], kicks: arb) -> arb:
        """The least gamma with gamma tau >= kicks + tr(R G'P(0)G) + int_0^tau tr(P B Q B') on [T_min, T_max]."""
        added = kicks + arb((P[0] @ self.spread).trace())
        drifted, gamma = self.sums(self.traces(P, self.drift)), arb(0)
        for number in sample_instants(self.shape):
            gamma = gamma.max((added + arb(drifted[number].trace())) / arb(self.times[number]))
        return gamma


def _weighted(prices: Matrix, box: Box | None) -> arb:
    total = arb(0)
    for place, size in enumerate(acting_sizes(box)):
        total += arb(prices[place, place]) * arb(size) ** 2
    return total
