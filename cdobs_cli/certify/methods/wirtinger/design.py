"""The held gain by the convex form of Wirtinger's inequality, with its line search on epsilon: floats, no proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.cuts import largest_margin
from cdobs_cli.certify.lmi import full, symmetric
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.matrix import block
from cdobs_cli.exact.matrix import symmetric as sym
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_EPSILONS = (0.05, 20.0)
_COARSE = 5000  # `size` beyond which the line search is a glance


def size(plant: Plant) -> int:
    """What a certificate over the corners costs, roughly: (n + p)^3 times the corners."""
    return int((plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.quantities))


def synthesis(P: Any, S: Any, Y: Any, U: Any, A_i: Any, C: Any, q: Any, epsilon: Any, sigma: Any) -> Any:
    """`inequality` with the gain free, L = S^-1 Y: this symmetric matrix < 0 at each vertex, for one epsilon > 0.

    Rows (e, w, edot), from 2 (e + epsilon edot)' S (F_i e + L w - edot) = 0:

        (1,1) sym(S A_i - Y C) + 2 sigma P    (1,2) Y                    (1,3) P - S + epsilon (S A_i - Y C)'
                                              (2,2) (q sigma^2 - 1) U    (2,3) epsilon Y' + q sigma U C
                                                                         (3,3) -epsilon (S + S') + q C' U C

    Shapes: P, S, A_i (n, n); Y (n, p); U (p, p); C (p, n). S need not be symmetric.
    Source: LiuFridman2012, the functional; the gain freed by the descriptor method.
    """
    F = S @ A_i - Y @ C
    coupling = P - S + F.T * epsilon
    held = Y.T * epsilon + (U @ C) * (q * sigma)
    return block(
        [
            [sym(F) + P * (2 * sigma), Y, coupling],
            [Y.T, U * (q * sigma * sigma - 1), held],
            [coupling.T, held.T, (C.T @ U @ C) * q - sym(S) * epsilon],
        ]
    )


@dataclass(frozen=True)
class Proposal:
    """A gain from `synthesis` in the user's units, and how far the inequality is from its edge (a margin that is not
    positive: none was found)."""

    L: Array
    margin: float
    epsilon: float


@dataclass
class HeldSynthesis:
    """Gains of one plant for every T_k <= tau and a rate; `epsilon` (in units of tau) is the one that did well last."""

    plant: Plant
    epsilon: float = 1.0

    def propose(self, tau: float, sigma: float, epsilon: float | None = None) -> Proposal:
        """The gain of the largest margin at one epsilon."""
        epsilon = self.epsilon if epsilon is None else epsilon
        given = PlantView.floats(self.plant, {})
        units = Units.of(given, tau)
        view = units.view(given)
        n, p, q = self.plant.n, self.plant.p, (2 / np.pi) ** 2
        none = Proposal(np.zeros((n, p)), -np.inf, epsilon)
        if not np.all(np.isfinite(view.vertices)):
            return none
        solution, margin = largest_margin(
            {"P": symmetric(n), "S": full(n, n), "Y": full(n, p), "U": symmetric(p)},
            lambda x, A_i: -synthesis(x["P"], x["S"], x["Y"], x["U"], A_i, view.C, q, epsilon, sigma * tau),
            view.vertices,
            (lambda x: x["P"], lambda x: x["U"]),
            lambda x: np.trace(x["P"]) - 1,
        )
        try:
            L = np.array(np.linalg.solve(solution.values["S"], solution.values["Y"]), dtype=np.float64)
        except np.linalg.LinAlgError:
            return none
        # Where the plant falls into parts, what couples them is the solver's noise.
        L[np.abs(L) < 1e-9 * np.abs(L).max()] = 0.0
        return Proposal(units.gain_out(L), margin, epsilon) if np.all(np.isfinite(L)) else none

    def design(self, tau: float, sigma: float) -> Proposal:
        """The gain of the largest margin met in a line search on epsilon."""
        best = self._line_search(tau, sigma)
        self.epsilon = best.epsilon
        return best

    def _line_search(self, tau: float, sigma: float) -> Proposal:
        def at(epsilon: float) -> Proposal:
            return self.propose(tau, sigma, epsilon)

        if size(self.plant) > _COARSE:
            return max((at(epsilon) for epsilon in (1.0, 3.0, 0.3)), key=_margin)
        tried = [at(float(epsilon)) for epsilon in np.geomspace(*_EPSILONS, 9)]
        k = max(range(len(tried)), key=lambda k: tried[k].margin)
        low, high, best = tried[max(k - 1, 0)].epsilon, tried[min(k + 1, len(tried) - 1)].epsilon, tried[k]
        for _ in range(3):
            middle = (low * high) ** 0.5
            left, right = at((low * middle) ** 0.5), at((middle * high) ** 0.5)
            best = max(best, left, right, key=_margin)
            low, high = (low, middle) if left.margin > right.margin else (middle, high)
        return best

    def redesign(self, tau: float, sigma: float) -> Proposal:
        """`propose` at the epsilon that did well; the whole line search where that fails."""
        near = self.propose(tau, sigma)
        return near if near.margin > 0 else self.design(tau, sigma)

    def fastest(self, tau: float) -> tuple[float, Proposal]:
        """The largest rate met at one period, and its proposal: doubles the rate from 1 / tau, then bisects."""
        best = self.design(tau, 0.0)
        low, high = 0.0, 1.0 / tau
        if not best.margin > 0:
            return low, best
        while (above := self.redesign(tau, high)).margin > 0 and high < 1e3 / tau:
            low, high, best = high, 2 * high, above
        self.epsilon = best.epsilon
        for _ in range(8):
            middle = (low + high) / 2
            at_middle = self.propose(tau, middle)
            low, high, best = (middle, high, at_middle) if at_middle.margin > 0 else (low, middle, best)
        return low, best

    def longest(
        self, tau: float, rate: Callable[[float], float], factor: float, width: float
    ) -> tuple[float, Proposal]:
        """The longest period met at a rate that may depend on it: by factors from tau, then bisection. Where there
        is none
        the last period tried, with a margin that is not positive."""
        low, steps, best = tau, 0, self.design(tau, rate(tau))
        while not best.margin > 0 and steps < search.STEPS:
            low, steps = low / factor, steps + 1
            best = self.design(low, rate(low))
        if not best.margin > 0:
            return low, best
        high = factor * low
        while steps == 0 and (above := self.redesign(high, rate(high))).margin > 0 and high < 1e4 * tau:
            low, high, best = high, factor * high, above
        self.epsilon = best.epsilon
        while high - low > width * low:
            middle = (low + high) / 2
            at_middle = self.propose(middle, rate(middle))
            low, high, best = (middle, high, at_middle) if at_middle.margin > 0 else (low, middle, best)
        return low, best


def _margin(proposal: Proposal) -> float:
    return proposal.margin
