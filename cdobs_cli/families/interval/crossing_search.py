"""Search in floats for a box of x(0) and a word of periods after which a bound crosses the state.

Two kinds of start: a large box of one state, beside which disturbance and noise vanish, and the state known exactly,
where they alone make the errors. From each, the words that come closest are followed, sample by sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.falsify import exponentials
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.interval.cone import both_sides
from cdobs_cli.families.interval.crossing import Crossing, refutes
from cdobs_cli.families.interval.design import box_widths
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.theorems import coordinates, error_flow, error_held
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

Array = NDArray[np.float64]
Bools = tuple[tuple[bool, ...], tuple[bool, ...]]

_SAMPLES = 5  # the longest word
_KEPT = 24  # words followed from one sample to the next
_PERIODS, _PHASES = 7, 32
_MOST_CORNERS = 64
_LARGEST_EXPONENT = 200.0
_ROUNDING = 1e-13  # of the largest error: a distance that small may be 0
_DIGITS = 12
_LARGEST_BOX = 1e12


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

    T: Array
    s: Array
    E: Array
    Gamma: Array
    E_x: Array
    Gamma_x: Array
    start: Array

    @staticmethod
    def of(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw) -> Maps | None:
        """None where floats overflow."""
        S = gain["S"].floats
        R = gain["S"].balls().inverse().floats
        z = coordinates(plant.A.floats, plant.C.floats, S, R, gain["L"].floats)
        M, N1, size = error_flow(z.Q0), error_held(z.Q1), 2 * plant.n
        low, high = float(law.T_min), float(law.T_max)
        T = np.unique(np.linspace(low if low > 0 else high / 100, high, _PERIODS))
        s = high * np.arange(1, _PHASES + 1) / _PHASES
        flow = np.block([[M, np.eye(size)], [np.zeros((size, 2 * size))]])
        if not (np.all(np.isfinite(flow)) and np.all(np.isfinite(N1))) or np.abs(flow).sum(axis=1).max() * high > _LARGEST_EXPONENT:
            return None
        at_T, at_s = exponentials(flow[None] * T[:, None, None]), exponentials(flow[None] * s[:, None, None])
        to_x = both_sides(R)
        E, E_s = (parts[:, :size, :size] + parts[:, :size, size:] @ N1 for parts in (at_T, at_s))
        return Maps(T, s, E, at_T[:, :size, size:], to_x @ E_s, to_x @ at_s[:, :size, size:], both_sides(S))


def find_crossing(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw, *, cut: bool) -> Witness | None:
    """A proved crossing under the law, from a large box or from disturbance and noise alone; None where none was
    found.

    Args:
        cut: whether measured rows of z are intersected with y at samples.
    """
    return crossing_from_box(plant, gain, law, cut=cut) or crossing_from_signals(plant, gain, law, cut=cut)


def crossing_from_box(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw, *, cut: bool) -> Witness | None:
    """A proved crossing from a box of one state, large enough for disturbance and noise not to matter."""
    maps = Maps.of(plant, gain, law)
    if maps is None:
        return None
    rows = measured_rows(plant.C.balls(), gain["S"].balls()) if cut else {}
    size, n = len(maps.start), plant.n
    # Beside a large box the noise is nothing: a cut leaves 0 of measured rows.
    left = np.array([0.0 if i % n in rows else np.inf for i in range(size)])
    alone = Corner(((False,) * n, (False,) * plant.p), np.zeros(size), left)
    for column in range(size):
        path = _follow(maps, maps.start[:, column], [alone])
        witness = None if path is None else _with_box(plant, gain, law, path, column, maps, cut=cut)
        if witness is not None:
            return witness
    return None


def crossing_from_signals(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw, *, cut: bool) -> Witness | None:
    """A proved crossing from a state known exactly, by disturbance and noise at the ends of their intervals."""
    maps = Maps.of(plant, gain, law)
    if maps is None:
        return None
    rows = measured_rows(plant.C.balls(), gain["S"].balls()) if cut else {}
    corners = _corners(plant, gain, {i: G.floats for i, G in rows.items()})
    if not any(corner.b.any() for corner in corners):
        return None
    path = _follow(maps, np.zeros(len(maps.start)), corners)
    return None if path is None else refutes(plant, gain, _crossing(plant, law, path, None, 0, maps), law, cut=cut)


def _corners(plant: Plant, gain: Mapping[str, ExactMatrix], rows: Mapping[int, Array]) -> list[Corner]:
    """Ends of the declared intervals: all of them, or all low and all high where they are too many."""
    n, p = plant.n, plant.p
    width_d, width_v = box_widths(plant.disturbance, n).ravel(), box_widths(plant.noise, p).ravel()
    of_d, of_v = both_sides(gain["S"].floats), both_sides(gain["S"].floats @ gain["L"].floats)
    free = [k for k, width in enumerate((*width_d, *width_v)) if width > 0]
    few = 2 ** len(free) <= _MOST_CORNERS
    choices = list(product((True, False), repeat=len(free))) if few else [(True,) * len(free), (False,) * len(free)]
    found = []
    for choice in choices:
        low = [False] * (n + p)
        for k, is_low in zip(free, choice, strict=True):
            low[k] = is_low
        low_d, low_v = np.array(low[:n], dtype=bool), np.array(low[n:], dtype=bool)
        above_d = np.concatenate([np.where(low_d, 0, width_d), np.where(low_d, width_d, 0)])
        below_v = np.concatenate([np.where(low_v, width_v, 0), np.where(low_v, 0, width_v)])
        left = np.full(2 * n, np.inf)
        for i, G in rows.items():
            left[[i, n + i]] = both_sides(G) @ below_v
        found.append(Corner((tuple(low[:n]), tuple(low[n:])), of_d @ above_d + of_v @ below_v, left))
    return found


@dataclass(frozen=True)
class Path:
    """Periods by index in `Maps.T`, a corner for each sample, the phase by index in `Maps.s`, the component."""

    periods: tuple[int, ...]
    corners: tuple[Corner, ...]
    phase: int
    component: int


def _follow(maps: Maps, start: Array, corners: list[Corner]) -> Path | None:
    """The first word found, shortest first, that makes a distance of x from its bounds negative."""
    states = start[:, None]
    words: list[tuple[tuple[int, ...], tuple[Corner, ...]]] = [((), ())]
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
                return Path(words[best][0], (*words[best][1], corner), int(phase), int(component))
            for k in range(len(maps.T)):
                after.append(maps.E[k] @ cut + (maps.Gamma[k] @ corner.b)[:, None])
                longer += [((*periods, k), (*held, corner)) for periods, held in words]
                scores.append(least)
        everything, score = np.concatenate(after, axis=1), np.concatenate(scores)
        kept = np.argsort(score, kind="stable")[: _KEPT * len(maps.T)]
        # Of the words that came close, those that differ: the same state twice says nothing new.
        scaled = everything[:, kept] / (np.abs(everything[:, kept]).max(axis=0) + 1e-300)
        chosen = kept[np.sort(np.unique(np.round(scaled, 7), axis=1, return_index=True)[1])]
        states, words = everything[:, chosen], [longer[k] for k in chosen]
    return None


def _crossing(plant: Plant, law: SamplingLaw, path: Path, column: int | None, size: int, maps: Maps) -> Crossing:
    """The path in exact numbers; column: which unit box it starts from, below or above x(0) = 0 in one state."""
    n = plant.n
    lower, upper = [Fraction(0)] * n, [Fraction(0)] * n
    if column is not None and column < n:
        lower[column] = -Fraction(size)
    elif column is not None:
        upper[column - n] = Fraction(size)
    low_d, low_v = zip(*(corner.low for corner in path.corners), strict=True)
    periods = tuple(_time(float(maps.T[k]), law) for k in path.periods)
    after = _time(float(maps.s[path.phase]), law)
    return Crossing(tuple(lower), tuple(upper), (Fraction(0),) * n, periods, after, low_d, low_v, path.component)


def _time(T: float, law: SamplingLaw) -> Exact:
    """A short decimal, or an end of the law as it is typed."""
    for end in (law.T_min, law.T_max):
        if abs(T - float(end)) <= 1e-12 * float(law.T_max):
            return end
    return Exact(decimal_text(T, _DIGITS))


def _with_box(
    plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw, path: Path, column: int, maps: Maps, *, cut: bool
) -> Witness | None:  # fmt: skip
    """The crossing with the smallest box of a few sizes beside which disturbance and noise do not matter."""
    size = 1
    while size <= _LARGEST_BOX:
        witness = refutes(plant, gain, _crossing(plant, law, path, column, size, maps), law, cut=cut)
        if witness is not None:
            return witness
        size *= 100
    return None
