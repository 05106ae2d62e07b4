"""No gain K = (K_1, K_2) serves a planar slope class at some constant period: the cell argument, in balls.

In the states of `planar`, with x = 1 - K_1, one period multiplies the error by M = J Phi, J = [[x, 0], [-K_2, 1]].
The word with the largest det Phi refutes |x| det Phi >= 1; the trace of one constant word then bounds K_2 on both
sides. What is left is a rectangle. It is cut into cells until on each of them one word of bang-bang maps has

    1 - tr + det <= 0,  or  1 + tr + det <= 0,  or  |det| >= 1      (Jury: rho >= 1)

for every (x, K_2) of the cell. Words are learned on the way: where no known one works at a cell's centre,
`switching` is asked for the worst V(t) there. A cell that no word refutes leaves the question open.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from functools import cached_property
from itertools import groupby, product
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np
from flint import arb, arb_mat

from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.planar.extremals import Planar, PlanarClass, planar_class, switching
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.switching import Proposal

M_ = TypeVar("M_", bound="CellsOfGains")

_CELLS = (1000, 4000, 8000, 16000)
_SEARCHES = (20, 80, 160, 320)
_SMALLEST = 1e-9
_BEYOND = (Fraction(1, 100_000), Fraction(1, 2000), Fraction(1, 100), Fraction(1, 10))
_RESISTS = -1
_THIN = 1 / 20  # of the rectangle: from here on, where the cells run out, each that is cut asks for words of its own

Arcs = tuple[tuple[Fraction, tuple[int, int]], ...]  # of one period: (length, which end v_1 and v_2 are at)
Cell = tuple[Fraction, Fraction, Fraction, Fraction]  # x from, to, K_2 from, to
_CUT = "-"
_MOST = 5  # powers of x: words have fewer periods
_LATEST = 2


@dataclass(frozen=True)
class CellsOfGains(Method):
    """words: each a list of periods, each of arcs [length, end of v_1, end of v_2] (0: lower, 1: upper). cells: in the
    order in which they are met, `-` where one is cut and else the number of the word that refutes it, with blanks
    between them."""

    words: list[list[list[list[Any]]]]
    cells: str

    name: ClassVar[str] = "cells_of_gains"
    rung: ClassVar[str] = "cells_of_gains"
    source: ClassVar[str] = Planar.source
    how: ClassVar[str] = "cells of gains in balls"
    reach: ClassVar[Reach] = "no gain"

    @property
    def sentence(self) -> str:
        cells, longest = self.cells.split(), max(map(len, self.words))
        return (
            f"Every gain K fails: on each of {len(cells) - cells.count(_CUT)} cells of gains one of {len(self.words)} "
            f"words of up to {longest} periods with extremal slopes has a spectral radius of at least 1"
        )

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        with np.errstate(all="ignore"):
            for thin in (0.0, _THIN):
                cells = _Cells.of(question)
                if cells is None:
                    return None
                cells.thin = thin
                met = cells.searched(cls, question.law)
                if met is not None or not cells.left:
                    return met
        return None

    @classmethod
    def just_above(cls, question: Question) -> Self | None:
        """At a constant period not far above the question's, best the largest at which some gain is proved: the first
        that is found of a few."""
        above = question.law.T_max.rational
        if above is None or above <= 0:
            return None
        proposals = (cls.propose(question.at(Exact(round_up(above * (1 + share), 7)))) for share in _BEYOND)
        return next((one for one in proposals if one is not None), None)

    def _prove(self, question: Question) -> Proof:
        cells = _Cells.of(question)
        if cells is None:
            return NOTHING
        words = [tuple(_read_arcs(arcs) for arcs in periods) for periods in self.words]
        return Proof.of(cells.are_refuted(words, self.cells.split()))


def _read_arcs(arcs: list[list[Any]]) -> Arcs:
    """Raises: ValueError, TypeError on what was not written."""
    return tuple((Fraction(str(length)), (_end(first), _end(second))) for length, first, second in arcs)


def _end(number: Any) -> int:
    if type(number) is not int or number not in (0, 1):
        raise ValueError("an end is 0 or 1")
    return number


@dataclass(frozen=True)
class _Word:
    """Its periods, their maps Phi in balls, and in floats."""

    arcs: tuple[Arcs, ...]
    balls: tuple[Matrix, ...]
    floats: Array  # (W, 2, 2)

    @cached_property
    def _grown(self) -> list[arb]:
        """The determinants of its maps."""
        return [arb(Phi.data.det()) for Phi in self.balls]

    def refutes(self, x: arb, K_2: arb) -> bool:
        """Whether rho >= 1 is proved for all (x, K_2) of the balls."""
        M = Matrix.identity(2)
        det = arb(1)
        J = Matrix(arb_mat(2, 2, [x, 0, -K_2, 1]))
        for Phi, grown in zip(self.balls, self._grown, strict=True):
            M = J @ (Phi @ M)
            det = det * x * grown
        trace = M[0, 0] + M[1, 1]
        return bool(1 - trace + det <= 0 or 1 + trace + det <= 0 or abs(det) >= 1)


def _traces(words: Array) -> Array:
    """tr M as a polynomial in x and K_2: the coefficients of x^i K_2^j, (words, 25), of words (k, W, 2, 2), W <= 4."""
    M = np.zeros((len(words), _MOST, _MOST, 2, 2))
    M[:, 0, 0] = np.eye(2)
    for Phi in np.moveaxis(words, 1, 0):
        flown = Phi[:, None, None] @ M
        M = np.zeros_like(M)  # J = [[x, 0], [-K_2, 1]]
        M[:, :, :, 1] = flown[:, :, :, 1]
        M[:, 1:, :, 0] = flown[:, :-1, :, 0]
        M[:, :, 1:, 1] -= flown[:, :, :-1, 0]
    traces: Array = (M[..., 0, 0] + M[..., 1, 1]).reshape(len(words), -1)
    return traces


def _powers(x: Array, K_2: Array) -> Array:
    """x^i K_2^j, (25, points)."""
    order = np.arange(_MOST)
    powers = x ** order[:, None, None] * K_2 ** order[None, :, None]
    return powers.reshape(-1, len(x))


class _Cells:
    def __init__(self, family: PlanarClass, delta: Fraction, level: int) -> None:
        self.family, self.delta, self.level = family, delta, level
        self.words: list[_Word] = []
        self.searches = 0
        self.traces, self.dets, self.lengths = np.empty((0, _MOST**2)), np.empty(0), np.empty(0, dtype=int)
        self.latest: list[int] = []  # the words that refuted the cells before, the last one first
        self.thin = 0.0
        self.left = False  # whether cells were left when their number ran out
        self.asked: set[tuple[int, int, int]] = set()
        self.maps: dict[Arcs, Matrix] = {}

    @staticmethod
    def of(question: Question) -> _Cells | None:
        """Of a planar class under a constant period, one state measured; whatever the question's gain."""
        planar, law = planar_class(question.inclusion), question.law
        delta, C = law.T_max.rational, question.plant.C
        if planar is None or delta is None or delta <= 0 or not law.is_periodic:
            return None
        if C.shape != (1, 2) or C[0, 0].sign() in (0, None) or C[0, 1].sign() != 0:
            return None
        return _Cells(planar[0], delta, question.level)

    def searched(self, kind: type[M_], law: SamplingLaw) -> M_ | None:
        rectangle = self._rectangle()
        if rectangle is None:
            return None
        self.rectangle = rectangle
        self.words += self._library()
        met: list[int] = []
        stack = [rectangle]
        while stack:
            if len(met) == _CELLS[self.level]:
                self.left = True
                return None
            cell = stack.pop()
            verdict = self._judge(*cell)
            if verdict is None:
                return None
            met.append(verdict)
            if verdict == _RESISTS:
                stack.extend(_halves(cell, rectangle))
        used = [0, *sorted({number for number in met if number > 0})]  # the first bounds the rectangle
        renumbered = {number: str(place) for place, number in enumerate(used)} | {_RESISTS: _CUT}
        words = [
            [[[str(length), *ends] for length, ends in arcs] for arcs in self.words[number].arcs] for number in used
        ]
        return kind(law, words, " ".join(renumbered[number] for number in met))

    def are_refuted(self, words: list[tuple[Arcs, ...]], cells: list[str]) -> bool:
        """Whether the words are of this class and period and refute the rectangle, cell by cell."""
        rectangle = self._rectangle()
        if rectangle is None or not all(periods and all(map(self._fills, periods)) for periods in words):
            return False
        self.words = [self._word(periods) for periods in words]
        stack = [rectangle]
        for text in cells:
            if not stack:
                return False
            cell = stack.pop()
            if text == _CUT:
                stack.extend(_halves(cell, rectangle))
            elif not (text.isdecimal() and self.words[int(text)].refutes(*_balls(cell))):
                return False
        return not stack

    def _rectangle(self) -> Cell | None:
        """(x low, x high, K_2 low, K_2 high) outside of which the two constant words refute."""
        top = self._word((((self.delta, (1, 1)),),))
        D = arb(top.balls[0].data.det())
        X = Fraction(float((1 / D).upper()) * (1 + 1e-9))
        if not fraction_ball(X) * D >= 1:
            return None
        Phi = top.balls[0]
        if not Phi[0, 1] > 0:
            return None
        lows, highs = [], []
        for x in (fraction_ball(-X), fraction_ball(X)):
            lows.append((Phi[1, 1] - 1 + x * (Phi[0, 0] - D)) / Phi[0, 1])
            highs.append((Phi[1, 1] + 1 + x * (Phi[0, 0] + D)) / Phi[0, 1])
        low = min(Fraction(float(value.lower())) for value in lows) - Fraction(1, 10**9)
        high = max(Fraction(float(value.upper())) for value in highs) + Fraction(1, 10**9)
        # Both lines lie inside: what is outside is refuted by the constant word, whatever x in [-X, X].
        if not all(fraction_ball(low) <= value for value in lows) or not all(
            fraction_ball(high) >= value for value in highs
        ):
            return None
        self.words.append(top)
        return -X, X, low, high

    def _fills(self, arcs: Arcs) -> bool:
        """Whether the arcs are one period: rounded switching times may fall outside of it."""
        return all(length >= 0 for length, _ in arcs) and sum((length for length, _ in arcs), Fraction(0)) == self.delta

    def _extremals(self) -> Iterator[Arcs]:
        """The two extremal maps for K_1 = 1, and the constant corners."""
        _, _, first, second = self.family.floats(float(self.delta)).gains()
        for s in (first, second):
            point = min(Fraction(decimal_text(s, 12)), self.delta)
            arcs = switching(self.family, 1, point, self.delta)
            made = tuple((length, (int(ends[0]), int(ends[1]))) for length, ends in arcs)
            if self._fills(made):
                yield made
        for ends in product((0, 1), repeat=2):
            yield ((self.delta, (ends[0], ends[1])),)

    def _library(self) -> list[_Word]:
        """All words of up to four periods over the extremal and the constant maps, one for each rotation."""
        letters = list(dict.fromkeys(self._extremals()))
        single = [self._word((arcs,)) for arcs in letters]
        words = []
        for count in range(1, _MOST):
            kept = {
                min(word[k:] + word[:k] for k in range(count)) for word in product(range(len(letters)), repeat=count)
            }
            for word in sorted(kept):
                balls = tuple(single[letter].balls[0] for letter in word)
                floats = np.array([single[letter].floats[0] for letter in word])
                words.append(_Word(tuple(letters[letter] for letter in word), balls, floats))
        return words

    def _word(self, periods: tuple[Arcs, ...]) -> _Word:
        for arcs in periods:
            if arcs not in self.maps:
                Phi = Matrix.identity(2)
                for length, ends in arcs:
                    v = [(self.family.lo, self.family.hi)[end][k] for k, end in enumerate(ends)]
                    Phi = Matrix.from_rows([[0, 1], v]).exp(length) @ Phi
                self.maps[arcs] = Phi.balls()
        maps = tuple(self.maps[arcs] for arcs in periods)
        return _Word(periods, maps, np.array([Phi.floats for Phi in maps]))

    def _reaches(self, x: Array, K_2: Array, words: Any = slice(None)) -> Array:
        """(words, points): how far max(|tr| - 1 - det, |det| - 1) is above 0, in floats; of these of the words."""
        fresh = self.words[len(self.traces) :]
        for _, together in groupby(fresh, lambda word: len(word.arcs)):
            self._count(np.array([word.floats for word in together]))
        trace = self.traces[words] @ _powers(x, K_2)
        det = self.dets[words, None] * x ** self.lengths[words, None]
        reach: Array = np.maximum(np.abs(trace) - 1 - det, np.abs(det) - 1)
        return reach

    def _count(self, words: Array) -> None:
        """Words of equal length, (k, W, 2, 2), beside those that `_reaches` knows."""
        self.traces = np.concatenate([self.traces, _traces(words)])
        self.dets = np.concatenate([self.dets, np.linalg.det(words).prod(axis=1)])
        self.lengths = np.concatenate([self.lengths, np.full(len(words), words.shape[1])])

    def _judge(self, x_low: Fraction, x_high: Fraction, K_low: Fraction, K_high: Fraction) -> int | None:
        """The number of the word that refutes the whole cell; _RESISTS: cut it; None: its centre resists."""
        centre = ((x_low + x_high) / 2, (K_low + K_high) / 2)
        xs = np.array([centre[0], x_low, x_low, x_high, x_high], dtype=float)
        Ks = np.array([centre[1], K_low, K_high, K_low, K_high], dtype=float)
        x, K_2 = _balls((x_low, x_high, K_low, K_high))
        share = float((x_high - x_low) / (self.rectangle[1] - self.rectangle[0]))
        near = self.latest
        for k, worst in zip(near, self._reaches(xs, Ks, near).min(axis=1) if near else (), strict=True):
            if worst > 0 and self.words[k].refutes(x, K_2):
                return k
        for _ in range(2):
            reach = self._reaches(xs, Ks)
            least, spread = reach.min(axis=1), np.ptp(reach, axis=1) + 1e-300
            # Long words react sharply: what counts is the reach against its change over the cell.
            kept = least / spread
            for W in range(1, _MOST):
                k = int(np.argmax(np.where(self.lengths == W, kept, -np.inf)))
                if least[k] > 0 and self.words[k].refutes(x, K_2):
                    self.latest = [k, *(one for one in self.latest if one != k)][:_LATEST]
                    return k
            if share < _SMALLEST:
                return None
            resists = not (reach[:, 0] > 0).any()
            if not resists and (share > self.thin or (reach[:, 0] / spread).max() > 0.25):
                return _RESISTS
            # Ask once for each place, of the size of the cell or somewhat larger.
            level = round(math.log2(1 / share)) // 2 if share < 1 else 0
            size = 4.0**-level
            place = (level, math.floor(xs[0] / size), math.floor(Ks[0] / size))
            if place in self.asked and not resists:
                return _RESISTS
            self.asked.add(place)
            if not self._learn(*centre):
                return None if resists else _RESISTS
        return _RESISTS

    def _learn(self, x: Fraction, K_2: Fraction) -> bool:
        """Ask for the worst V(t) at this gain, one to four periods long, and keep what defeats it."""
        self.searches += 1
        if self.searches > _SEARCHES[self.level]:
            return False
        family = self.family
        lo, hi = ([float(arb(value).mid()) for value in ends] for ends in (family.lo, family.hi))
        J = np.array([[float(x), 0.0], [-float(K_2), 1.0]])
        base = np.array([[0.0, 1.0], [0.0, 0.0]])
        parts = (np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 0.0], [0.0, 1.0]]))
        maps = ErrorMaps(base, parts, tuple(lo), tuple(hi), J)
        period = Exact(self.delta)
        from cdobs_cli.certify.switching import propose_for

        learned = False
        for count in range(1, _MOST):
            for proposal in propose_for([maps], [(period,) * count], 1)[:2]:
                if proposal.radius < 1:
                    continue
                periods = tuple(self._arcs(proposal, w) for w in range(count))
                if not all(self._fills(arcs) for arcs in periods):
                    continue
                word = self._word(periods)
                self.words.append(word)
                learned = learned or bool(self._reaches(np.array([float(x)]), np.array([float(K_2)]))[-1, 0] > 0)
        return learned

    def _arcs(self, proposal: Proposal, w: int) -> Arcs:
        arcs = proposal.arcs[w]
        lengths = [Fraction(decimal_text(length, 12)) for length, _ in arcs[:-1]]
        lengths.append(self.delta - sum(lengths, Fraction(0)))
        corners = (corner for _, corner in arcs)
        return tuple((length, (int(up[0]), int(up[1]))) for length, up in zip(lengths, corners, strict=True))


def _balls(cell: Cell) -> tuple[arb, arb]:
    """All x and all K_2 of a cell."""
    a, b, c, d = map(fraction_ball, cell)
    return a.union(b), c.union(d)


def _halves(cell: Cell, whole: Cell) -> list[Cell]:
    """The cell cut across its longer side, measured against the whole rectangle."""
    a, b, c, d = cell
    if (b - a) * (whole[3] - whole[2]) >= (d - c) * (whole[1] - whole[0]):
        middle = (a + b) / 2
        return [(a, middle, c, d), (middle, b, c, d)]
    middle = (c + d) / 2
    return [(a, b, c, middle), (a, b, middle, d)]


def round_up(value: Fraction, digits: int) -> Fraction:
    """The next decimal with so many significant digits."""
    places = digits - 1 - math.floor(math.log10(float(value)))
    return Fraction(math.ceil(value * Fraction(10) ** places)) / Fraction(10) ** places
