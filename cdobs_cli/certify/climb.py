"""Search for a gain with a proof as its objective: a step is taken where a better bound is proved."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    import numpy as np

    from cdobs_cli.arrays import Array

GAIN_DIGITS = 5
_FIRST_STEP, _LAST_STEP = 0.2, 0.01
_FIRST_GROWTH, _LAST_GROWTH = 0.04, 0.002


@dataclass
class Climb:
    """Pattern search over the gain: `passes(L, value)` says whether the value is proved for the rounded gain.

    Attributes:
        passes: the proof; larger values ask for more.
        unit: sizes of the entries of L that count as alike, shape (n, p).
        budget: number of proofs that may be tried.
        goal: where to stop.
    """

    passes: Callable[[ExactMatrix, float], bool]
    unit: Array
    budget: int
    goal: float = float("inf")

    def run(self, start: Array, value: float) -> tuple[ExactMatrix, float]:
        """The best gain and the value proved for it, from a gain for which `value` is known to be proved."""
        import numpy as np

        random = np.random.default_rng(0)
        L, best = start, value
        rounded = ExactMatrix.from_floats(start, GAIN_DIGITS)
        step, growth = _FIRST_STEP, _FIRST_GROWTH
        best = self._push(rounded, best, growth)
        while step >= _LAST_STEP and self.budget > 0 and best < self.goal:
            improved = False
            scale = np.maximum(np.abs(L), 0.05 * self.unit * (np.abs(L) / self.unit).max())
            for direction in self._directions(L.shape, random):
                candidate = L + step * scale * direction
                rounded_candidate = ExactMatrix.from_floats(candidate, GAIN_DIGITS)
                target = min(best * (1 + growth), self.goal)
                if self._try(rounded_candidate, target):
                    L, rounded, improved = candidate, rounded_candidate, True
                    best = self._push(rounded, target, growth)
                if self.budget <= 0 or best >= self.goal:
                    break
            if not improved:
                step, growth = step / 2, max(growth / 2, _LAST_GROWTH)
        return rounded, best

    def _push(self, L: ExactMatrix, value: float, growth: float) -> float:
        """Raise the value for one gain while that is proved."""
        while value < self.goal and self._try(L, min(value * (1 + growth), self.goal)):
            value = min(value * (1 + growth), self.goal)
        return value

    def _try(self, L: ExactMatrix, value: float) -> bool:
        self.budget -= 1
        return self.budget >= 0 and self.passes(L, value)

    @staticmethod
    def _directions(shape: tuple[int, int], random: np.random.Generator) -> list[Array]:
        """Each entry up and down, and as many mixed signs."""
        import numpy as np

        size = shape[0] * shape[1]
        single = [sign * row.reshape(shape) for row in np.eye(size) for sign in (1.0, -1.0)]
        mixed = [row.reshape(shape) for row in random.choice([-1.0, 1.0], size=(size, size))]
        return single + [part for row in mixed for part in (row, -row)]
