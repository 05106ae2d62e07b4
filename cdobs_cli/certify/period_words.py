"""Linear loops under an interval of periods: words of mixed periods with a large spectral radius, in floats.

With no uncertain slope the adversary chooses the periods only: M = J exp(F s_m) .. J exp(F s_1), s_k in
[T_min, T_max]. Words over a grid of periods grow letter by letter, and of each length the most promising are kept
(half of them by their norm, half by their growth rate). Longer words, a turn of an oscillating error takes many
samples, are read off the error's largest trajectories: those that reach furthest in some direction. Then the periods
of the best words move freely. What comes out is only proposed: `words.prove` decides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_LETTERS = (8, 14, 20, 28)  # periods of the grid, by effort
_LONGEST = (4, 6, 8, 10)  # letters of a word
_KEPT = (24, 64, 128, 256)
_SAMPLES = (60, 120, 200, 300)  # of a trajectory
_PASSES = 4
_LONG = 12  # letters of a word whose periods are still moved
_REFINED = 5  # words whose periods are moved
_STEPS = 18


@dataclass(frozen=True)
class PeriodWord:
    """Periods in the order they are sampled, rho(M), and its growth rate ln(rho) / (sum of the periods), in floats.

    Words are compared by rate: from T_min = 0 short periods hardly change the error, and by radius they would win."""

    periods: tuple[float, ...]
    radius: float

    @property
    def rate(self) -> float:
        return math.log(max(self.radius, 1e-300)) / sum(self.periods)


def propose(F: Array, J: Array, low: float, high: float, effort: int, only: tuple[float, ...] = ()) -> list[PeriodWord]:
    """The words of largest growth rate met for edot = F e, e+ = J e, periods in [low, high] (not 0), or
    `only` these, best first."""
    import numpy as np

    level = max(0, min(effort, 3))
    shares = (1 - np.cos(np.pi * np.arange(_LETTERS[level]) / (_LETTERS[level] - 1))) / 2
    grid = low + (high - low) * shares
    if low == 0:
        grid[0] = grid[1] / 4
    if only:
        grid = np.array(only)
    # J = X Y: the error just after a sample lies in the range of J, often a plane.
    U, sizes, Vt = np.linalg.svd(J)
    rank = max(1, int(np.sum(sizes > 1e-12 * sizes[0])))
    X, Y = U[:, :rank] * sizes[:rank], Vt[:rank]
    letters = Y @ exponentials(F * grid[:, None, None]) @ X
    if not np.all(np.isfinite(letters)):
        return []
    scale = _balance(letters)
    letters = np.linalg.inv(scale) @ letters @ scale
    words, maps = np.arange(len(grid))[:, None], letters
    found: list[PeriodWord] = []
    for length in range(1, _LONGEST[level] + 1):
        if length > 1:
            maps = (letters[:, None] @ maps[None]).reshape(-1, *letters.shape[1:])
            words = np.concatenate(
                [np.tile(words, (len(grid), 1)), np.repeat(np.arange(len(grid)), len(words))[:, None]], axis=1
            )
        radii = spectral_radii(maps)
        rates = np.log(np.maximum(radii, 1e-300)) / grid[words].sum(axis=1)
        best = np.argsort(-rates)[:_REFINED]
        found += [PeriodWord(tuple(float(s) for s in grid[words[k]]), float(radii[k])) for k in best]
        if len(maps) > _KEPT[level]:
            norms = np.linalg.norm(maps, axis=(1, 2))
            half = _KEPT[level] // 2
            kept = np.unique(np.concatenate([np.argsort(-norms)[:half], np.argsort(-rates)[:half]]))
            words, maps = words[kept], maps[kept]
    for _ in range(_PASSES):
        fastest = max(word.rate for word in found)
        further = _of_trajectories(letters, grid, fastest, _SAMPLES[level])
        found += further
        if not further or max(word.rate for word in further) <= fastest + 1e-9 * abs(fastest):
            break
    found.sort(key=lambda word: -word.rate)
    moved = [] if only else [_moved(word, F, X, Y, low, high) for word in _distinct(found)[:_REFINED]]
    return sorted([*moved, *found], key=lambda word: -word.rate)


def _of_trajectories(letters: Array, grid: Array, rate: float, samples: int) -> list[PeriodWord]:
    """Words that end the trajectory that grows most, measured against exp(rate t)."""
    import numpy as np

    N = letters.shape[-1]
    scaled = letters * np.exp(-np.clip(rate * grid, -30, 30))[:, None, None]
    directions = _directions(N)
    points = directions
    parents, chosen = [], []
    for _ in range(samples):
        images = (scaled[:, None] @ points[None, :, :, None]).reshape(-1, N)
        size = np.abs(images).max()
        if not np.isfinite(size) or size == 0:
            return []
        best = np.unique(np.argmax(np.abs(directions @ images.T), axis=1))
        parents.append(best % len(points))
        chosen.append(best // len(points))
        points = images[best] / size
    k = int(np.argmax(np.linalg.norm(points, axis=1)))
    backwards: list[int] = []
    for parent, letter in zip(reversed(parents), reversed(chosen), strict=True):
        backwards.append(int(letter[k]))
        k = int(parent[k])
    products = [letters[backwards[0]]]
    for letter in backwards[1:]:
        products.append(products[-1] @ letters[letter])
    radii = spectral_radii(np.array(products))
    rates = np.log(np.maximum(radii, 1e-300)) / np.cumsum(grid[backwards])
    return [
        PeriodWord(tuple(float(s) for s in grid[backwards[: length + 1]][::-1]), float(radii[length]))
        for length in np.argsort(-rates)[:_REFINED]
    ]  # fmt: skip


def _directions(N: int) -> Array:
    """Unit vectors spread over half the sphere."""
    import numpy as np

    if N == 2:
        angles = np.pi * np.arange(48) / 48
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    drawn = np.random.default_rng(N).standard_normal((40 * N, N))
    spread: Array = drawn / np.linalg.norm(drawn, axis=1)[:, None]
    return spread


def _balance(letters: Array) -> Array:
    """Coordinates in which the letters are of one size: a Lyapunov function of their mean growth, or the identity."""
    import numpy as np

    N = letters.shape[-1]
    size = max(float(spectral_radii(letters).max()), 1e-300) * 1.05
    total = np.eye(N)
    for _ in range(30):
        following = np.eye(N) + np.mean(letters.transpose(0, 2, 1) @ total @ letters, axis=0) / size**2
        total = following / np.trace(following) * N
    if not np.all(np.isfinite(total)) or np.linalg.cond(total) > 1e12:
        return np.eye(N)
    inverse: Array = np.linalg.inv(np.linalg.cholesky(total)).T
    return inverse


def _distinct(words: list[PeriodWord]) -> list[PeriodWord]:
    """One word for each rotation, the primitive ones."""
    kept: dict[tuple[float, ...], PeriodWord] = {}
    for word in words:
        letters = word.periods
        root = next(
            n
            for n in range(1, len(letters) + 1)
            if len(letters) % n == 0 and letters[:n] * (len(letters) // n) == letters
        )
        letters = letters[:root]
        key = min(letters[k:] + letters[:k] for k in range(root))
        kept.setdefault(key, PeriodWord(letters, word.radius ** (root / len(word.periods))))
    return list(kept.values())


def _moved(word: PeriodWord, F: Array, X: Array, Y: Array, low: float, high: float) -> PeriodWord:
    """Coordinate search over the periods of one word, halving the steps."""
    import numpy as np

    periods, radius, rate = np.array(word.periods), word.radius, word.rate
    count = len(periods)
    if count > _LONG:
        return word
    step = (high - low) / 8
    for _ in range(_STEPS):
        trials = np.clip(
            np.concatenate([periods + step * np.eye(count), periods - step * np.eye(count)]),
            max(low, high * 1e-5),
            high,
        )
        maps = Y @ exponentials(F * trials.reshape(-1)[:, None, None]) @ X
        product = maps.reshape(2 * count, count, *maps.shape[1:])
        total = product[:, 0]
        for k in range(1, count):
            total = product[:, k] @ total
        radii = spectral_radii(total)
        rates = np.log(np.maximum(radii, 1e-300)) / trials.sum(axis=1)
        best = int(np.argmax(rates))
        if rates[best] > rate:
            periods, radius, rate = trials[best], float(radii[best]), float(rates[best])
        else:
            step /= 2
    return PeriodWord(tuple(float(s) for s in periods), radius)
