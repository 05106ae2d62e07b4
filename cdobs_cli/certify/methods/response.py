"""How large errors stay, by what each signal does to the error of the middle slopes: of linear plants no more than what
it comes to.

With A the middle of the flow, J_k = I - K_k C at sample k and Phi(t, s) the error map from s to t,

    e(t) = sum_(t_k <= t) Phi(t, t_k+) K_k (v_k + w_k) + integral of Phi(t, s) (d + f)(s) ds,

where |f| <= F |e| and |w| <= G |e| are what slopes of the flow and of the outputs add, half of their widths at most. Of
L_ij, the most over t of the integral of |Phi_ij| (j a disturbance) or the sum of |(Phi K_k)_ij| (j a noise), and u_j,
the size of the signal,

    sup |e| <= L u + L [F; G] sup |e|,    so    sup |e| <= x    where    x >= L u + L [F; G] x,    rho(L [F; G]) < 1.

White signals, independent of what was before, add to L u the root of sum_k (Phi K_k R K_k' Phi')_ii + integral of
(Phi Q Phi')_ii ds, exact since Phi is known; by Minkowski's inequality the same x bounds the roots of mean squares.

Source: cdobs, error bounds; the gains are those of the L1 theory (Dahleh and Pearson, 1987)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from fractions import Fraction
from functools import cached_property, lru_cache
from math import ceil
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.linear import product
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.of_state import OfState, UnderBounded, UnderWhite
from cdobs_cli.certify.methods.peak.state import number_of
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_LEFT = 0.03  # of an error, after the turns that are summed one by one
_CELLS = ((0.05, 6000), (0.1, 6000), (0.25, 30000))  # of the time in which a state changes by its size, and most steps
_CLOSE = 2


@dataclass(frozen=True)
class Response(OfState, Method):
    """It holds the number of the state only: the proof sums the response in balls. Loads no solver."""

    state: str

    source: ClassVar[str] = "response of the error to each signal"
    how: ClassVar[str] = "sums of the response in balls"
    nonlinear_outputs: ClassVar[bool] = True
    multirate: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        """Of sensors with periods of their own: chains of quadratic functions say as much of one period for all."""
        known = question.law.is_multirate and question.inclusion.assemble_noise is not None
        return known and question.start is None and cls.is_about(question.plant)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        if question.state is None or not cls.applies(question):
            return None
        response = cls(question.law, str(question.state))
        return response if response.prove(question).holds else None

    @classmethod
    def error_guess(cls, question: Question) -> float | None:
        one = cls.propose(question)
        error = None if one is None else one.prove(question).error
        return None if error is None else float(error)

    def _prove(self, question: Question) -> Proof:
        i = number_of(self.state, question.plant)
        sizes = error_sizes(question.inclusion) if self.applies(question) else None
        return NOTHING if sizes is None else Proof(True, error=sizes.bounds[i])


@dataclass(frozen=True)
class PeakResponse(UnderBounded, Response):
    """Of bounded disturbance and noise."""

    name: ClassVar[str] = "peak_response"


@dataclass(frozen=True)
class MeanSquareResponse(UnderWhite, Response):
    """Where one of disturbance and noise is white, or both."""

    name: ClassVar[str] = "mean_square_response"


class Sizes(NamedTuple):
    """Upper ends of sup |e_i|, or of the root of sup E e_i^2, in the long run and at all times from e = 0; and of the
    same at the middle slopes."""

    bounds: tuple[arb, ...]
    at_middle: tuple[arb, ...]

    @property
    def are_close(self) -> bool:
        """Whether slopes add little: quadratic functions would hardly say more."""
        return all(one <= free * _CLOSE for one, free in zip(self.bounds, self.at_middle, strict=True))


def error_sizes(inclusion: HybridInclusion) -> Sizes | None:
    """None where errors of the middle slopes do not decay, slopes vary too much about it, or sums are too long."""
    gain = tuple(sorted(inclusion.gain.items()))
    return _error_sizes(inclusion.assemble, inclusion.assemble_noise, inclusion.plant, inclusion.sampling, gain)


@lru_cache(maxsize=16)
def _error_sizes(
    assemble: Any, assemble_noise: Any, plant: Plant, law: SamplingLaw, gain: tuple[tuple[str, ExactMatrix], ...]
) -> Sizes | None:
    """Every state's bound comes of one sum: it is taken once."""
    inclusion = HybridInclusion(assemble, plant, dict(gain), law, plant.slopes.quantities, assemble_noise)
    for cell, steps in _CELLS:
        loop = Loop.of(inclusion, cell, steps)
        turns = None if loop is None else loop.turns(steps)
        if loop is not None and turns is not None:
            return _closed(loop, turns)
    return None


def _closed(loop: Loop, turns: int) -> Sizes | None:
    """What slopes add is at most what the error itself brings about."""
    most = loop.most(turns)
    inverse = None if most is None else _inverse(most[1] @ loop.slack)
    if most is None or inverse is None:
        return None
    x, free = inverse @ _column(most[0]), tuple(one.abs_upper() for one in most[0])
    bounds = tuple(arb(x[i, 0]).abs_upper() for i in range(len(free)))
    return Sizes(bounds, free) if all(one.is_finite() for one in bounds) else None


def _inverse(M: Matrix) -> Matrix | None:
    """(I - M)^-1 of M >= 0, which is >= 0 too; None where rho(M) < 1 is not shown: M y < y for some y > 0."""
    n = M.shape[0]
    try:
        inverse = (Matrix.identity(n) - M).inverse()
    except ZeroDivisionError:
        return None
    y = inverse @ Matrix.from_rows([[1]] * n)
    if not all(y[i, 0] > 0 for i in range(n)):
        return None
    return inverse


class Cell(NamedTuple):
    """The flow over a part of a gap, h long: exp(A h), exp(A h / 2), the integral of exp(A s); at most how far exp(A s)
    is from I, |s| <= h / 2; at most |exp(A s)|, 0 <= s <= h; the integral of exp(A s) Q exp(A's)."""

    h: Any
    whole: Matrix
    half: Matrix
    integral: Matrix
    apart: Matrix
    within: Matrix
    white: Matrix | None

    @staticmethod
    def of(A: Matrix, h: Any, Q: Matrix | None) -> Cell:
        n = A.shape[0]
        zero, one = Matrix.zeros(n, n), Matrix.identity(n)
        over = arb(0).union(arb(h))
        about = (-arb(h) / 2).union(arb(h) / 2)
        integral = block([[A, one], [zero, zero]]).exp(h)[:n, n:]
        white = None
        if Q is not None:
            pair = block([[-A, Q], [zero, A.T]]).exp(h)
            white = pair[n:, n:].T @ pair[:n, n:]
        return Cell(h, A.exp(h), A.exp(h / 2), integral, _sizes(A.exp(about) - one), _sizes(A.exp(over)), white)

    def across(self, R: Matrix) -> Matrix:
        """At most the integral of |R exp(A s)| over the cell: where an entry keeps its sign, that of R exp(A s)."""
        n = R.shape[1]
        middle = R @ self.half
        apart, kept = (_sizes(middle) @ self.apart).tolist(), (R @ self.integral).tolist()
        rows = [
            [
                abs(kept[i][j]) if abs(value) >= apart[i][j] else (abs(value) + apart[i][j]) * self.h
                for j, value in enumerate(row)
            ]
            for i, row in enumerate(middle.balls().tolist())
        ]
        return Matrix.from_rows(rows) if n else R


def _sizes(M: Matrix) -> Matrix:
    """|M|, entry by entry, at most."""
    return Matrix.from_rows([[arb(value).abs_upper() for value in row] for row in M.tolist()])


@dataclass
class Summed:
    """Of rows R at some time: of each row the response to disturbances and noises, (rows, n + p), and the variance
    under white signals; where the rows are then."""

    response: Matrix
    variance: list[arb]
    rest: Matrix


@dataclass(frozen=True)
class Loop:
    """The error of the middle slopes over a hyperperiod, in balls: flow A, at sample q the jump and the kick; R and Q
    of white signals, sizes of bounded ones; slack: [F; G], (n + p, n)."""

    A: Matrix
    jumps: list[Matrix]
    kicks: list[Matrix]
    gaps: tuple[Fraction, ...]
    cells: tuple[int, ...]
    cell: Mapping[Fraction, Cell]
    R: Matrix | None
    Q: Matrix | None
    sizes: list[Any]
    slack: Matrix
    _stride: dict[Fraction, tuple[int, Cell]] = field(default_factory=dict)

    @staticmethod
    def of(inclusion: HybridInclusion, width: float, steps: int) -> Loop | None:
        """None where the error has more states than the plant, or the flow is too fast for so many steps."""
        plant, law, maps = inclusion.plant, inclusion.sampling, inclusion.phases_balls
        noise, first = inclusion.phases_noise_balls, maps[0]
        if first.base.shape[0] != plant.n:
            return None
        A, F = first.base, Matrix.zeros(plant.n, plant.n)
        for part, low, high in zip(first.parts, first.lower, first.upper, strict=True):
            A, F = A + part * ((low + high) / 2), F + _sizes(part) * ((high - low) / 2)
        view, G = inclusion.view_balls, Matrix.zeros(plant.p, plant.n)
        for part, low, high in zip(view.outputs, view.output_lower, view.output_upper, strict=True):
            G = G + _sizes(part) * ((high - low) / 2)
        size = np.abs(A.floats)
        pace = float(spectral_radii(size[None])[0])
        if not np.isfinite(pace) or pace * float(law.T_max) / width > steps:
            return None
        cells = tuple(max(1, ceil(pace * float(gap) / width)) for gap in law.gaps)
        gaps = tuple(phase.gap for phase in law.phases)
        Q = None if plant.intensity is None else plant.intensity.balls()
        times = {share: (gap.scalar, count) for share, gap, count in zip(gaps, law.gaps, cells, strict=True)}
        cell = {share: Cell.of(A, gap / count, Q) for share, (gap, count) in times.items()}
        return Loop(
            A, [one.jump for one in maps], [one.kick for one in noise], gaps, cells, cell,
            None if plant.covariance is None else plant.covariance.balls(), Q,
            [*_box_sizes(plant.disturbance, plant.n), *_box_sizes(plant.noise, plant.p)],
            Matrix.from_rows([*F.balls().tolist(), *G.balls().tolist()]),
        )  # fmt: skip

    def turns(self, steps: int) -> int | None:
        """Hyperperiods after which little is left of any error, by floats; None where there are too many."""
        n, once = self.A.shape[0], sum(self.cells) * sum(count for count, _ in map(self._strides, self.gaps))
        with np.errstate(all="ignore"):
            Phi = exponentials(np.array([self.A.floats * float(self._length(gap).mid()) for gap in self.gaps]))
            M = product(Phi, [jump.floats for jump in self.jumps])
            power, count = np.eye(n), 0
            while np.isfinite(power).all() and once * (count + 1) <= steps:
                power, count = power @ M, count + 1
                if spectral_radii(np.abs(power)[None])[0] <= _LEFT:
                    return count
        return None

    def most(self, turns: int) -> tuple[list[arb], Matrix] | None:
        """The largest L u (with the root of the variance) and L over a hyperperiod; None where what is left then is
        not shown to decay."""
        n, p = self.A.shape[0], self.kicks[0].shape[1]
        free, L = [arb(0)] * n, [[arb(0)] * (n + p) for _ in range(n)]
        for q in range(len(self.gaps)):
            at_sample = self._summed(Matrix.identity(n), q, turns)
            inverse = _inverse(_sizes(at_sample.rest))
            if inverse is None:
                return None
            tail = inverse @ at_sample.response, inverse @ _column(one.sqrt() for one in at_sample.variance)
            for own, response in self._within(q, turns, at_sample, tail):
                free = [most.max(one) for most, one in zip(free, own, strict=True)]
                L = [[a.max(b) for a, b in zip(*rows, strict=True)] for rows in zip(L, response.tolist(), strict=True)]
        return free, Matrix.from_rows(L)

    def _within(
        self, q: int, turns: int, at_sample: Summed, tail: tuple[Matrix, Matrix]
    ) -> Iterator[tuple[list[arb], Matrix]]:
        """Of each cell after sample q the largest L u (with the root of the variance) and L."""
        n, cell = self.A.shape[0], self.cell[self.gaps[q]]
        R, since = (
            Matrix.identity(n).balls(),
            Summed(Matrix.zeros(n, self.slack.shape[0]), [arb(0)] * n, at_sample.rest),
        )
        for k in range(self.cells[q]):
            own = at_sample if k == 0 else self._summed(R, q, turns)
            left = _sizes(own.rest)
            beyond = (left @ tail[1]).tolist()
            response = own.response + left @ tail[0] + since.response
            spread = [
                (a + b + row[0] ** 2).abs_upper().sqrt()
                for a, b, row in zip(own.variance, since.variance, beyond, strict=True)
            ]
            yield self._free(cell, response, spread), self._moved(cell, response)
            since = self._through(cell, R, since)
            R = R @ cell.whole

    def _moved(self, cell: Cell, response: Matrix) -> Matrix:
        n = self.A.shape[0]
        new = (cell.within * cell.h).tolist()
        rows = (cell.within @ response).tolist()
        return Matrix.from_rows(
            [[arb(x) + (new[i][j] if j < n else 0) for j, x in enumerate(rows[i])] for i in range(n)]
        )

    def _free(self, cell: Cell, response: Matrix, spread: list[arb]) -> list[arb]:
        """The largest L u over a cell, from what it is at its beginning, with the root of the variance: what white
        disturbances add since then is independent of it, and grows all along."""
        n = self.A.shape[0]
        bounded = cell.within @ (response @ _column(self.sizes) + _column(self.sizes[:n]) * cell.h)
        carried = cell.within @ _column(spread)
        white = [arb(0) if cell.white is None else arb(cell.white[i, i]) for i in range(n)]
        return [arb(bounded[i, 0]) + (arb(carried[i, 0]) ** 2 + white[i]).abs_upper().sqrt() for i in range(n)]

    def _through(self, cell: Cell, R: Matrix, since: Summed) -> Summed:
        """With what acts over one cell more, through rows R at its end."""
        p = self.kicks[0].shape[1]
        across = block([[cell.across(R), Matrix.zeros(R.shape[0], p).balls()]])
        variance = since.variance if cell.white is None else _with_diagonal(since.variance, R, cell.white)
        return Summed(since.response + across, variance, since.rest)

    def _summed(self, R: Matrix, q: int, turns: int) -> Summed:
        """Through rows R just after sample q, so many hyperperiods back."""
        n, count = self.A.shape[0], len(self.gaps)
        disturbed, noisy = Matrix.zeros(R.shape[0], n).balls(), Matrix.zeros(R.shape[0], self.kicks[0].shape[1]).balls()
        variance = [arb(0)] * R.shape[0]
        for k in range(turns * count):
            at = (q - k) % count
            kick = R @ self.kicks[at]
            noisy = noisy + _sizes(kick)
            if self.R is not None:
                variance = _with_diagonal(variance, kick, self.R)
            R, (steps, cell) = R @ self.jumps[at], self._strides(self.gaps[at - 1])
            for _ in range(steps):
                if self.is_disturbed:
                    disturbed = disturbed + cell.across(R)
                if cell.white is not None:
                    variance = _with_diagonal(variance, R, cell.white)
                R = R @ cell.whole
        return Summed(block([[disturbed, noisy]]), variance, R)

    @cached_property
    def is_disturbed(self) -> bool:
        """Whether bounded disturbances or slopes of the flow act."""
        n = self.A.shape[0]
        acting = [*self.sizes[:n], *(value for row in self.slack[:n, :].tolist() for value in row)]
        return not all(arb(one).is_zero() for one in acting)

    def _length(self, gap: Fraction) -> arb:
        return arb(self.cell[gap].h) * self.cells[self.gaps.index(gap)]

    def _strides(self, gap: Fraction) -> tuple[int, Cell]:
        """How a gap is crossed: cell by cell, or at once where nothing is to be integrated over it."""
        if gap not in self._stride:
            count = self.cells[self.gaps.index(gap)]
            self._stride[gap] = (
                (count, self.cell[gap]) if self.is_disturbed else (1, Cell.of(self.A, self.cell[gap].h * count, self.Q))
            )
        return self._stride[gap]


def _with_diagonal(variance: list[arb], R: Matrix, Q: Matrix) -> list[arb]:
    """With (R Q R')_ii added to each."""
    whole = (R @ Q @ R.T).tolist()
    return [total + arb(whole[i][i]).abs_upper() for i, total in enumerate(variance)]


def _column(values: Any) -> Matrix:
    return Matrix.from_rows([[arb(value)] for value in values])


def _box_sizes(box: Box | None, count: int) -> list[Any]:
    return [0] * count if box is None else list(box.sizes)
