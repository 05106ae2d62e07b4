"""Proposals of error bounds for laws with T_min > 0: floats and the solver propose, `Peak.prove` decides."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import cached_property
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape, in_basis
from cdobs_cli.certify.methods.peak.chain import Chain
from cdobs_cli.certify.methods.peak.search import Found, Search
from cdobs_cli.certify.methods.peak.signals import exact_signals
from cdobs_cli.certify.methods.peak.sizes import Sizes, float_signals, signal_sizes, sizes
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.certify.methods.peak.state import unit
from cdobs_cli.certify.texts import upper_texts
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 13
# d, D and pieces of an interval where the flow turns the error little in it (|(A T)^2|^(1/2) at most so much): more are
# not needed, and leave the solver a face of optima instead of a point.
_SLOW = ((0.05, (2, 3, 1)), (0.15, (3, 4, 1)), (0.35, (4, 5, 2)))
_DEGREE, _ELEVATED = 4, 5
_PIECES = (2, 4, 4, 6)  # of an interval, by effort
_MOST = (300, 420, 1500, 4000)  # unknowns, by effort: of larger plants there are fewer lags, and pieces of a lag
_LAGS = (3, 10, 16, 24)  # at most, by effort
_FEWEST, _USUAL = 2, 3  # at least, over that number of unknowns and within it
_MEMORY = 3.0  # time constants that the lags go back
_SHARES = (0.55, 0.3, 0.8)  # of the way from the radius to 1, for rho of the tail
_WORTH = 0.998  # of b^2: what another rho must do better
_RHO_DIGITS = 3  # of 1 - rho
_ROOM = (1e-7, 3e-6, 1e-4)  # of the size of z z': what rounding and the solver may take
_CORNERS = 64
_WINDOWS = 4  # for an error that samples do not change


def chains_of(question: Question, i: int) -> list[Chain] | None:
    """Chains for the error of state i, of the least bounds found, one for each window; None where one has none.

    The memory keeps rho of the tail, and which corners bound, from one state and window to the next.
    """
    scaled = _Scaled.of(question, i)
    if scaled is None:
        return None
    chains = []
    for window in _windows(question, i):
        chain = scaled.chain(window)
        if chain is None:
            return None
        chains.append(chain)
    return chains


def guess_of(question: Question, i: int) -> float | None:
    """What the solver says of the error of state i with one window: nothing is proved."""
    scaled = _Scaled.of(question, i)
    return None if scaled is None else scaled.guess()


def _windows(question: Question, i: int) -> list[tuple[Fraction, Fraction]]:
    """All of [0, 1], in parts where a sample does not change the error: then the worst time lies between samples."""
    maps, noise = question.inclusion.floats, question.inclusion.noise_floats
    continuous = all(np.array_equal(J[i], np.eye(len(J))[i]) for J in maps.jumps()) and not np.any(noise.kick[i])
    count = _WINDOWS if continuous and question.level else 1
    return [(Fraction(k, count), Fraction(k + 1, count)) for k in range(count)]


@dataclass(frozen=True)
class _Scaled:
    """The question about state i in states of the errors' sizes, unit time, and signals of size 1.

    vertices: what the error may be just after the first sample, (V, N), in the user's units, where a transient is asked
    for.
    """

    question: Question
    i: int
    sized: Sizes
    vertices: Array | None

    @staticmethod
    def of(question: Question, i: int) -> _Scaled | None:
        """None where the loop does not decay at some corner, or numbers are beyond floats."""
        law, inclusion = question.law, question.inclusion
        maps = inclusion.floats
        parts = (maps.base, maps.jump, *maps.parts, *maps.jump_parts)
        if not all(np.all(np.isfinite(part)) for part in parts) or not 0 < float(law.T_max) < 1e12:
            return None
        (B, G), vertices = float_signals(inclusion), None
        if question.start is not None:
            exact = first_vertices(inclusion.balls, exact_signals(inclusion), question.start)
            if exact is None:
                return None
            vertices = np.array([vertex.floats[:, 0] for vertex in exact])
            G = np.concatenate([G, np.diag(np.abs(vertices).max(axis=0))], axis=1)  # counts as noise of its size
        sized = sizes(maps, B, G, sorted({float(law.T_min), float(law.T_max)}))
        return _Scaled(question, i, sized, vertices) if sized is not None and sized.radius < 1 else None

    @cached_property
    def scale(self) -> Array:
        """Powers of 2 near the errors' sizes; where no signal acts, of the largest."""
        errors = self.sized.errors
        largest = float(errors.max(initial=0.0)) or 1.0
        return np.array([2.0 ** round(np.log2(size if size > 0 else largest)) for size in errors])

    @cached_property
    def maps(self) -> Any:
        T = float(self.question.law.T_max)
        maps = in_basis(self.question.inclusion.floats, np.diag(self.scale), np.diag(1 / self.scale))
        return maps.mapped(lambda flow: flow * T, lambda J: J)

    def chain(self, window: tuple[Fraction, Fraction]) -> Chain | None:
        """The chain of least bound among the values of rho tried, each with more room until it is proved."""
        known = self.question.memory.get("peak rho")
        for rhos in ([known], list(self._rhos())) if known else (list(self._rhos()),):
            found: list[tuple[Found, Fraction]] = []
            for rho in rhos:
                below = min((guess.bound_squared for guess, _ in found), default=np.inf) * _WORTH
                guess = self._search(window, _ROOM[0]).least(self._z, float(rho), below)
                found += [(guess, rho)] if guess is not None else []
            for guess, rho in reversed(found):
                chain = self._proved(window, guess, rho)
                if chain is not None:
                    self.question.memory["peak rho"] = rho
                    return chain
        return None

    def guess(self) -> float | None:
        """The least b met, of the value of rho kept or those tried."""
        known = self.question.memory.get("peak rho")
        search = self._search((Fraction(0), Fraction(1)), _ROOM[0])
        met = [(search.least(self._z, float(rho)), rho) for rho in ([known] if known else self._rhos())]
        found = [(guess.bound_squared, rho) for guess, rho in met if guess is not None]
        if not found:
            return None
        squared, self.question.memory["peak rho"] = min(found)
        return float(np.sqrt(max(squared, 0.0)) * self.scale[self.i])

    def _proved(self, window: tuple[Fraction, Fraction], guess: Found, rho: Fraction) -> Chain | None:
        question, maps = self.question, self.question.inclusion.balls
        z, signals = unit(maps.base.shape[0], self.i), exact_signals(question.inclusion)
        again = (self._search(window, eps).least(self._z, float(rho)) for eps in _ROOM[1:])
        for met in chain((guess,), again):
            written = None if met is None else self._written(met, rho, window)
            if written is not None and written.bound_squared(maps, signals, z, question.law) is not None:
                return written
        return None

    @property
    def _z(self) -> Array:
        return np.eye(len(self.scale))[:, [self.i]]

    def _search(self, window: tuple[Fraction, Fraction], eps: float) -> Search:
        law, (first, others) = self.question.law, self._shapes(window)
        B, G = float_signals(self.question.inclusion)
        T, scale = float(law.T_max), self.scale[:, None]
        vertices = None if self.vertices is None else self.vertices / self.scale
        cuts = self.question.memory.setdefault(("peak", first, others, self.lags), set())
        return Search(
            self.maps, B / scale * T, G / scale, first, others, self.lags, float(law.T_min) / T,
            (float(window[0]), float(window[1])), eps, cuts, vertices,
        )  # fmt: skip

    @cached_property
    def lags(self) -> int:
        """So many that their intervals span some time constants, within effort and size."""
        N, level = len(self.scale), self.question.level
        wanted = max(_USUAL, int(np.ceil(_MEMORY / -np.log(max(self.sized.radius, 1e-6)))))
        return max(_FEWEST, min(wanted, _LAGS[level], _MOST[level] // ((2 * _DEGREE + 1) * (N * (N + 1) // 2)) - 1))

    def _rhos(self) -> Iterator[Fraction]:
        left = 1 - self.sized.radius
        return (1 - Fraction(decimal_text(left * (1 - share), _RHO_DIGITS)) for share in _SHARES)

    @cached_property
    def _turn(self) -> float:
        """|(A T)^2|^(1/2) at the worst corner."""
        return float(np.sqrt(max(np.linalg.norm(A @ A, 2) for A in islice(self.maps.corners(), _CORNERS))))

    def _shapes(self, window: tuple[Fraction, Fraction]) -> tuple[Shape, Shape]:
        """As many pieces as the flow needs and effort and size allow, shared out by length."""
        law, N, level = self.question.law, len(self.scale), self.question.level
        most = (_MOST[level] // ((self.lags + 1) * (N * (N + 1) // 2)) - 1) // _DEGREE
        usual = (_DEGREE, _ELEVATED, min(_PIECES[level], max(2, most)))
        d, D, m = next((shape for limit, shape in _SLOW if self._turn <= limit), usual)

        def parted(share: float) -> Shape:
            if share in (0, 1):
                return Shape(d, D, m, 0) if share else Shape(d, D, 0, m)
            before = max(1, min(m - 1, round(m * share)))
            return Shape(d, D, before, max(1, m - before))

        return parted(float(window[0] / window[1])), parted(float(law.T_min) / float(law.T_max))

    def _written(self, found: Found, rho: Fraction, window: tuple[Fraction, Fraction]) -> Chain:
        """In the user's units."""
        T, (first, others) = float(self.question.law.T_max), self._shapes(window)
        d0, v0 = signal_sizes(self.question.inclusion)
        back, size = 1 / self.scale, float(self.scale[self.i]) ** 2
        return Chain(
            [fraction_text(end) for end in window], str(first.d), str(first.D),
            [[str(shape.before), str(shape.after)] for shape in (first, others)], fraction_text(rho),
            [[upper_texts(P * size * back * back[:, None], _DIGITS) for P in lag] for lag in found.P],
            [[_texts(piece * size / d0**2 / T) for piece in lag] for lag in found.mu],
            [_texts(nu * size / v0**2) for nu in found.nu],
        )  # fmt: skip


def _texts(values: Array) -> list[str]:
    return [decimal_text(float(value), _DIGITS) for value in values]
