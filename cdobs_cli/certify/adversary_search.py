"""The search for the worst slopes, disturbance and noise, in floats: sweeps of the maximum principle.

To make z'e large at one time: with the costate p (z at that time, p = A(V)'p backwards along the flow, J'p at samples)
of the slopes V tried before, run forwards again and take at every slot the corner that makes p'e largest at its end, d
and v by the signs of p'B and p'G. The old costate prices every change exactly. Words are repeated for ever: errors
start, and costates end, with those of the periodic solution of the sweep before. Many starts, target times and words
of periods go side by side. What comes out is only proposed: `adversary.prove` decides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.adversary import NoisyWord
from cdobs_cli.certify.falsify import candidate_corners, ends_of
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.words import Arc, Word
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_CORNERS = 64  # of the flow
_JUMPS = 16  # corners of the jump
_SLOTS = (8, 16, 24, 32)  # of a period, by effort
_STEPS = (240, 400, 800, 1600)  # slots of all periods, by effort
_SWEEPS = (4, 6, 8, 12)
_STARTS = (2, 4, 8, 16)
_MEMORY = 8.0  # time constants that a word goes back
_FEWEST, _MOST = 3, 80  # periods of a word
_TARGETS = 4  # times in the last period, besides its start
_FLIPS = (0, 1, 2, 4)  # rounds in which single periods are changed
_LATEST = 10  # periods that are changed
_PROPOSALS = 2


def propose(inclusion: HybridInclusion, state: int, effort: int) -> Iterator[NoisyWord]:
    """Words that make the error of this state large, the largest first."""
    level = max(0, min(effort, 3))
    with np.errstate(all="ignore"):
        search = _Search.of(inclusion, level)
        if search is None:
            return
        for policy in search.best(state)[:_PROPOSALS]:
            yield search.word(policy, state)


_Affine = tuple[Any, Any]  # (R, N, N), (R, N)


@dataclass
class _Policies:
    """Many words side by side: letters (R, K) of periods, corners (R, K, S) of the flow, jumps (R, K), the slot of the
    last period at which z'e counts (R,), its sign, which ends d (R, K, S, n) and v (R, K, p) take, the error at the
    seam of the periodic solution (R, N), the costate there, and what z'e comes to on it."""

    letters: Any
    corners: Any
    jumps: Any
    target: Any
    sign: Array
    d: Any
    v: Any
    e: Array
    p: Array
    value: Array

    def take(self, rows: Any) -> _Policies:
        """Some of them."""
        return _Policies(*(part[rows] for part in vars(self).values()))

    def where(self, chosen: Any, others: _Policies) -> _Policies:
        """The others where chosen, (R,)."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return _Policies(*(np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in pairs))


class _Search:
    """Tables of one error system: E (letters, corners, N, N) and F (letters, corners, N, n) of one slot, the jumps
    (jumps, N, N), and the ends of d and v."""

    def __init__(
        self, inclusion: HybridInclusion, corners: list[tuple[bool, ...]], periods: list[Exact], K: int, level: int
    ) -> None:
        self.inclusion, self.corners, self.periods, self.K, self.level = inclusion, corners, periods, K, level
        maps, noise = inclusion.floats, inclusion.noise_floats
        self.S = max(4, min(_SLOTS[level], _STEPS[level] // K))
        self.N, self.n = noise.drive.shape
        flows = np.array([maps.flow(tuple(map(float, ends_of(inclusion.quantities, one)))) for one in corners])
        augmented = np.zeros((len(flows), self.N + self.n, self.N + self.n))
        augmented[:, : self.N, : self.N], augmented[:, : self.N, self.N :] = flows, noise.drive
        steps = np.array([exponentials(augmented * (float(T) / self.S)) for T in periods])
        self.E, self.F = steps[:, :, : self.N, : self.N], steps[:, :, : self.N, self.N :]
        self.bits = list(product((False, True), repeat=len(inclusion.outputs)))[:_JUMPS]
        self.J = np.array([maps.jump_at(tuple(map(float, ends_of(inclusion.outputs, one)))) for one in self.bits])
        self.G = noise.kick
        self.d_ends, self.v_ends = (
            _ends(inclusion.plant.disturbance, self.n),
            _ends(inclusion.plant.noise, noise.kick.shape[1]),
        )

    @staticmethod
    def of(inclusion: HybridInclusion, level: int) -> _Search | None:
        """None where the loop decays too slowly, or not at all, at some corner."""
        maps, periods = inclusion.floats, _periods(inclusion)
        corners = list(candidate_corners(inclusion))[:_CORNERS]
        flows = np.array([maps.flow(tuple(map(float, ends_of(inclusion.quantities, one)))) for one in corners])
        parts = (flows, maps.jump, *maps.jump_parts)
        if not periods or not all(np.all(np.isfinite(part)) for part in parts):
            return None
        slowest = 0.0
        for T in periods:
            radius = float(spectral_radii(maps.jump @ exponentials(flows * float(T))).max())
            slowest = max(slowest, radius)
        if not slowest < 1:
            return None
        K = int(np.ceil(_MEMORY / -np.log(max(slowest, 1e-9))))
        return _Search(inclusion, corners, periods, max(_FEWEST, min(K, _MOST)), level)

    def best(self, state: int) -> list[_Policies]:
        """The policies of largest value met, one each."""
        policies = self._swept(self._starts(), state, _SWEEPS[self.level])
        for _ in range(_FLIPS[self.level] if len(self.periods) > 1 else 0):
            top = policies.take([int(np.argmax(policies.value))])
            flipped = self._swept(self._flipped(top), state, max(2, _SWEEPS[self.level] // 2))
            if not flipped.value.max() > top.value[0] * (1 + 1e-6):
                break
            policies = flipped
        order = np.argsort(-policies.value)
        return [policies.take([int(k)]) for k in order]

    def _starts(self) -> _Policies:
        """Constant and drawn corners, words of each period alone and drawn ones, every target time."""
        rng = np.random.default_rng(17)
        K, S, count = self.K, self.S, _STARTS[self.level]
        letters = [np.full(K, k) for k in range(len(self.periods))]
        letters += [rng.integers(len(self.periods), size=K) for _ in range(2 if len(self.periods) > 1 else 0)]
        targets = sorted({round(S * k / _TARGETS) for k in range(_TARGETS + 1)})
        signs = (1.0, -1.0) if self._is_lopsided else (1.0,)
        rows = []
        for word, target, sign, start in product(letters, targets, signs, range(count)):
            if start < min(2, len(self.corners)):
                corner = np.full((K, S), -start)
            elif len(self.corners) > 1:
                corner = np.repeat(rng.integers(len(self.corners), size=(K, 2)), (S + 1) // 2, axis=1)[:, :S]
            else:
                continue
            rows.append((word, corner % len(self.corners), target, sign))
        word, corner, target, sign = (np.array(part) for part in zip(*rows, strict=True))
        R = len(rows)
        zero = np.zeros((R, K), dtype=int)
        return _Policies(
            word, corner, zero, target, sign, np.zeros((R, K, S, self.n), dtype=bool),
            np.zeros((R, K, self.G.shape[1]), dtype=bool), np.zeros((R, self.N)), np.zeros((R, self.N)),
            np.full(R, -np.inf),
        )  # fmt: skip

    @property
    def _is_lopsided(self) -> bool:
        """Whether a box is not symmetric: then -e is not reached where e is."""
        return any(not np.allclose(low, -high) for low, high in (self.d_ends, self.v_ends))

    def _flipped(self, top: _Policies) -> _Policies:
        """The best one with single periods changed."""
        latest = range(max(0, self.K - _LATEST), self.K)
        rows = [(k, letter) for k in latest for letter in range(len(self.periods)) if letter != top.letters[0, k]]
        flipped = top.take([0] * (len(rows) + 1))
        for row, (k, letter) in enumerate(rows):
            flipped.letters[row, k] = letter
        flipped.value[:] = -np.inf
        return flipped

    def _swept(self, policies: _Policies, state: int, sweeps: int) -> _Policies:
        """Each word the best of its sweeps."""
        best = policies
        for _ in range(sweeps):
            policies = self._sweep(policies, self._costates(policies, state), state)
            better = policies.value > best.value + 1e-6 * np.abs(policies.value)
            if not better.any():
                break
            best = best.where(better, policies)
        return best

    def _costates(self, policies: _Policies, state: int) -> tuple[Array, Array]:
        """p at the end of every slot (R, K, S, N), and just after every sample (R, K, N)."""
        R, K, S = policies.corners.shape
        at_slots, at_samples = np.zeros((R, K, S, self.N)), np.zeros((R, K, self.N))
        p = policies.p.copy()
        for k in range(K - 1, -1, -1):
            at_samples[:, k] = p
            p = np.einsum("rji,rj->ri", self.J[policies.jumps[:, k]], p)
            for s in range(S - 1, -1, -1):
                if k == K - 1:
                    p[policies.target == s + 1, state] += policies.sign[policies.target == s + 1]
                at_slots[:, k, s] = p
                p = np.einsum("rji,rj->ri", self.E[policies.letters[:, k], policies.corners[:, k, s]], p)
            if k == K - 1:
                p[policies.target == 0, state] += policies.sign[policies.target == 0]
        return at_slots, at_samples

    def _sweep(self, policies: _Policies, costates: tuple[Array, Array], state: int) -> _Policies:
        """Forwards from the seam, every choice the best by the costate at its end."""
        at_slots, at_samples = costates
        R, K, S = policies.corners.shape
        corners, jumps = np.zeros_like(policies.corners), np.zeros_like(policies.jumps)
        d, v = np.zeros_like(policies.d), np.zeros_like(policies.v)
        # Affine maps of the error at the seam: its matrix, and what acts on it since.
        now = np.broadcast_to(np.eye(self.N), (R, self.N, self.N)), np.zeros((R, self.N))
        there, rows, (lower, upper) = now, np.arange(R), self.d_ends
        for k in range(K):
            E, F = self.E[policies.letters[:, k]], self.F[policies.letters[:, k]]  # (R, C, N, N), (R, C, N, n)
            there = now if k == K - 1 else there
            for s in range(S):
                p, e = at_slots[:, k, s], _at(now, policies.e)
                gain = np.einsum("rj,rcjn->rcn", p, F)
                fed = np.where(gain > 0, upper, lower)
                worth = np.einsum("rj,rcji,ri->rc", p, E, e) + np.einsum("rcn,rcn->rc", gain, fed)
                best = worth.argmax(axis=1)
                corners[:, k, s], d[:, k, s] = best, gain[rows, best] > 0
                push = np.einsum("rin,rn->ri", F[rows, best], fed[rows, best])
                now = E[rows, best] @ now[0], _at((E[rows, best], push), now[1])
                if k == K - 1:
                    met = policies.target == s + 1
                    there = np.where(met[:, None, None], now[0], there[0]), np.where(met[:, None], now[1], there[1])
            p, e = at_samples[:, k], _at(now, policies.e)
            best = np.einsum("rj,wji,ri->rw", p, self.J, e).argmax(axis=1)
            kick = p @ self.G > 0
            jumps[:, k], v[:, k] = best, kick
            push = np.where(kick, self.v_ends[1], self.v_ends[0]) @ self.G.T
            now = self.J[best] @ now[0], _at((self.J[best], push), now[1])
        return self._repeated(replace(policies, corners=corners, jumps=jumps, d=d, v=v), state, now, there)

    def _repeated(self, policies: _Policies, state: int, word: _Affine, there: _Affine) -> _Policies:
        """The periodic solution e = M e + c at the seam, the costate alike, and z'e on it."""
        fixed = np.eye(self.N) - word[0]
        z = there[0][:, state] * policies.sign[:, None]
        try:
            e = np.linalg.solve(fixed, word[1][..., None])[..., 0]
            p = np.linalg.solve(fixed.transpose(0, 2, 1), z[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return replace(policies, value=np.full(len(policies.value), -np.inf))
        value = policies.sign * _at(there, e)[:, state]
        return replace(policies, e=e, p=p, value=np.where(np.isfinite(value), value, -np.inf))

    def word(self, policy: _Policies, state: int) -> NoisyWord:
        """In exact numbers: slots of the same slopes and disturbance are one arc."""
        plant = self.inclusion.plant
        periods, arcs_d, target = [], [], int(policy.target[0])
        gone = at = 0
        for k in range(self.K):
            T, arcs = self.periods[int(policy.letters[0, k])], []
            last = k == self.K - 1
            if last and target == 0:
                at = gone
            start = 0
            for s in range(1, self.S + 1):
                if s < self.S and not (last and s == target) and self._same(policy, k, s):
                    continue
                corner = self.corners[int(policy.corners[0, k, start])]
                arcs.append(Arc(T * Exact(Fraction(s - start, self.S)), ends_of(self.inclusion.quantities, corner)))
                arcs_d.append(_chosen(plant.disturbance, policy.d[0, k, start], plant.n))
                gone, start = gone + 1, s
                if last and s == target:
                    at = gone
            periods.append(tuple(arcs))
        v = tuple(_chosen(plant.noise, one, plant.p) for one in policy.v[0])
        outputs = tuple(ends_of(self.inclusion.outputs, self.bits[int(one)]) for one in policy.jumps[0])
        word = Word(tuple(periods), outputs if self.inclusion.outputs else ())
        return NoisyWord(word, tuple(arcs_d), v, state, at, after=target == 0)

    def _same(self, policy: _Policies, k: int, s: int) -> bool:
        """Whether slot s goes on as slot s - 1."""
        one, other = policy.corners[0, k, s], policy.corners[0, k, s - 1]
        return bool(one == other and np.array_equal(policy.d[0, k, s], policy.d[0, k, s - 1]))


def _at(affine: _Affine, e: Array) -> Array:
    """M e + c of each."""
    image: Array = np.einsum("rij,rj->ri", affine[0], e) + affine[1]
    return image


def _periods(inclusion: HybridInclusion) -> list[Exact]:
    """Of the law: its ends, and the middle; for T_min = 0 some short ones."""
    law = inclusion.sampling
    if law.is_periodic or law.T_max.sign() != 1:
        return [law.T_max] if law.T_max.sign() == 1 else []
    if law.is_lossy:
        return list(dict.fromkeys((law.T_max, law.multiples[len(law.multiples) // 2], law.T_min)))
    half = Exact(Fraction(1, 2))
    short = law.T_max * Exact(Fraction(1, 6)) if law.from_zero else law.T_min
    return [law.T_max, (short + law.T_max) * half, short]


def _ends(box: Box | None, size: int) -> tuple[Array, Array]:
    if box is None:
        return np.zeros(size), np.zeros(size)
    return np.array([float(end) for end in box.lower]), np.array([float(end) for end in box.upper])


def _chosen(box: Box | None, up: Any, size: int) -> tuple[Exact, ...]:
    if box is None:
        return (EXACT_ZERO,) * size
    return tuple(high if bit else low for bit, low, high in zip(up, box.lower, box.upper, strict=True))
