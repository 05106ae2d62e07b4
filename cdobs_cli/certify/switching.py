"""The search for switching counterexamples, in floats: which V(t), at corners of the slope box, makes rho(M) largest.

By the maximum principle an extremal V(t) is bang-bang: with e the error along the leading eigenvector and p
the costate along the left one, v_k follows the sign of p' parts_k e; so do, at each sample, slopes of the outputs
that vary. Starting from some V on a grid of slots, that rule is applied again and again (policy iteration); arcs of
equal slopes are then merged and their lengths refined. What comes out is only proposed: `words.prove` decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate, product
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.ascent import highest
from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.walks import Walk, walks
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_SLOTS = (0, 12, 20, 32)  # slots a period, by effort
_PERIODS = (0, 2, 3, 4)  # longest words, by effort
_STARTS = (0, 4, 8, 16)
_FEWEST = 4  # slots a period, of a long hyperperiod
_WALKS = (0, 12, 24, 60)  # through a timed graph, by effort
_MULTIPLES = 4  # of a period whose samples may be lost
_SWEEPS = 12
_PROMISING = 0.985  # a radius from which lengths are refined
_SIMPLE = 1e12  # how large a left eigenvector may be beside its right one


@dataclass(frozen=True)
class Proposal:
    """Arcs of a word: lengths as floats and corners (True: upper end) by period, the corner of the jump after each,
    what is read there, and the radius in floats."""

    radius: float
    periods: tuple[Exact, ...]
    arcs: tuple[tuple[tuple[float, tuple[bool, ...]], ...], ...]
    jumps: tuple[tuple[bool, ...], ...] = ()
    readings: tuple[int | None, ...] = ()


def propose(inclusion: HybridInclusion, effort: int) -> list[Proposal]:
    """Words of one to several sampling periods with the largest spectral radii met, best first."""
    level = max(0, min(effort, 3))
    phases = inclusion.phases_floats
    maps = phases[0]
    if level == 0 or not (maps.lower or maps.jump_lower):  # without slopes the periods alone are left: `period_words`
        return []
    if inclusion.sampling.is_graph:
        return _propose(phases, walks(inclusion.sampling)[: _WALKS[level]], level)
    return propose_for(phases, list(_period_words(inclusion, _PERIODS[level])), level)


def propose_for(phases: Sequence[ErrorMaps[Array]], words: list[tuple[Exact, ...]], level: int) -> list[Proposal]:
    """The same for maps in floats, those of samples in turn, and given sampling periods of each word."""
    in_turn = [tuple(k % len(phases) for k in range(1, len(word) + 1)) for word in words]
    return _propose(phases, list(map(Walk, words, in_turn)), level)


def _propose(phases: Sequence[ErrorMaps[Array]], words: Sequence[Walk], level: int) -> list[Proposal]:
    longest = max((len(word.gaps) for word in words), default=1)
    with np.errstate(all="ignore"):
        search = _Search(phases, max(_FEWEST, 2 * round(_SLOTS[level] / min(longest, len(phases)) / 2)))
        found = [proposal for word in words for proposal in search.word(word, _STARTS[level])]
    return sorted(found, key=lambda proposal: -proposal.radius)


def _period_words(inclusion: HybridInclusion, longest: int) -> Iterator[tuple[Exact, ...]]:
    """Sampling periods of the words: all equal under a periodic law, mixed under an interval."""
    law = inclusion.sampling
    if law.is_multirate:
        yield from (law.gaps * count for count in range(1, longest + 1))
        return
    T, low = law.T_max, law.T_min
    if T.sign() != 1:
        return
    if low == T:
        for count in range(1, longest + 1):
            yield (T,) * count
        return
    choices = [T]
    if law.is_lossy:
        choices = list(law.multiples[::-1])[:_MULTIPLES]
    elif low.sign() == 1:
        choices.append(low)
    if T.rational is not None and low.rational is not None and not law.is_lossy:
        choices.append(Exact((T.rational + low.rational) / 2))
        if low.sign() == 0:
            choices.append(Exact(T.rational / 8))
    for count in range(1, longest + 1):
        words = {min(word[k:] + word[:k] for k in range(count)) for word in product(range(len(choices)), repeat=count)}
        for word in sorted(words)[: 6 * count]:
            yield tuple(choices[index] for index in word)


class _Search:
    """Policy iteration for one inclusion."""

    def __init__(self, phases: Sequence[ErrorMaps[Array]], slots: int) -> None:
        self.phases, self.slots = phases, slots
        self.maps = maps = phases[0]
        self.parts = np.array(maps.parts).reshape(-1, *maps.base.shape)  # (k, N, N)
        self.lower, self.upper = np.array(maps.lower, dtype=float), np.array(maps.upper, dtype=float)
        self.k, self.m = len(self.lower), len(maps.jump_lower)
        # (phases, m, N, N)
        parts = [np.array(one.jump_parts).reshape(-1, *maps.base.shape) for one in phases]
        # After them that of a step at whose end nothing arrives.
        self.jump_parts = np.array([*parts, np.zeros_like(parts[0])])
        self.jump_middles = np.array([*(one.jump for one in phases), np.eye(len(maps.base))])
        self.known: dict[tuple[bytes, float], Array] = {}
        self.half = (np.array(maps.jump_upper, dtype=float) - np.array(maps.jump_lower, dtype=float)) / 2

    def word(self, walk: Walk, starts: int) -> list[Proposal]:
        periods, W, slots = walk.gaps, len(walk.gaps), self.slots
        which = np.array([len(self.phases) if one is None else one for one in walk.readings])
        rng = np.random.default_rng(1000 * W + self.k)
        lengths = np.repeat([float(T) / slots for T in periods], slots)
        found: dict[bytes, Proposal] = {}
        for start in range(starts if self.k or self.m else 1):
            if start == 0:
                bits = np.ones((W * slots, self.k), dtype=bool)
            elif start == 1:
                bits = np.zeros((W * slots, self.k), dtype=bool)
            else:  # a few arcs, drawn once and for all
                bits = np.repeat(rng.random((W * 2, self.k)) < 0.5, slots // 2, axis=0)[: W * slots]
                bits = np.concatenate([bits, np.repeat(bits[-1:], W * slots - len(bits), axis=0)])
            at_jumps = rng.random((W, self.m)) < 0.5 if start > 1 else np.full((W, self.m), start == 0)
            radius, bits, at_jumps = self._improve(bits, at_jumps, lengths, which)
            key = bits.tobytes() + at_jumps.tobytes()
            if key in found or not np.isfinite(radius):
                continue
            arcs, jumps = self._merge(bits, lengths, W), tuple(tuple(map(bool, row)) for row in at_jumps)
            if _PROMISING <= radius < 1.05:
                radius, arcs = self._refine(radius, arcs, self._jumps(at_jumps, which))
            found[key] = Proposal(radius, periods, arcs, jumps, walk.readings)
        return sorted(found.values(), key=lambda proposal: -proposal.radius)[:2]

    def _jumps(self, at_jumps: Any, which: Any) -> Array:
        """The jump after each period, (W, N, N), of these readings."""
        deviations = np.where(at_jumps, self.half, -self.half)
        jumps: Array = self.jump_middles[which] + np.einsum("wm,wmij->wij", deviations, self.jump_parts[which])
        return jumps

    def _improve(self, bits: Any, at_jumps: Any, lengths: Array, which: Any) -> tuple[float, Any, Any]:
        size = bits.size

        def evaluate(flat: Any) -> tuple[float, Any]:
            return self._evaluate(flat[:size].reshape(bits.shape), flat[size:].reshape(at_jumps.shape), lengths, which)

        best = np.concatenate([bits.ravel(), at_jumps.ravel()])
        radius, gradient = evaluate(best)
        for _ in range(_SWEEPS):
            if gradient is None:
                break
            wanted = gradient > 0
            changed = wanted != best
            if not changed.any():
                break
            trial = wanted
            better, slope = evaluate(trial)
            if not better > radius:  # flip only what promises most
                worth = np.where(changed, np.abs(gradient), 0.0)
                limit = np.quantile(worth[changed], 0.75)
                trial = np.where(worth >= limit, wanted, best)
                better, slope = evaluate(trial)
                if not better > radius:
                    break
            radius, gradient, best = better, slope, trial
        return radius, best[:size].reshape(bits.shape), best[size:].reshape(at_jumps.shape)

    def _steps(self, bits: Any, lengths: Array) -> Array:
        """exp(flow length) of each slot, (slots, N, N); what was computed before is looked up."""
        keys = [(row.tobytes(), length) for row, length in zip(bits, lengths.tolist(), strict=True)]
        fresh = {key: slot for slot, key in enumerate(keys) if key not in self.known}
        if fresh:
            slots = list(fresh.values())
            E = exponentials(self._flows(bits[slots]) * lengths[slots, None, None])
            self.known.update(zip(fresh, E, strict=True))
        return np.array([self.known[key] for key in keys])

    def _flows(self, bits: Any) -> Array:
        flows: Array = self.maps.base + np.tensordot(np.where(bits, self.upper, self.lower), self.parts, 1)
        return flows

    def _evaluate(self, bits: Any, at_jumps: Any, lengths: Array, which: Any) -> tuple[float, Any]:
        """rho per period of the word, and d|lambda| / d v for each slot, then for each slope at each jump, flat (None
        where it makes no sense)."""
        W = len(which)
        ends = range(self.slots - 1, W * self.slots, self.slots)
        cycle = _cycle(self._steps(bits, lengths), self._jumps(at_jumps, which), ends)
        if cycle is None:
            return float("nan"), None
        radius = cycle.size ** (1 / W)
        if cycle.p is None:
            return radius, None
        middle_e, middle_p = (cycle.e + cycle.e_end) / 2, (cycle.p + cycle.p_end) / 2
        gradient = np.einsum("si,kij,sj->sk", middle_p, self.parts, middle_e)
        of_jumps = np.einsum("wi,wmij,wj->wm", cycle.p_jump, self.jump_parts[which], cycle.e_end[list(ends)])
        return radius, np.real(np.concatenate([gradient.ravel(), of_jumps.ravel()]))

    def _merge(self, bits: Any, lengths: Array, W: int) -> tuple[tuple[tuple[float, tuple[bool, ...]], ...], ...]:
        periods = []
        for w in range(W):
            arcs: list[tuple[float, tuple[bool, ...]]] = []
            for slot in range(w * self.slots, (w + 1) * self.slots):
                corner = tuple(bool(bit) for bit in bits[slot])
                if arcs and arcs[-1][1] == corner:
                    arcs[-1] = (arcs[-1][0] + float(lengths[slot]), corner)
                else:
                    arcs.append((float(lengths[slot]), corner))
            periods.append(tuple(arcs))
        return tuple(periods)

    def _refine(self, radius: float, arcs: Any, jumps: Array) -> tuple[float, Any]:
        """Moves the switching times, each by at most half of the arcs beside it, to where the radius is largest: with
        d|lambda| / d t = p' F e at the end of an arc."""
        flat = [arc for period in arcs for arc in period]
        lengths = np.array([length for length, _ in flat])
        flows = self._flows(np.array([corner for _, corner in flat], dtype=bool).reshape(len(flat), self.k))
        ends = [total - 1 for total in accumulate(len(period) for period in arcs)]
        inner = [s for s in range(len(flat)) if s not in ends]
        if not inner:
            return radius, arcs
        move = np.zeros((len(flat), len(inner)))  # of lengths with the switching times
        for column, s in enumerate(inner):
            move[s, column], move[s + 1, column] = 1.0, -1.0

        def ascent(shifts: Array) -> tuple[float, Array]:
            """ln |lambda| and its slope."""
            moved = lengths + move @ shifts
            cycle = _cycle(exponentials(flows * moved[:, None, None]), jumps, ends)
            if cycle is None or cycle.p is None or cycle.size == 0.0:
                return -np.inf, np.zeros(len(inner))
            by_length = np.real(np.einsum("si,sij,sj->s", cycle.p_end, flows, cycle.e_end))
            return float(np.log(cycle.size)), (by_length @ move) / cycle.size

        room = np.array([(-lengths[s] / 2.001, lengths[s + 1] / 2.001) for s in inner])
        best, shifts = highest(ascent, room, float(np.ptp(room, axis=1).min()) / 8)
        refined = float(np.exp(best / len(arcs)))
        if not refined > radius:
            return radius, arcs
        moved = iter((lengths + move @ shifts).tolist())
        return refined, tuple(tuple((next(moved), corner) for _, corner in period) for period in arcs)


@dataclass(frozen=True)
class _Cycle:
    """Along the eigenvectors of the leading eigenvalue lambda of a word's M: the error e at the beginning of each arc
    and e_end at its end, the costates p and p_end there and p_jump after each sample, (arcs or periods, N), such that
    d|lambda| = Re p_end' dE e. size: |lambda|. The costates are None where lambda is not simple."""

    size: float
    e: Any
    e_end: Any
    p: Any
    p_end: Any
    p_jump: Any


def _cycle(E: Array, jumps: Array, ends: Iterable[int]) -> _Cycle | None:
    """Of the arcs' maps E (arcs, N, N) and the jumps (periods, N, N) after the arcs `ends`; None where it overflows."""
    after = dict(zip(ends, jumps, strict=True))
    M = np.eye(E.shape[-1])
    for s, step in enumerate(E):
        M = step @ M
        if s in after:
            M = after[s] @ M
    if not np.all(np.isfinite(M)):
        return None
    values, vectors = np.linalg.eig(M)
    top = int(np.argmax(np.abs(values)))
    size = float(np.abs(values[top]))
    x = vectors[:, top]
    try:
        p = np.linalg.inv(vectors)[top] * (np.conj(values[top]) / size)
    except (np.linalg.LinAlgError, ZeroDivisionError):
        return _Cycle(size, None, None, None, None, None)
    if size == 0.0 or not np.abs(p).max() < _SIMPLE:
        return _Cycle(size, None, None, None, None, None)
    e, e_end = np.empty((len(E), len(x)), complex), np.empty((len(E), len(x)), complex)
    p_start, p_end, p_jump = np.empty_like(e), np.empty_like(e), []
    for s, step in enumerate(E):
        e[s], e_end[s] = x, step @ x
        x = after[s] @ e_end[s] if s in after else e_end[s]
    for s in range(len(E) - 1, -1, -1):
        if s in after:
            p_jump.append(p)
            p = p @ after[s]
        p_end[s] = p
        p_start[s] = p = p @ E[s]
    return _Cycle(size, e, e_end, p_start, p_end, np.array(p_jump[::-1]))
