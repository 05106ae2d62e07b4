"""The error bound of one state where samples may follow one another as fast as one likes (T_min = 0, or T_min far
below T_max): the noise of the last sample as an input of the flow.

A sample that adds nu v^2 to a function of the error adds without end where samples have no least distance. Instead the
error is shifted by what noise has left in it (`split`), in a basis e = S y with

    S^-1 J S = diag(I, j),    S^-1 G = [0; G_w],    x = y - H s_k,

H s_k constant from t_k on, |s_kj| <= s0_j. Then x+ = diag(I, j) x, xdot = A x + A H s + S^-1 B d, A = S^-1 A_i S, and
no sample adds anything. With (x, s) as the state, sdot = 0, s arbitrary after a sample, F = [[A, A H], [0, 0]] and
D = [S^-1 B; 0]: if P(0) = diag(P_x, 0) exactly, and at all corners, mu = (mu_s, mu_d) constant on each piece,

    [[diag(0, mu_s) - (P' + P F + F'P + 2 sigma P), -P D], [., mu_d]] > 0    on [0, T_max],       (flow)
    P(tau) - diag(I, j, 0)' P(0) diag(I, j, 0) >= 0                           on [T_min, T_max],   (jump)
    P(tau) + diag(0, nu) - z z' > 0    for e_i = z'(x, s)                     on [0, T_max],       (target)

then V = (x, s)'P(x, s) grows at no sample and by at most c - 2 sigma V per time between them, c the largest of
sum_j mu_sj s0_j^2 + sum_j mu_dj d0_j^2 over the pieces, and

    limsup e_i^2 <= c / (2 sigma) + sum_j nu_j s0_j^2.

From a known error before the first sample x is diag(I, j) S^-1 e after it, and for all time from there the larger of
x'P_x x and c / (2 sigma) takes the place of the latter.

From T_min = 0 the jump is singular at tau = 0: there P_x = diag(P_11, Q) exactly, which leaves diag(0, Q - j'Q j, 0),
and Q - j'Q j > 0, as in the clock certificate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

from flint import arb

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.clock.certificate import split_basis
from cdobs_cli.certify.methods.clock.form import (
    Shape,
    flow_coefficients,
    jump_gap,
)
from cdobs_cli.certify.methods.peak.chain import is_well_cut, scalars, weighted
from cdobs_cli.certify.methods.peak.form import flow_block, target_block
from cdobs_cli.certify.methods.peak.split import Split, split_error
from cdobs_cli.certify.methods.peak.state import (
    PeakOfState,
    before_first_sample,
    number_of,
    start_box,
    start_texts,
)
from cdobs_cli.certify.texts import rate_of, rationals, symmetric_from_upper
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.certify.methods.peak.from_zero_search import Found

_DIGITS = 13
_WIDE = 2.5  # T_max over T_min from which on this method is asked


@dataclass(frozen=True)
class PeakFromZero(PeakOfState):
    """degree d of P and elevated degree D of the inequalities; pieces on [0, T_min] and on [T_min, T_max]; sigma;
    basis: S in e = S y; P: upper triangles of the Bernstein coefficients; mu: by piece (mu_s, mu_d)."""

    state: str
    degree: str
    elevated: str
    pieces: list[str]
    sigma: str
    basis: list[list[str]]
    P: list[list[list[str]]]
    mu: list[list[str]]
    nu: list[str]
    start: list[list[str]] | None = field(default=None, metadata={OPTIONAL: True})

    name: ClassVar[str] = "peak_from_zero"
    source: ClassVar[str] = "clock-dependent Lyapunov function, the noise as an input of the flow"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return cls.takes(question) and not question.law.is_periodic and not question.inclusion.outputs

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound found for the error of the question's state."""
        law = question.law
        if question.state is None or not cls.applies(question):
            return None
        if float(law.T_min) * _WIDE > float(law.T_max):
            return None
        for found, texts in cls._met(question, question.state):
            shape, sigma = found.shape, decimal_text(found.sigma, _DIGITS)
            cut = (str(shape.d), str(shape.D), [str(shape.before), str(shape.after)])
            proposal = cls(
                law, str(question.state), *cut, sigma, texts, found.P, found.mu, found.nu, start_texts(question.start)
            )
            if proposal.prove(question).holds:
                return proposal
        return None

    @classmethod
    def error_guess(cls, question: Question) -> float | None:
        if question.state is None or not cls.applies(question):
            return None
        return next((found.error for found, _ in cls._met(question, question.state)), None)

    @classmethod
    def _met(cls, question: Question, i: int) -> Iterator[tuple[Found, list[list[str]]]]:
        """What the solver finds, nothing of it proved, with the basis that it is in."""
        from cdobs_cli.certify.methods.peak.from_zero_search import proposals

        S = split_basis(question.inclusion)
        split = None if S is None else split_error(question, Matrix.from_rows(S))
        if S is None or split is None:
            return
        vertices = [] if question.start is None else split.first_vertices(question.start)
        if vertices is None:
            return
        texts = [[fraction_text(value) for value in row] for row in S]
        yield from ((found, texts) for found in proposals(question, i, split, vertices))

    @cached_property
    def shape(self) -> Shape:
        return Shape(int(self.degree), int(self.elevated), int(self.pieces[0]), int(self.pieces[1]))

    def _prove(self, question: Question) -> Proof:
        law, shape, sigma = self.law, self.shape, Matrix.from_rows([[rate_of(self.sigma)]])[0, 0]
        split = split_error(question, rationals(self.basis)) if self.applies(question) else None
        if split is None or not sigma > 0:
            return NOTHING
        if law.T_max.sign() != 1 or not is_well_cut(shape, law.from_zero, law.is_periodic):
            return NOTHING
        P, mu = [symmetric_from_upper(rows) for rows in self.P], [scalars(piece) for piece in self.mu]
        size = split.maps.base.shape
        if len(P) != shape.count or any(one.shape != size for one in P):
            return NOTHING
        if len(mu) != shape.pieces or any(len(piece) != len(split.s0) + len(split.d0) for piece in mu):
            return NOTHING
        z, nu = split.target(number_of(self.state, question.plant)), scalars(self.nu)
        if len(nu) != len(split.s0) or not split.begins_apart(P[0], law.from_zero):
            return NOTHING
        lengths = shape.lengths(law.T_min.scalar, law.T_max.scalar)
        blocks = self._blocks(P, mu, lengths, split, sigma, z, nu)
        if not all(has_positive_pivots(one.balls()) for one in blocks):
            return NOTHING
        c = arb(0)
        for piece in mu:
            c = c.max(arb(weighted(piece, (*split.s0, *split.d0))))
        largest, i = c / (2 * arb(sigma)), number_of(self.state, question.plant)
        start = start_box(self.start, question.plant)
        first = [] if start is None else split.first_vertices(start)
        if first is None:
            return NOTHING
        for x in first:
            largest = largest.max(arb((x.T @ P[0] @ x)[0, 0]))
        error = (largest + arb(weighted(nu, split.s0))).sqrt()
        return Proof(True, error=error if start is None else error.max(before_first_sample(start, i)))

    def _blocks(
        self, P: list[Matrix], mu: list[list[Any]], lengths: list[Any], split: Split, sigma: Any, z: Matrix,
        nu: list[Any],
    ) -> Iterator[Matrix]:  # fmt: skip
        """Every block that is to be definite."""
        shape, added, m = self.shape, split.fed(nu), len(split.s0)
        for one in P:
            yield target_block(one + added, z)
        for one in P[max(shape.jump_from, int(self.law.from_zero)) :]:
            yield jump_gap(P[0], one, split.maps.jump)
        corners = list(split.maps.corners())
        for number, (slope, value) in enumerate(flow_coefficients(P, shape, lengths)):
            piece = number // (shape.D + 1)
            h, weights = lengths[piece], mu[piece]
            rising, fed = slope - split.fed(weights[:m]) * h, Matrix.diagonal(weights[m:]) * h
            for A in corners:
                yield flow_block(rising, value, A, split.B, fed, sigma)
