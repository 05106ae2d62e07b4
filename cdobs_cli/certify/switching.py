"""The search for switching counterexamples, in floats: which V(t), at corners of the slope box, makes rho(M) largest.

By the maximum principle an extremal V(t) is bang-bang: with e the error along the leading eigenvector and p
the costate along the left one, v_k follows the sign of p' parts_k e; so do, at each sample, slopes of the outputs
that vary. Starting from some V on a grid of slots, that rule is applied again and again (policy iteration); arcs of
equal slopes are then merged and their lengths refined. What comes out is only proposed: `falsify.prove` decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_SLOTS = (0, 12, 20, 32)  # slots a period, by effort
_PERIODS = (0, 2, 3, 4)  # longest words, by effort
_STARTS = (0, 4, 8, 16)
_SWEEPS = 12
_PROMISING = 0.985  # a radius from which lengths are refined


@dataclass(frozen=True)
class Proposal:
    """Arcs of a word: lengths as floats and corners (True: upper end) by period, the corner of the jump after each, and
    the radius in floats."""

    radius: float
    periods: tuple[Exact, ...]
    arcs: tuple[tuple[tuple[float, tuple[bool, ...]], ...], ...]
    jumps: tuple[tuple[bool, ...], ...] = ()


def propose(inclusion: HybridInclusion, effort: int) -> list[Proposal]:
    """Words of one to several sampling periods with the largest spectral radii met, best first."""
    level = max(0, min(effort, 3))
    maps = inclusion.floats
    if level == 0 or not (maps.lower or maps.jump_lower):  # without slopes the periods alone are left: `period_words`
        return []
    return propose_for(maps, list(_period_words(inclusion, _PERIODS[level])), level)


def propose_for(maps: ErrorMaps[Array], words: list[tuple[Exact, ...]], level: int) -> list[Proposal]:
    """The same for maps in floats and given sampling periods of each word."""
    import numpy as np

    with np.errstate(all="ignore"):
        search = _Search(maps, _SLOTS[level])
        found = [proposal for word in words for proposal in search.word(word, _STARTS[level])]
    return sorted(found, key=lambda proposal: -proposal.radius)


def _period_words(inclusion: HybridInclusion, longest: int) -> Iterator[tuple[Exact, ...]]:
    """Sampling periods of the words: all equal under a periodic law, mixed under an interval."""
    law = inclusion.sampling
    T, low = law.T_max, law.T_min
    if T.sign() != 1:
        return
    if low == T:
        for count in range(1, longest + 1):
            yield (T,) * count
        return
    choices = [T]
    if low.sign() == 1:
        choices.append(low)
    if T.rational is not None and low.rational is not None:
        choices.append(Exact((T.rational + low.rational) / 2))
        if low.sign() == 0:
            choices.append(Exact(T.rational / 8))
    for count in range(1, longest + 1):
        words = {min(word[k:] + word[:k] for k in range(count)) for word in product(range(len(choices)), repeat=count)}
        for word in sorted(words)[: 6 * count]:
            yield tuple(choices[index] for index in word)


class _Search:
    """Policy iteration for one inclusion."""

    def __init__(self, maps: ErrorMaps[Array], slots: int) -> None:
        import numpy as np

        self.maps, self.slots = maps, slots
        self.parts = np.array(maps.parts).reshape(-1, *maps.base.shape)  # (k, N, N)
        self.lower, self.upper = np.array(maps.lower, dtype=float), np.array(maps.upper, dtype=float)
        self.k, self.m = len(self.lower), len(maps.jump_lower)
        self.jump_parts = np.array(maps.jump_parts).reshape(-1, *maps.base.shape)
        self.half = (np.array(maps.jump_upper, dtype=float) - np.array(maps.jump_lower, dtype=float)) / 2

    def word(self, periods: tuple[Exact, ...], starts: int) -> list[Proposal]:
        import numpy as np

        W, slots = len(periods), self.slots
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
            radius, bits, at_jumps = self._improve(bits, at_jumps, lengths, W)
            key = bits.tobytes() + at_jumps.tobytes()
            if key in found or not np.isfinite(radius):
                continue
            arcs, jumps = self._merge(bits, lengths, W), tuple(tuple(map(bool, row)) for row in at_jumps)
            if _PROMISING <= radius < 1.05:
                radius, arcs = self._refine(radius, arcs, self._jumps(at_jumps))
            found[key] = Proposal(radius, periods, arcs, jumps)
        return sorted(found.values(), key=lambda proposal: -proposal.radius)[:2]

    def _jumps(self, at_jumps: Any) -> Array:
        """The jump after each period, (W, N, N)."""
        import numpy as np

        deviations = np.where(at_jumps, self.half, -self.half)
        jumps: Array = self.maps.jump + np.einsum("wm,mij->wij", deviations, self.jump_parts)
        return jumps

    def _improve(self, bits: Any, at_jumps: Any, lengths: Array, W: int) -> tuple[float, Any, Any]:
        import numpy as np

        size = bits.size

        def evaluate(flat: Any) -> tuple[float, Any]:
            return self._evaluate(flat[:size].reshape(bits.shape), flat[size:].reshape(at_jumps.shape), lengths, W)

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

    def _evaluate(self, bits: Any, at_jumps: Any, lengths: Array, W: int) -> tuple[float, Any]:
        """rho per period of the word, and d|lambda| / d v for each slot, then for each slope at each jump, flat (None
        where it makes no sense)."""
        import numpy as np

        v = np.where(bits, self.upper, self.lower)
        flows = self.maps.base + np.einsum("sk,kij->sij", v, self.parts)
        E = exponentials(flows * lengths[:, None, None])
        N = flows.shape[-1]
        jumps, before_jump = self._jumps(at_jumps), []
        forward = [np.eye(N)]
        for slot, step in enumerate(E):
            total = step @ forward[-1]
            if (slot + 1) % self.slots == 0:
                before_jump.append(total)
                total = jumps[slot // self.slots] @ total
            forward.append(total)
        M = forward[-1]
        if not np.all(np.isfinite(M)):
            return float("nan"), None
        values, vectors = np.linalg.eig(M)
        top = int(np.argmax(np.abs(values)))
        lam = values[top]
        size = float(np.abs(lam))
        radius = size ** (1 / W)
        if size == 0.0:
            return radius, None
        duals, lefts = np.linalg.eig(M.T)
        p = lefts[:, int(np.argmin(np.abs(duals - lam)))]
        x = vectors[:, top]
        scale = p @ x
        if abs(scale) < 1e-12:
            return radius, None
        weight = np.conj(lam) / size / scale
        gradient, of_jumps = np.empty((len(E), self.k)), np.empty((W, self.m))
        costate = p
        for slot in range(len(E) - 1, -1, -1):
            if (slot + 1) % self.slots == 0:
                w = slot // self.slots
                of_jumps[w] = np.real(weight * np.einsum("i,kij,j->k", costate, self.jump_parts, before_jump[w] @ x))
                costate = jumps[w].T @ costate
            e = forward[slot] @ x
            before = E[slot].T @ costate
            middle_e, middle_p = (e + E[slot] @ e) / 2, (costate + before) / 2
            gradient[slot] = np.real(weight * np.einsum("i,kij,j->k", middle_p, self.parts, middle_e))
            costate = before
        return radius, np.concatenate([gradient.ravel(), of_jumps.ravel()])

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

    def _radius(self, arcs: Any, jumps: Array) -> float:
        import numpy as np

        flat = [arc for period in arcs for arc in period]
        v = np.where(
            np.array([corner for _, corner in flat], dtype=bool).reshape(len(flat), self.k), self.upper, self.lower
        )
        flows = self.maps.base + np.einsum("sk,kij->sij", v, self.parts)
        E = iter(exponentials(flows * np.array([length for length, _ in flat])[:, None, None]))
        M = np.eye(flows.shape[-1])
        for period, jump in zip(arcs, jumps, strict=True):
            for _ in period:
                M = next(E) @ M
            M = jump @ M
        if not np.all(np.isfinite(M)):
            return float("nan")
        largest = float(np.abs(np.linalg.eigvals(M)).max())
        return math.pow(largest, 1 / len(arcs))

    def _refine(self, radius: float, arcs: Any, jumps: Array) -> tuple[float, Any]:
        """Moves switching times while that helps, by halving steps."""
        step = max(length for period in arcs for length, _ in period) / 8
        switches = [(w, i) for w, period in enumerate(arcs) for i in range(len(period) - 1)]
        for _ in range(14):
            moved = False
            for w, i in switches:
                for delta in (step, -step):
                    first, second = arcs[w][i], arcs[w][i + 1]
                    if not (first[0] + delta > 0 and second[0] - delta > 0):
                        continue
                    period = [
                        *arcs[w][:i],
                        (first[0] + delta, first[1]),
                        (second[0] - delta, second[1]),
                        *arcs[w][i + 2 :],
                    ]
                    trial = (*arcs[:w], tuple(period), *arcs[w + 1 :])
                    value = self._radius(trial, jumps)
                    if value > radius:
                        radius, arcs, moved = value, trial, True
                        break
            if not moved:
                step /= 2
        return radius, arcs
