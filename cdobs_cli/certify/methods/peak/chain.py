"""A chain of quadratic functions, one for each of the last sampling intervals, that bounds one combination of errors.

Lag 0 is the interval of the time looked at, lag k the k-th before it; V_k = e'P_k(tau)e, tau the time since the last
sample. If, at all corners of flow and jump,

    [[-(P_k' + P_k A + A'P_k), -P_k B], [., diag mu_k]] > 0    on [0, T_max], lag 0 on [0, tb],          (flow)
    [[P_k(tau) - J'P_(k-1)(0)J, -J'P_(k-1)(0)G], [., diag nu_k - G'P_(k-1)(0)G]] > 0    on [T_min, T_max], k = 1 .. N,
    the same with rho^2 P_N(tau) and P_N(0) in place of P_k(tau) and P_(k-1)(0), with nu,                (tail)
    P_0(tau) - z z' > 0    on [ta, tb],                                                                  (target)

then, mu constant on each piece and D_k = sum_j d0_j^2 int mu_kj over [0, T_max] (lag 0: over [0, tb]),

    limsup (z'e)^2 <= M + sum_(k=0..N) D_k + sum_(k=1..N) sum_j nu_kj v0_j^2,
    M = (rho^2 D_N + sum_j nu_j v0_j^2) / (1 - rho^2),    over all times with tau in [ta, tb].

Counted from the first sample instead, with e in a known set just after it, the chain is cut off there: in interval q,
q = 0 .. N, V_q(0) at that time takes the place of M and of the lags above q, so that

    (z'e)^2 <= e'P_q(0)e + sum_(k=0..q) D_k + sum_(k=1..q) sum_j nu_kj v0_j^2,

and later (z'e)^2 is at most the first bound with the larger of M and e'P_N(0)e in place of M: V_N keeps below the
larger of its start and its fixed point. The transient is at most the largest of all these.

V_N just after a sample is at most rho^2 (V_N + D_N) + nu v^2 from one sample to the next, and M is the fixed point;
V_(k-1) after a sample is at most V_k before it and nu_k v^2. Where the outputs' slopes vary, |J e + G v|^2 in the form
of P(0) is convex in J: P_0(tau) > z z' >= 0 and the flow give P_0(0) >= 0, the jump P_1(tau) >= 0 on [T_min, T_max]
and so on down the lags, so corners of J suffice. mu and nu need no sign of their own: they are diagonal blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any

from flint import arb

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.clock.form import Shape, flow_coefficients
from cdobs_cli.certify.methods.peak.form import flow_block, jump_block, target_block
from cdobs_cli.certify.methods.peak.signals import Signals
from cdobs_cli.certify.texts import rational, symmetric_from_upper
from cdobs_cli.codec import Noun
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

Texts = list[list[str]]


@dataclass(frozen=True)
class Chain(Noun):
    """Decimal strings, as design.json holds them.

    window: [ta, tb] as shares of T_max. degree, elevated: d of every P_k, D of the inequalities. pieces: of lag 0 on
    [0, ta] and [ta, tb], of the others on [0, T_min] and [T_min, T_max]. rho: of the tail. P: by lag the upper
    triangles of the Bernstein coefficients. mu: by lag and piece. nu: by lag from 1 on, then the tail's.
    """

    window: list[str]
    degree: str
    elevated: str
    pieces: Texts
    rho: str
    P: list[list[list[list[str]]]]
    mu: list[Texts]
    nu: Texts

    @cached_property
    def shapes(self) -> tuple[Shape, Shape]:
        """Of lag 0, and of the others."""
        d, D = int(self.degree), int(self.elevated)
        first, others = (Shape(d, D, int(before), int(after)) for before, after in self.pieces)
        return first, others

    @cached_property
    def shares(self) -> tuple[Fraction, Fraction]:
        """The ends of the window."""
        low, high = map(rational, self.window)
        return low, high

    def bound_squared(
        self, maps: ErrorMaps[Matrix], signals: Signals[Matrix], z: Matrix, law: SamplingLaw,
        start: Sequence[Matrix] | None = None,
    ) -> arb | None:  # fmt: skip
        """b^2 with limsup (z'e)^2 <= b^2 at times in the window; None where nothing is proved.

        Args:
            start: the vertices of what e may be just after the first sample, (N, 1) each: then (z'e)^2 <= b^2 at every
                time in the window from that sample on.
        """
        return _Reading(self, maps, signals, z, law).bound_squared(start)


@dataclass(frozen=True)
class _Reading:
    """A chain as exact matrices, for one error system under one law."""

    chain: Chain
    maps: ErrorMaps[Matrix]
    signals: Signals[Matrix]
    z: Matrix
    law: SamplingLaw

    def bound_squared(self, start: Sequence[Matrix] | None) -> arb | None:
        if not self._is_whole():
            return None
        if not all(has_positive_pivots(block.balls()) for block in self._blocks()):
            return None
        rho2, last = self.rho2, len(self.P) - 1
        D = [self._fed(lag) for lag in range(last + 1)]
        *kicked, at_tail = [weighted(nu, self.signals.v0) for nu in self.nu]
        M = (D[last] * rho2 + at_tail) / (1 - rho2)
        bound = arb(M + sum(D) + sum(kicked))
        for q in range(last + 1) if start is not None else ():
            spent = arb(sum(D[: q + 1]) + sum(kicked[:q]))
            for e in start or ():
                bound = bound.max(arb((e.T @ self.P[q][0] @ e)[0, 0]) + spent)
        return bound

    @cached_property
    def P(self) -> list[list[Matrix]]:
        return [[symmetric_from_upper(rows) for rows in lag] for lag in self.chain.P]

    @cached_property
    def mu(self) -> list[list[list[Any]]]:
        return [[scalars(piece) for piece in lag] for lag in self.chain.mu]

    @cached_property
    def nu(self) -> list[list[Any]]:
        return [scalars(lag) for lag in self.chain.nu]

    @cached_property
    def rho2(self) -> Any:
        return Matrix.from_rows([[rational(self.chain.rho) ** 2]])[0, 0]

    def lengths(self, lag: int) -> list[Any]:
        """Of the pieces of a lag."""
        first, others = self.chain.shapes
        T_max = self.law.T_max.scalar
        if lag:
            return others.lengths(self.law.T_min.scalar, T_max)
        low, high = self.chain.shares
        return first.lengths(_times(T_max, low), _times(T_max, high))

    def _is_whole(self) -> bool:
        """Whether there is one function a lag and one weight a signal, and rho in (0, 1)."""
        law, (first, others), (low, high) = self.law, self.chain.shapes, self.chain.shares
        size, lags = self.maps.base.shape, len(self.P)
        if not 0 <= low < high <= 1 or not is_well_cut(first, low == 0, low == high):
            return False
        if law.is_updated or law.T_max.sign() != 1 or law.T_min.sign() != 1:
            return False
        if not law.is_periodic and (law.T_max - law.T_min).sign() != 1:
            return False
        if not is_well_cut(others, False, law.is_periodic) or not 0 < self.rho2 < 1:
            return False
        if lags < 2 or len(self.mu) != lags or len(self.nu) != lags:
            return False
        q, p = len(self.signals.d0), len(self.signals.v0)
        for shape, P, mu in zip((first, *[others] * (lags - 1)), self.P, self.mu, strict=True):
            if len(P) != shape.count or any(one.shape != size for one in P):
                return False
            if len(mu) != shape.pieces or any(len(piece) != q for piece in mu):
                return False
        return all(len(nu) == p for nu in self.nu)

    def _blocks(self) -> Iterator[Matrix]:
        """Every block that is to be definite."""
        first, others = self.chain.shapes
        for P in self.P[0][first.jump_from :]:
            yield target_block(P, self.z)
        last = len(self.P) - 1
        for lag in range(1, last + 2):
            # The tail: the last function again, shrunk.
            before = self.P[lag] if lag <= last else [P * self.rho2 for P in self.P[last]]
            after, nu = self.P[lag - 1][0], Matrix.diagonal(self.nu[lag - 1])
            for J in self.maps.jumps():
                for P in before[others.jump_from :]:
                    yield jump_block(P, after, J, self.signals.G, nu)
        corners = list(self.maps.corners())
        for lag, shape in enumerate((first, *[others] * last)):
            lengths = self.lengths(lag)
            for number, (P_dot, P) in enumerate(flow_coefficients(self.P[lag], shape, lengths)):
                piece = number // (shape.D + 1)
                mu = Matrix.diagonal(self.mu[lag][piece]) * lengths[piece]
                for A in corners:
                    yield flow_block(P_dot, P, A, self.signals.B, mu)

    def _fed(self, lag: int) -> Any:
        """D_k."""
        pieces = zip(self.mu[lag], self.lengths(lag), strict=True)
        return sum(weighted(mu, self.signals.d0) * length for mu, length in pieces)


def is_well_cut(shape: Shape, from_start: bool, to_end: bool) -> bool:
    """Whether pieces cover [0, b] with a break point at a: none before a = 0, none after a = b."""
    if not 1 <= shape.d <= shape.D or min(shape.before, shape.after) < 0:
        return False
    return (shape.before == 0) == from_start and (shape.after == 0) == to_end


def _times(length: Any, share: Fraction) -> Any:
    return (Matrix.from_rows([[length]]) * share)[0, 0]


def scalars(texts: list[str]) -> list[Any]:
    return [Matrix.from_rows([[rational(text)]])[0, 0] for text in texts]


def weighted(weights: list[Any], sizes: tuple[Any, ...]) -> Any:
    """sum_j weights_j sizes_j^2."""
    return sum((weight * size * size for weight, size in zip(weights, sizes, strict=True)), Matrix.zeros(1, 1)[0, 0])
