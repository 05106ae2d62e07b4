"""The planar extremals in floats, by closed forms: they choose gains, points and periods, and prove nothing."""

from __future__ import annotations

import math
from typing import Any

from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class FloatSweep:
    """e(delta; s) from e(0) = (0, 1): climb for s, then fall (see `planar`)."""

    lo: tuple[float, float]
    hi: tuple[float, float]
    delta: float

    @staticmethod
    def solution(v: tuple[float, float], t: Any, e: tuple[Any, Any] = (0.0, 1.0)) -> tuple[Any, Any]:
        """exp([[0, 1], [v_1, v_2]] t) e, over arrays t."""
        import numpy as np

        half = v[1] / 2
        w = np.sqrt(complex(half * half + v[0]))
        t = np.asarray(t, dtype=float)
        with np.errstate(all="ignore"):
            growth = np.exp(half * t)
            sinhc = np.real(np.sinh(w * t) / w) if abs(w) > 1e-9 else t
            cosh = np.real(np.cosh(w * t))
            e_1 = growth * (cosh * e[0] + sinhc * (e[1] - half * e[0]))
            e_2 = growth * (cosh * e[1] + sinhc * (v[0] * e[0] + half * e[1]))
        return e_1, e_2

    @staticmethod
    def crossing(v: tuple[float, float]) -> float:
        """The first time at which e_2 = 0 from (0, 1); infinite where there is none.

        e_2 ~ cosh(w t) + (half / w) sinh(w t)."""
        half = v[1] / 2
        square = half * half + v[0]
        if square < 0:
            w = math.sqrt(-square)
            angle = math.atan2(w, -half)
            return angle / w
        w = math.sqrt(square)
        if half >= 0 or w >= -half:
            return math.inf
        return math.atanh(w / -half) / w if w > 0 else -1 / half

    def reference(self, first: tuple[float, float], second: tuple[float, float], t: Any) -> tuple[Any, Any]:
        """The solution from (0, 1) that changes matrix where e_2 = 0."""
        import numpy as np

        t = np.asarray(t, dtype=float)
        turn = self.crossing(first)
        before = self.solution(first, np.minimum(t, turn))
        if not np.isfinite(turn):
            return before
        after = self.solution(second, np.maximum(t - turn, 0.0), self.solution(first, turn))
        return np.where(t <= turn, before[0], after[0]), np.where(t <= turn, before[1], after[1])

    def climbing(self, t: Any) -> tuple[Any, Any]:
        return self.reference(self.hi, (self.hi[0], self.lo[1]), t)

    def falling(self, t: Any) -> tuple[Any, Any]:
        return self.reference(self.lo, (self.lo[0], self.hi[1]), t)

    def meeting(self, s: Any) -> Any:
        """theta with the falling reference on the ray of the climbing one at s: the time of its slope m.

        First phase: m = half + w coth(w t). Second, from slope 0: m = v_1 T / (1 - half T), T = tanh(w t) / w."""
        import numpy as np

        e_1, e_2 = self.climbing(s)
        with np.errstate(all="ignore"):
            m = e_2 / e_1
            half, v_1 = self.lo[1] / 2, self.lo[0]
            first = _angle(half * half + v_1, np.ones_like(m), m - half)
            half = self.hi[1] / 2
            second = self.crossing(self.lo) + _angle(half * half + v_1, -m, -(v_1 + half * m))
            theta = np.where(m >= 0, first, second)
        return np.clip(np.where(np.isnan(theta), s, theta), 0.0, s)

    def ends(self, s: Any) -> tuple[Any, Any]:
        """e(delta; s) over arrays s."""
        import numpy as np

        s = np.asarray(s, dtype=float)
        theta = self.meeting(s)
        e, d = self.climbing(s), self.falling(theta)
        with np.errstate(all="ignore"):
            r = np.where(np.abs(e[1]) > np.abs(e[0]), e[1] / d[1], e[0] / d[0])
            end = self.falling(theta + self.delta - s)
        return r * end[0], r * end[1]

    def gains(self) -> tuple[float, float, float, float]:
        """(least, most, s_least, s_most): K_2 must exceed (e_2 - 1) / e_1 and stay below (e_2 + 1) / e_1 for all s.

        Infinite where e_1 > 0 is lost before delta."""
        import numpy as np

        found = []
        for sign in (1.0, -1.0):
            low, high, value, at = 0.0, self.delta, -np.inf, 0.0
            for _ in range(5):  # a grid, then grids about its best point
                s = np.linspace(low, high, 41)
                e_1, e_2 = self.ends(s)
                if not (np.all(np.isfinite(e_2)) and np.all(e_1 > 0)):
                    return np.inf, -np.inf, 0.0, 0.0
                values = (sign * e_2 - 1) / e_1
                k = int(np.argmax(values))
                if values[k] > value:
                    value, at = float(values[k]), float(s[k])
                step = float(s[1] - s[0])
                low, high = max(0.0, at - step), min(self.delta, at + step)
            found.append((sign * value, at))
        return found[0][0], found[1][0], found[0][1], found[1][1]


def _angle(square: float, rise: Any, run: Any) -> Any:
    """t >= 0 with tanh(w t) / w = rise / run, w^2 = square (tan where it is negative)."""
    import numpy as np

    if square < 0:
        w = math.sqrt(-square)
        return np.arctan2(w * rise, run) / w
    w = math.sqrt(square)
    return np.arctanh(w * rise / run) / w if w > 1e-9 else rise / run
