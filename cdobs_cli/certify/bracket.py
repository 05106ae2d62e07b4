"""The refuted end of a period bracket: the smallest period refuted above what is proved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certificate import Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.linear import is_linear, lost_above
from cdobs_cli.certify.words import Word, prove
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.sampling import SamplingLaw, share_of

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_GROWTH = (1.3, 1.15, 1.07, 1.03)  # by effort: the step of the scan for a first refutation
_FAST = 1.3  # the same step where nothing is left out by it
_LEAST = 0.5  # of a period: how far a word is shrunk
_WIDTH = 4e-6  # relative width down to which the first refutation is pressed


def smallest_refuted(
    at: Callable[[Exact], HybridInclusion], proved: Exact | None, effort: int
) -> tuple[Exact, Witness] | None:
    """The smallest period found above `proved` with a proved refutation, and its witness.

    Args:
        at: the inclusion with its sampling law at a given period (or largest period).
        proved: where to start; None starts far below the fastest time constant of the error flow.
        effort: 0..3, finer steps and a stronger search at each period.
    """
    start = float(proved) if proved is not None else _fast_time(at)
    one = at(Exact(1))
    law, phases = one.sampling, one.phases_floats
    # A law of an interval of periods grows with its longest: what is refuted stays refuted.
    growth = _FAST if law.is_bounded and not law.multiples else _GROWTH[max(0, min(effort, 3))]
    if law.is_multirate and is_linear(one):  # stability may be lost and regained within a step of the scan
        for T in lost_above(at(search.short(start)), start):
            met_there = refute(at(T), effort)
            if met_there is not None:
                return T, met_there
    met: list[tuple[Word, Exact]] = []

    def refuted(T: Exact) -> Witness | None:
        """By the last word met, in proportion, or by one that is looked for."""
        inclusion = at(T)
        word = _at_period(*met[-1], inclusion.sampling) if met else None
        multiplier = None if word is None else prove(inclusion, word)
        witness = (
            refute(inclusion, effort) if word is None or multiplier is None else word.witness(inclusion, multiplier)
        )
        if witness is not None:
            met.append((Word.from_witness(witness), T))
        return witness

    def ends(witness: Witness, T: float) -> float:
        with np.errstate(all="ignore"):
            return _shrunk(phases, Word.from_witness(witness), T, whole=law.has_sensors)

    return search.smallest(refuted, start, growth, _WIDTH, nearer=None if law.is_random else ends)


def _at_period(word: Word, T: Exact, law: SamplingLaw) -> Word | None:
    """A word in which those of its periods that are T long are the law's period long, their arcs in proportion; all of
    them where sensors have periods of their own. None where none is."""
    other = law.period
    share = float(other) / float(T)
    periods = []
    for k, period in enumerate(word.periods):
        total = sum(float(arc.length) for arc in period)
        if law.has_sensors or total > float(T) * (1 - _WIDTH):
            lengths = [search.short(float(arc.length) * share, 12) for arc in period[:-1]]
            # Several of them where samples were lost.
            last = law.gaps[k % len(law.phases)] if law.is_multirate else other * Exact(round(total / float(T)))
            if law.is_graph:
                of = [share_of(arc.length, T) for arc in period]
                if any(one is None for one in of):
                    return None
                last = other * Exact(sum((one for one in of if one is not None), Fraction(0)))
            for length in lengths:
                last = last - length
            period = tuple(replace(arc, length=length) for arc, length in zip(period, [*lengths, last], strict=True))
        periods.append(period)
    return replace(word, periods=tuple(periods)) if tuple(periods) != word.periods else None


def _shrunk(phases: Sequence[ErrorMaps[Array]], word: Word, T: float, *, whole: bool) -> float:
    """Down to which period, in floats, a word refutes when those of its periods that are T long (whole: all of them)
    shrink in proportion: by the maximum principle its switching times matter to second order only."""
    periods = [[float(arc.length) for arc in period] for period in word.periods]
    flows = [phases[0].flow(tuple(map(float, arc.values))) for period in word.periods for arc in period]
    unchanged = np.eye(phases[0].base.shape[0])
    jumps = [
        unchanged if maps is None else maps.jump_at(tuple(map(float, w)))
        for maps, (_, w) in zip(word.jumps(phases), word.samples, strict=True)
    ]

    def refutes(share: float) -> bool:
        shares = [share if whole or sum(one) > T * (1 - _WIDTH) else 1.0 for one in periods]
        lengths = [length * own for own, one in zip(shares, periods, strict=True) for length in one]
        steps = iter(exponentials(np.array(flows) * np.array(lengths)[:, None, None]))
        M = np.eye(phases[0].base.shape[0])
        for period, jump in zip(periods, jumps, strict=True):
            for _ in period:
                M = next(steps) @ M
            M = jump @ M
        return bool(spectral_radii(M[None])[0] >= 1)

    low, high = _LEAST, 1.0
    while high - low > _WIDTH / 8:
        share = (low + high) / 2
        low, high = (low, share) if refutes(share) else (share, high)
    return high * T


def _fast_time(at: Callable[[Exact], HybridInclusion]) -> float:
    """A thousandth of the fastest time constant of the flow at the corners."""
    maps = at(Exact(1)).floats
    spread = np.abs(maps.base)
    for part, low, high in zip(maps.parts, maps.lower, maps.upper, strict=True):
        spread = spread + np.abs(part) * max(abs(low), abs(high))
    size = float(np.linalg.norm(spread, 2)) if np.all(np.isfinite(spread)) else 0.0
    return 1e-3 / size if size > 0 else 1e-3
