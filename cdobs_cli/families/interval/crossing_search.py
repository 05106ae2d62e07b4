"""Search in floats for a box of x(0) and a word of periods after which a bound crosses the state.

Two kinds of start: a large box of one state, beside which disturbance and noise vanish, and the state known exactly,
where they alone make the errors. From each, the words that come closest are followed, sample by sample.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.families.interval.crossing import Crossing, refutes
from cdobs_cli.families.interval.parts import both_sides
from cdobs_cli.families.interval.system import System
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

Bools = tuple[tuple[bool, ...], tuple[bool, ...]]

_SAMPLES = 5  # the longest word
_KEPT = 24  # words followed from one sample to the next
_PERIODS, _PHASES = 7, 32
_MOST_CORNERS = 64
_ROUNDING = 1e-13  # of the largest error: a distance that small may be 0
_DIGITS = 12
_BOXES = tuple(100**k for k in range(7))  # sizes of the box beside which disturbance and noise may not matter


@dataclass(frozen=True)
class Corner:
    """Disturbance and noise at ends of their intervals, what they add to the flow of e (2n,), and what a cut at a
    sample leaves of each entry of e (2n,)."""

    low: Bools
    b: Array
    left: Array


@dataclass(frozen=True)
class Maps:
    """The errors in floats at some periods (T) and phases (s) of a law.

    E, Gamma: from one sample to the next, (periods, 2n, 2n); E_x, Gamma_x: to the distances of x from its bounds,
    (phases, 2n, 2n); start: columns of the errors that unit boxes start.
    """

    T: tuple[Exact, ...]
    s: tuple[Exact, ...]
    E: Array
    Gamma: Array
    E_x: Array
    Gamma_x: Array
    start: Array

    @staticmethod
    def of(system: System, law: SamplingLaw) -> Maps | None:
        """None where floats overflow."""
        low, high = float(law.T_min), float(law.T_max)
        T = np.unique(np.linspace(low if low > 0 else high / 100, high, _PERIODS))
        s = high * np.arange(1, _PHASES + 1) / _PHASES
        at_T, at_s, to_x = system.errors.maps(T), system.errors.maps(s), both_sides(system.z.R.floats)
        if at_T is None or at_s is None:
            return None
        periods, phases = (tuple(_time(float(time), law) for time in times) for times in (T, s))
        return Maps(periods, phases, *at_T, to_x @ at_s[0], to_x @ at_s[1], system.errors.start.floats)


def find_crossing(system: System, law: SamplingLaw) -> Witness | None:
    """A proved crossing under the law, from a large box or from disturbance and noise alone; None where none was
    found."""
    return crossing_from_box(system, law) or crossing_from_signals(system, law)


def crossing_from_box(system: System, law: SamplingLaw) -> Witness | None:
    """A proved crossing from a box of one state, the smallest of a few sizes beside which disturbance and noise do not
    matter."""
    maps = Maps.of(system, law)
    if maps is None:
        return None
    size, n = len(maps.start), system.n
    # Beside a large box the noise is nothing: a cut leaves 0 of measured rows.
    left = np.array([0.0 if i % n in system.cut_rows else np.inf for i in range(size)])
    alone = Corner(((False,) * n, (False,) * system.plant.p), np.zeros(size), left)
    for start in range(size):
        crossing = _follow(maps, maps.start[:, start], [alone])
        for width in _BOXES if crossing is not None else ():
            assert crossing is not None
            box = tuple(Fraction(width * (k == start)) for k in range(size))
            wider = replace(crossing, lower=tuple(-value for value in box[:n]), upper=box[n:])
            witness = refutes(system, wider, law)
            if witness is not None:
                return witness
    return None


def crossing_from_signals(system: System, law: SamplingLaw) -> Witness | None:
    """A proved crossing from a state known exactly, by disturbance and noise at the ends of their intervals."""
    maps, corners = Maps.of(system, law), _corners(system)
    if maps is None or not any(corner.b.any() for corner in corners):
        return None
    crossing = _follow(maps, np.zeros(len(maps.start)), corners)
    return None if crossing is None else refutes(system, crossing, law)


def _corners(system: System) -> list[Corner]:
    """Ends of the declared intervals: all of them, or all low and all high where they are too many."""
    n, p = system.n, system.plant.p
    width_d, width_v = (width.floats.ravel() for width in system.widths)
    of_d, of_v = system.errors.start.floats, both_sides(system.floats.SL)
    free = [k for k, width in enumerate((*width_d, *width_v)) if width > 0]
    few = 2 ** len(free) <= _MOST_CORNERS
    corners = []
    for choice in product((True, False), repeat=len(free)) if few else ((True,) * len(free), (False,) * len(free)):
        low = np.zeros(n + p, dtype=bool)
        low[free] = choice
        low_d, low_v = low[:n], low[n:]
        above_d = np.concatenate([np.where(low_d, 0, width_d), np.where(low_d, width_d, 0)])
        below_v = np.concatenate([np.where(low_v, width_v, 0), np.where(low_v, 0, width_v)])
        left = np.full(2 * n, np.inf)
        for i, G in system.cut_rows.items():
            left[[i, n + i]] = both_sides(G.floats) @ below_v
        corners.append(Corner((tuple(low_d.tolist()), tuple(low_v.tolist())), of_d @ above_d + of_v @ below_v, left))
    return corners


def _follow(maps: Maps, start: Array, corners: list[Corner]) -> Crossing | None:
    """The first word found, shortest first, that makes a distance of x from its bounds negative; x(0) = 0 is known."""
    states, known = start[:, None], (Fraction(0),) * (len(start) // 2)
    words: list[tuple[tuple[Exact, ...], tuple[Corner, ...]]] = [((), ())]
    for _ in range(_SAMPLES):
        after, longer, scores = [], [], []
        for corner in corners:
            cut = np.minimum(states, corner.left[:, None])
            distance = maps.E_x @ cut + (maps.Gamma_x @ corner.b)[:, :, None]  # (phases, components, words)
            size = np.abs(distance).max(axis=(0, 1)) + 1e-300
            relative = distance / size
            least = relative.min(axis=(0, 1))
            best = int(np.argmin(least))
            if least[best] < -_ROUNDING:
                phase, component = np.unravel_index(int(np.argmin(relative[:, :, best])), relative.shape[:2])
                low_d, low_v = zip(*(one.low for one in (*words[best][1], corner)), strict=True)
                return Crossing(known, known, known, words[best][0], maps.s[phase], low_d, low_v, int(component))
            for k, T in enumerate(maps.T):
                after.append(maps.E[k] @ cut + (maps.Gamma[k] @ corner.b)[:, None])
                longer += [((*periods, T), (*held, corner)) for periods, held in words]
                scores.append(least)
        everything, score = np.concatenate(after, axis=1), np.concatenate(scores)
        kept = np.argsort(score, kind="stable")[: _KEPT * len(maps.T)]
        # Of the words that came close, those that differ: the same state twice says nothing new.
        scaled = everything[:, kept] / (np.abs(everything[:, kept]).max(axis=0) + 1e-300)
        chosen = kept[np.sort(np.unique(np.round(scaled, 7), axis=1, return_index=True)[1])]
        states, words = everything[:, chosen], [longer[k] for k in chosen]
    return None


def _time(T: float, law: SamplingLaw) -> Exact:
    """A short decimal, or an end of the law as it is typed."""
    for end in (law.T_min, law.T_max):
        if abs(T - float(end)) <= 1e-12 * float(law.T_max):
            return end
    return Exact(decimal_text(T, _DIGITS))
