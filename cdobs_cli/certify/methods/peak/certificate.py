"""The error bound of one state under bounded disturbance and noise, for laws with T_min > 0: chains of quadratic
functions of the last sampling intervals, one for each window of the time since the last sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.clock.certificate import is_small
from cdobs_cli.certify.methods.clock.form import Shape, in_basis
from cdobs_cli.certify.methods.peak.chain import Chain
from cdobs_cli.certify.methods.peak.signals import exact_signals, is_bounded
from cdobs_cli.certify.methods.peak.sizes import Sizes, float_signals, signal_sizes, sizes
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.certify.methods.peak.state import (
    before_first_sample,
    number_of,
    quantity_of,
    start_box,
    start_texts,
    unit,
)
from cdobs_cli.certify.texts import upper_texts
from cdobs_cli.codec import OPTIONAL
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.plant import Box, Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.methods.peak.search import Found

_DIGITS = 13
_DEGREE, _ELEVATED = 4, 5
_PIECES = (2, 4, 4, 6)  # of an interval, by effort
_MOST = (300, 1500, 3000, 6000)  # unknowns, by effort: of larger plants the intervals have fewer pieces
_LAGS = (3, 6, 10, 16)  # at most, by effort
_FEWEST = 3
_MEMORY = 3.0  # time constants that the lags go back
_SHARES = (0.3, 0.55, 0.8)  # of the way from the radius to 1, for rho of the tail
_ROOM = (1e-7, 1e-6, 1e-5)  # of the size of z z': what rounding and the solver may take
_WINDOWS = 4  # for an error that samples do not change


@dataclass(frozen=True)
class Peak(Method):
    """state: number of the state, from 0. chains: their windows cover all times between samples. start: the intervals
    of the errors before the first sample, where the bound is one for all time from them."""

    state: str
    chains: list[Chain]
    start: list[list[str]] | None = field(default=None, metadata={OPTIONAL: True})

    name: ClassVar[str] = "peak"
    rung: ClassVar[str] = "peak"
    source: ClassVar[str] = "clock-dependent Lyapunov functions of the last intervals"
    how: ClassVar[str] = "exact Bernstein coefficients"
    statement: ClassVar[str] = "The error stays bounded"
    reach: ClassVar[Reach] = "error bound"
    nonlinear_outputs: ClassVar[bool] = True
    of_one_state: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        law, inclusion = question.law, question.inclusion
        if inclusion.assemble_noise is None or not is_bounded(question.plant) or not is_small(inclusion):
            return False
        return law.is_bounded and law.T_min.sign() == 1

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound found for the error of the question's state. The memory keeps rho of the tail."""
        if question.state is None or not cls.applies(question):
            return None
        if question.start is not None and _vertices(question) is None:
            return None
        sized = _sizes(question)
        if sized is None or not sized.radius < 1:
            return None
        chains = []
        for window in _windows(question, question.state):
            chain = _chain(question, question.state, sized, window)
            if chain is None:
                return None
            chains.append(chain)
        proposal = cls(question.law, str(question.state), chains, start_texts(question.start))
        return proposal if proposal.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        inclusion = question.inclusion
        if not self.applies(question) or not _covers([chain.shares for chain in self.chains]):
            return NOTHING
        maps, signals = inclusion.balls, exact_signals(inclusion)
        i, start = number_of(self.state, question.plant), start_box(self.start, question.plant)
        first = None if start is None else first_vertices(maps, signals, start)
        if start is not None and first is None:
            return NOTHING
        largest, z = arb(0), unit(maps.base.shape[0], i)
        for chain in self.chains:
            squared = chain.bound_squared(maps, signals, z, self.law, first)
            if squared is None:
                return NOTHING
            largest = largest.max(squared)
        error = largest.sqrt()
        return Proof(True, error=error if start is None else error.max(before_first_sample(start, i)))

    def started_from(self, plant: Plant) -> Box | None:
        return start_box(self.start, plant)

    def quantity(self, plant: Plant) -> str:
        """The name of the bound."""
        return quantity_of(self.state, self.start, plant)

    def certificate(self, gain: Any = None) -> Certificate:
        written = super().certificate(gain)
        plain = {"chains": [chain.document() for chain in self.chains]}
        return Certificate(written.method, written.sampling, written.data | plain)


def _covers(windows: list[tuple[Fraction, Fraction]]) -> bool:
    """Whether windows fill [0, 1]."""
    reached = Fraction(0)
    for low, high in sorted(windows):
        if low > reached:
            return False
        reached = max(reached, high)
    return reached >= 1


# The search: floats and the solver propose, `prove` decides.


def _sizes(question: Question) -> Sizes | None:
    law, maps = question.law, question.inclusion.floats
    parts = (maps.base, maps.jump, *maps.parts, *maps.jump_parts)
    if not all(np.all(np.isfinite(part)) for part in parts) or not 0 < float(law.T_max) < 1e12:
        return None
    B, G = float_signals(question.inclusion)
    vertices = _vertices(question)
    if vertices is not None:  # a start counts as noise of its size
        G = np.concatenate([G, np.diag(np.abs(vertices).max(axis=0))], axis=1)
    return sizes(maps, B, G, sorted({float(law.T_min), float(law.T_max)}))


def _windows(question: Question, i: int) -> list[tuple[Fraction, Fraction]]:
    """All of [0, 1], in parts where a sample does not change the error: then the worst time lies between samples."""
    maps, noise = question.inclusion.floats, question.inclusion.noise_floats
    continuous = all(np.array_equal(J[i], np.eye(len(J))[i]) for J in maps.jumps()) and not np.any(noise.kick[i])
    count = _WINDOWS if continuous and question.level else 1
    return [(Fraction(k, count), Fraction(k + 1, count)) for k in range(count)]


def _chain(question: Question, i: int, sized: Sizes, window: tuple[Fraction, Fraction]) -> Chain | None:
    """The chain of least bound, of the values of rho tried."""
    from cdobs_cli.certify.methods.peak.search import Search

    law, T = question.law, float(question.law.T_max)
    scale = _scale(sized.errors)
    N = len(scale)
    change = np.diag(scale)
    maps = in_basis(question.inclusion.floats, change, np.diag(1 / scale))
    unit_time = maps.mapped(lambda flow: flow * T, lambda J: J)
    B, G = float_signals(question.inclusion)
    B, G = B / scale[:, None] * T, G / scale[:, None]
    vertices = _vertices(question)
    vertices = None if vertices is None else vertices / scale
    lags = _lags(question, sized.radius)
    first, others = _shapes(question, lags, window)
    z = np.eye(N)[:, [i]]
    for eps in _ROOM:
        cuts = question.memory.setdefault(("peak", first, others), set())
        search = Search(
            unit_time, B, G, first, others, lags, float(law.T_min) / T, (float(window[0]), float(window[1])), eps, cuts,
            vertices,
        )  # fmt: skip
        best: tuple[Found, float] | None = None
        kept = question.memory.get("peak rho")
        for rho in [kept] if kept else _rhos(sized.radius):
            found = search.least(z, rho)
            if found is not None and (best is None or found.bound_squared < best[0].bound_squared):
                best = found, rho
        if best is None:
            return None
        question.memory["peak rho"] = best[1]
        chain = _written(question, i, best[0], best[1], scale, window, (first, others))
        if _holds(question, i, chain):
            return chain
    return None


def _holds(question: Question, i: int, chain: Chain) -> bool:
    maps = question.inclusion.balls
    z = unit(maps.base.shape[0], i)
    return chain.bound_squared(maps, exact_signals(question.inclusion), z, question.law) is not None


def _vertices(question: Question) -> Array | None:
    """What the error may be just after the first sample, (V, N), where a transient is asked for."""
    if question.start is None:
        return None
    inclusion = question.inclusion
    vertices = first_vertices(inclusion.balls, exact_signals(inclusion), question.start)
    return None if vertices is None else np.array([vertex.floats[:, 0] for vertex in vertices])


def _rhos(radius: float) -> Iterator[float]:
    return (float(decimal_text(radius + (1 - radius) * share, 4)) for share in _SHARES)


def _lags(question: Question, radius: float) -> int:
    """So many that their intervals span some time constants, within the effort."""
    wanted = int(np.ceil(_MEMORY / -np.log(max(radius, 1e-6))))
    return max(_FEWEST, min(wanted, _LAGS[question.level]))


def _scale(errors: Array) -> Array:
    """Powers of 2 near the errors' sizes; where no signal acts, of the largest."""
    largest = float(errors.max(initial=0.0)) or 1.0
    return np.array([2.0 ** round(np.log2(size if size > 0 else largest)) for size in errors])


def _shapes(question: Question, lags: int, window: tuple[Fraction, Fraction]) -> tuple[Shape, Shape]:
    """As many pieces as effort and size allow, shared out by length."""
    law, (d, D), N = question.law, (_DEGREE, _ELEVATED), question.inclusion.floats.base.shape[0]
    t = N * (N + 1) // 2
    m = max(2, min(_PIECES[question.level], (_MOST[question.level] // ((lags + 1) * t) - 1) // d))

    def parted(share: float) -> Shape:
        if share in (0, 1):
            return Shape(d, D, m, 0) if share else Shape(d, D, 0, m)
        before = max(1, min(m - 1, round(m * share)))
        return Shape(d, D, before, m - before)

    return parted(float(window[0] / window[1])), parted(float(law.T_min) / float(law.T_max))


def _written(
    question: Question, i: int, found: Found, rho: float, scale: Array, window: tuple[Fraction, Fraction],
    shapes: tuple[Shape, Shape],
) -> Chain:  # fmt: skip
    """In the user's units."""
    T, (first, others) = float(question.law.T_max), shapes
    d0, v0 = signal_sizes(question.inclusion)
    back, size = 1 / scale, float(scale[i]) ** 2
    return Chain(
        [fraction_text(end) for end in window], str(first.d), str(first.D),
        [[str(shape.before), str(shape.after)] for shape in (first, others)], decimal_text(rho, 4),
        [[upper_texts(P * size * back * back[:, None], _DIGITS) for P in lag] for lag in found.P],
        [[_texts(piece * size / d0**2 / T) for piece in lag] for lag in found.mu],
        [_texts(nu * size / v0**2) for nu in found.nu],
    )  # fmt: skip


def _texts(values: Array) -> list[str]:
    return [decimal_text(float(value), _DIGITS) for value in values]
