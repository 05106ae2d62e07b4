"""The held gain by the convex form of Wirtinger's inequality, over epsilon: floats, no proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.ascent import Ascent, Height, end
from cdobs_cli.certify.cuts import margin_and_binding
from cdobs_cli.certify.lmi import full, symmetric
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.matrix import block
from cdobs_cli.exact.matrix import symmetric as sym
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_COARSE = 5000  # `size` beyond which one epsilon is tried
_BESIDE = (3.0, 0.3, 10.0, 0.1)  # of an epsilon: others that may do where it does not
_STEP = 1e-5  # relative, of a parameter: the inequality is smooth in each
_STEPS = 30  # programs of an ascent
_WIDE, _SPAN = 0.05, 1e3  # of the end for one epsilon
_SLOW, _FAST = 1e-3, 10.0  # over the period
_SECANTS = 3
_WIDTH = 1e-3  # a relative rise that is too small to go on for
_INSIDE = (1.0, 0.9999, 0.999, 0.99, 0.95)  # parts of an end that are looked for a margin


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
    """Gains of one plant for every T_k <= tau and a rate; `epsilon` (in units of tau) is the one that did well last,
    `memory` holds the corners that bound."""

    plant: Plant
    epsilon: float = 1.0
    memory: dict[Any, list[int]] = field(default_factory=dict)

    def propose(self, tau: float, sigma: float, epsilon: float | None = None) -> Proposal:
        """The gain of the largest margin at one epsilon."""
        return self._solved(tau, sigma, self.epsilon if epsilon is None else epsilon)[0]

    def _solved(
        self, tau: float, sigma: float, epsilon: float
    ) -> tuple[Proposal, Callable[[float, float, float], float]]:
        """`propose`, and how far the margin moves to first order where tau, sigma and epsilon do."""
        given = PlantView.floats(self.plant, {})
        units = Units.of(given, tau)
        view = units.view(given)
        n, p, q = self.plant.n, self.plant.p, (2 / np.pi) ** 2
        none = Proposal(np.zeros((n, p)), -np.inf, epsilon)
        if not np.all(np.isfinite(view.vertices)):
            return none, _unmoved
        solution, margin, binding = margin_and_binding(
            {"P": symmetric(n), "S": full(n, n), "Y": full(n, p), "U": symmetric(p)},
            lambda x, A_i: -synthesis(x["P"], x["S"], x["Y"], x["U"], A_i, view.C, q, epsilon, sigma * tau),
            view.vertices,
            (lambda x: x["P"], lambda x: x["U"]),
            lambda x: np.trace(x["P"]) - 1,
            share=0.9 if self._tries else 0.5,
            memory=self.memory,
        )
        x = solution.values

        def pulled(tau: float, sigma: float, epsilon: float) -> float:
            """sum <Z, F> at the same unknowns."""
            view = Units.of(given, tau).view(given)
            forms = (
                synthesis(x["P"], x["S"], x["Y"], x["U"], view.vertices[k], view.C, q, epsilon, sigma * tau)
                for k, _ in binding
            )
            return -sum(float(np.sum(form * Z)) for form, (_, Z) in zip(forms, binding, strict=True))

        here = pulled(tau, sigma, epsilon)
        try:
            L = np.array(np.linalg.solve(x["S"], x["Y"]), dtype=np.float64)
        except np.linalg.LinAlgError:
            return none, _unmoved
        # Where the plant falls into parts, what couples them is the solver's noise.
        L[np.abs(L) < 1e-9 * np.abs(L).max()] = 0.0
        proposal = Proposal(units.gain_out(L), margin, epsilon) if np.all(np.isfinite(L)) else none
        return proposal, lambda *moved: pulled(*moved) - here

    def design(self, tau: float, sigma: float) -> Proposal:
        """The gain of the largest margin met over epsilon: where its slope by ln epsilon is 0."""
        met: dict[float, tuple[Proposal, float]] = {}

        def ask(u: float) -> None:
            epsilon = float(np.exp(u))
            proposal, moved = self._solved(tau, sigma, epsilon)
            met[u] = proposal, moved(tau, sigma, epsilon * (1 + _STEP)) / _STEP

        for part in (1.0, *(_BESIDE if self._tries else _BESIDE[:2])):
            ask(float(np.log(self.epsilon * part)))
        for _ in range(_SECANTS if self._tries else 0):
            best = max(met, key=lambda u: met[u][0].margin)
            slope = met[best][1]
            uphill = [u for u in met if (u - best) * slope > 0]
            if not uphill:
                break
            other = min(uphill, key=lambda u: abs(u - best))
            change = met[other][1] - slope
            share = -slope / change if change * slope < 0 else 0.5
            ask(best + (other - best) * min(max(share, 0.1), 0.9))
        best = max(met, key=lambda u: met[u][0].margin)
        self.epsilon = met[best][0].epsilon
        return met[best][0]

    def redesign(self, tau: float, sigma: float) -> Proposal:
        """`propose` at the epsilon that did well; where that fails, `design`."""
        near = self.propose(tau, sigma)
        return near if near.margin > 0 else self.design(tau, sigma)

    @property
    def _tries(self) -> int:
        return 0 if size(self.plant) > _COARSE else len(_BESIDE)

    def fastest(self, tau: float) -> tuple[float, Proposal]:
        """The largest rate met at one period over epsilon, and its proposal; where there is none the last tried, with a
        margin that is not positive."""
        slow, at_rest = _SLOW / tau, self.redesign(tau, 0.0)
        if not at_rest.margin > 0:
            return 0.0, at_rest
        self.epsilon = at_rest.epsilon
        met: dict[float, Proposal] = {}

        def height(x: Array, sigma: float) -> Height | None:
            epsilon = float(np.exp(x[0]))
            here, moved = self._solved(tau, sigma, epsilon)
            met[sigma] = here
            by_sigma = moved(tau, sigma * (1 + _STEP), epsilon) / (sigma * _STEP)
            return _height(here, moved(tau, sigma, epsilon * (1 + _STEP)) / _STEP, by_sigma)

        first = height(np.log([self.epsilon]), slow)
        if first is None or not first.margin > 0:
            return 0.0, at_rest
        # The margin is nearly convex in sigma: its tangent ends inside.
        sigma = self._ascended(height, min(max(slow + first.rest, slow), _FAST / tau))
        if sigma in met and met[sigma].margin > 0:
            return sigma, met[sigma]
        for part in _INSIDE:
            best = self.propose(tau, part * sigma)
            if best.margin > 0:
                return part * sigma, best
        return 0.0, at_rest

    def longest(self, tau: float, rate: Callable[[float], float]) -> tuple[float, Proposal]:
        """The longest period met, over epsilon, at a rate that may depend on it, looked for from tau. Where there is
        none the last period tried, with a margin that is not positive."""

        def height(x: Array, T: float) -> Height | None:
            epsilon = float(np.exp(x[0]))
            met, moved = self._solved(T, rate(T), epsilon)
            later = T * (1 + _STEP)
            by_period = moved(later, rate(later), epsilon) / (T * _STEP)
            return _height(met, moved(T, rate(T), epsilon * (1 + _STEP)) / _STEP, by_period)

        longest = self._ascended(height, tau)
        for part in _INSIDE:
            best = self.propose(part * longest, rate(part * longest))
            if best.margin > 0:
                break
        return part * longest, best

    def _ascended(self, height: Callable[[Array, float], Height | None], start: float) -> float:
        """Where the margin ends furthest, over epsilon from the one that did well, of large plants for that one; the
        start where it ends nowhere."""
        if not self._tries:
            one = np.log([self.epsilon])
            return end(lambda v: height(one, v), start, _WIDE, 1.0, start / _SPAN) or start
        steps = _STEPS
        for part in (1.0, *_BESIDE[: self._tries]):
            met = Ascent(height, np.ones(1), _WIDTH, steps).run(np.log([self.epsilon * part]), start)
            if met is not None:
                self.epsilon = float(np.exp(met[0][0]))
                return met[1]
        return start


def _height(met: Proposal, by_epsilon: float, by_value: float) -> Height | None:
    return Height(met.margin, np.array([by_epsilon]), by_value) if np.isfinite(met.margin) else None


def _unmoved(tau: float, sigma: float, epsilon: float) -> float:
    return 0.0
