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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certify.methods.planar.extremals import PlanarClass, planar_class, switching
from cdobs_cli.certify.switching import Proposal, propose_for
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_CELLS = (1000, 4000, 8000, 16000)
_SEARCHES = (20, 80, 160, 320)
_SMALLEST = 1e-9
_THIN = 1 / 20  # of the rectangle: from here on a cell that resists asks for words of its own

Arcs = tuple[tuple[Fraction, tuple[Any, Any]], ...]  # (length, (v_1, v_2)) of one period


@dataclass(frozen=True)
class Refutation:
    """How it was shown: the number of cells and of words used, and the longest word."""

    cells: int
    words: int
    longest: int


@dataclass(frozen=True)
class _Word:
    """The maps Phi of its periods in balls, and their product data in floats."""

    balls: tuple[Matrix, ...]
    floats: Array  # (W, 2, 2)

    def refutes(self, x: arb, K_2: arb) -> bool:
        """Whether rho >= 1 is proved for all (x, K_2) of the balls."""
        M = Matrix.identity(2)
        det = arb(1)
        J = Matrix.from_rows([[x, 0], [-K_2, 1]])
        for Phi in self.balls:
            M = J @ (Phi @ M)
            det = det * x * arb(Phi.data.det())
        trace = M[0, 0] + M[1, 1]
        return bool(1 - trace + det <= 0 or 1 + trace + det <= 0 or abs(det) >= 1)


def _reach(words: Array, x: Array, K_2: Array) -> Array:
    """(words, points): how far max(|tr| - 1 - det, |det| - 1) is above 0, in floats; words (k, W, 2, 2)."""
    import numpy as np

    J = np.zeros((len(x), 2, 2))
    J[:, 0, 0], J[:, 1, 0], J[:, 1, 1] = x, -K_2, 1.0
    M = np.broadcast_to(np.eye(2), (len(words), len(x), 2, 2))
    for period in range(words.shape[1]):
        M = J[None] @ (words[:, period, None] @ M)
    trace = M[..., 0, 0] + M[..., 1, 1]
    det = M[..., 0, 0] * M[..., 1, 1] - M[..., 0, 1] * M[..., 1, 0]
    reach: Array = np.maximum(np.abs(trace) - 1 - det, np.abs(det) - 1)
    return reach


def refute_every_gain(open_loop: HybridInclusion, effort: int) -> Refutation | None:
    """Prove that every K fails at the constant period of `open_loop`, whose jump is not read; None where that
    stays open. Loads no solver."""
    planar, delta = planar_class(open_loop), open_loop.sampling.T_max.rational
    if planar is None or delta is None or delta <= 0 or not open_loop.sampling.is_periodic:
        return None
    C = open_loop.plant.C
    if C.shape != (1, 2) or C[0, 0].sign() in (0, None) or C[0, 1].sign() != 0:
        return None
    import numpy as np

    with np.errstate(all="ignore"):
        return _Cells(planar[0], delta, max(0, min(effort, 3))).run()


class _Cells:
    def __init__(self, family: PlanarClass, delta: Fraction, level: int) -> None:
        self.family, self.delta, self.level = family, delta, level
        self.words: list[_Word] = []
        self.used: set[int] = set()
        self.searches = 0
        self._stacks: list[tuple[Any, Array]] = []
        self.asked: set[tuple[int, int, int]] = set()

    def run(self) -> Refutation | None:
        rectangle = self._rectangle()
        if rectangle is None:
            return None
        self.rectangle = rectangle
        self.words += self._library()
        stack = [rectangle]
        for cells in range(_CELLS[self.level]):
            if not stack:
                return Refutation(cells, len(self.used), max(len(self.words[k].balls) for k in self.used))
            cell = stack.pop()
            verdict = self._judge(*cell)
            if verdict is None:
                return None
            if not verdict:
                stack.extend(_halves(cell, rectangle))
        return None

    def _rectangle(self) -> tuple[Fraction, Fraction, Fraction, Fraction] | None:
        """(x low, x high, K_2 low, K_2 high) outside of which the two constant words refute."""
        hi = self.family.hi
        top = self._word((((self.delta, (hi[0], hi[1])),),))
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
        lo, hi = self.family.lo, self.family.hi
        _, _, first, second = self.family.floats(float(self.delta)).gains()
        for s in (first, second):
            point = min(Fraction(decimal_text(s, 12)), self.delta)
            arcs = switching(self.family, 1, point, self.delta)
            made = tuple((length, ((lo[0], hi[0])[ends[0]], (lo[1], hi[1])[ends[1]])) for length, ends in arcs)
            if self._fills(made):
                yield made
        for v_1 in (lo[0], hi[0]):
            for v_2 in (lo[1], hi[1]):
                yield ((self.delta, (v_1, v_2)),)

    def _library(self) -> list[_Word]:
        """All words of up to four periods over the extremal and the constant maps, one for each rotation."""
        import numpy as np

        letters = list(dict.fromkeys(self._extremals()))
        single = [self._word((arcs,)) for arcs in letters]
        words = []
        for count in range(1, 5):
            kept = {
                min(word[k:] + word[:k] for k in range(count)) for word in product(range(len(letters)), repeat=count)
            }
            for word in sorted(kept):
                balls = tuple(single[letter].balls[0] for letter in word)
                words.append(_Word(balls, np.array([single[letter].floats[0] for letter in word])))
        return words

    def _word(self, periods: tuple[Arcs, ...]) -> _Word:
        import numpy as np

        maps = []
        for arcs in periods:
            Phi = Matrix.identity(2)
            for length, v in arcs:
                Phi = Matrix.from_rows([[0, 1], list(v)]).exp(length) @ Phi
            maps.append(Phi.balls())
        return _Word(tuple(maps), np.array([Phi.floats for Phi in maps]))

    def _reaches(self, x: Array, K_2: Array) -> Array:
        """(words, points), in the order of `words`."""
        import numpy as np

        if sum(len(chosen) for chosen, _ in self._stacks) != len(self.words):
            lengths = np.array([len(word.balls) for word in self.words])
            groups = [np.flatnonzero(lengths == W) for W in np.unique(lengths)]
            self._stacks = [(chosen, np.array([self.words[k].floats for k in chosen])) for chosen in groups]
        reach = np.empty((len(self.words), len(x)))
        for chosen, stack in self._stacks:
            reach[chosen] = _reach(stack, x, K_2)
        return reach

    def _judge(self, x_low: Fraction, x_high: Fraction, K_low: Fraction, K_high: Fraction) -> bool | None:
        """True: refuted on the whole cell; False: cut it; None: its centre resists."""
        import numpy as np

        centre = ((x_low + x_high) / 2, (K_low + K_high) / 2)
        xs = np.array([centre[0], x_low, x_low, x_high, x_high], dtype=float)
        Ks = np.array([centre[1], K_low, K_high, K_low, K_high], dtype=float)
        x = fraction_ball(x_low).union(fraction_ball(x_high))
        K_2 = fraction_ball(K_low).union(fraction_ball(K_high))
        share = float((x_high - x_low) / (self.rectangle[1] - self.rectangle[0]))
        for _ in range(2):
            reach = self._reaches(xs, Ks)
            worst, spread = reach.min(axis=1), np.ptp(reach, axis=1) + 1e-300
            # Long words react sharply: what counts is the reach against its change over the cell.
            for chosen, _ in self._stacks:
                k = int(chosen[np.argmax(worst[chosen] / spread[chosen])])
                if worst[k] > 0 and self.words[k].refutes(x, K_2):
                    self.used.add(k)
                    return True
            if share < _SMALLEST:
                return None
            resists = not (reach[:, 0] > 0).any()
            if not resists and (share > _THIN or (reach[:, 0] / spread).max() > 0.25):
                return False
            # Ask once for each place, of the size of the cell or somewhat larger.
            level = round(math.log2(1 / share)) // 2 if share < 1 else 0
            size = 4.0**-level
            place = (level, math.floor(xs[0] / size), math.floor(Ks[0] / size))
            if place in self.asked and not resists:
                return False
            self.asked.add(place)
            if not self._learn(*centre):
                return None if resists else False
        return False

    def _learn(self, x: Fraction, K_2: Fraction) -> bool:
        """Ask for the worst V(t) at this gain, one to four periods long, and keep what defeats it."""
        import numpy as np

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
        learned = False
        for count in range(1, 5):
            for proposal in propose_for(maps, [(period,) * count], 1)[:2]:
                if proposal.radius < 1:
                    continue
                periods = tuple(self._arcs(proposal, w) for w in range(count))
                if not all(self._fills(arcs) for arcs in periods):
                    continue
                word = self._word(periods)
                if _reach(word.floats[None], np.array([float(x)]), np.array([float(K_2)]))[0, 0] > 0:
                    self.words.append(word)
                    learned = True
        return learned

    def _arcs(self, proposal: Proposal, w: int) -> Arcs:
        arcs = proposal.arcs[w]
        lengths = [Fraction(decimal_text(length, 12)) for length, _ in arcs[:-1]]
        lengths.append(self.delta - sum(lengths, Fraction(0)))
        ends = (self.family.lo, self.family.hi)
        return tuple(
            (length, (ends[corner[0]][0], ends[corner[1]][1]))
            for length, (_, corner) in zip(lengths, arcs, strict=True)
        )


def _halves(
    cell: tuple[Fraction, Fraction, Fraction, Fraction], whole: tuple[Fraction, Fraction, Fraction, Fraction]
) -> list[tuple[Fraction, Fraction, Fraction, Fraction]]:
    """The cell cut across its longer side, measured against the whole rectangle."""
    a, b, c, d = cell
    if (b - a) * (whole[3] - whole[2]) >= (d - c) * (whole[1] - whole[0]):
        middle = (a + b) / 2
        return [(a, middle, c, d), (middle, b, c, d)]
    middle = (c + d) / 2
    return [(a, b, c, middle), (a, b, middle, d)]


_BEYOND = (Fraction(1, 100_000), Fraction(1, 2000), Fraction(1, 100), Fraction(1, 10))


def period_lost_by_every_gain(
    at: Callable[[Exact], HybridInclusion], above: Exact, effort: int
) -> tuple[Exact, Refutation] | None:
    """A constant period not far above `above` at which every gain is proved to fail: the first that is found of a few.

    Args:
        at: the open loop with its sampling law at a given period.
        above: a period, best the largest at which some gain is proved.
    """
    if above.rational is None or above.rational <= 0:
        return None
    for share in _BEYOND:
        T = Exact(round_up(above.rational * (1 + share), 7))
        found = refute_every_gain(at(T), effort)
        if found is not None:
            return T, found
    return None


def round_up(value: Fraction, digits: int) -> Fraction:
    """The next decimal with so many significant digits."""
    places = digits - 1 - math.floor(math.log10(float(value)))
    return Fraction(math.ceil(value * Fraction(10) ** places)) / Fraction(10) ** places
