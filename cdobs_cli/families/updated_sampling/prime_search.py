"""The search for (P, K, alpha, a_1, a_2) of Theorem 2' that makes the guaranteed sampling period longest.

For fixed alpha, a_1 alpha and p_3 the least g of (ii) is a generalised eigenvalue problem in P: K drops out
of (i) by the projection lemma (or is given). Slopes and clock values enter as they are found to matter.
"""

from __future__ import annotations

from dataclasses import field
from math import exp, log
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.families.updated_sampling.compass import Point, climb
from cdobs_cli.families.updated_sampling.domination import clock_points, corner_arrays, growth_at, largest_growth
from cdobs_cli.families.updated_sampling.period import Timing, float_period
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    condition_9_lower,
    deadbeat_gain,
    last_row_bound,
    solvable_i,
    theorem_2_prime_i,
    theorem_2_prime_ii,
    transported,
)
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.certify.lmi import Program

EPSILON = 1e-4
_ROUNDS = 25


@dataclass(frozen=True)
class Found:
    """A guess in floats: g of (ii) at the clock points, and the matrices and numbers it belongs to."""

    g: float
    P: Array
    K: Array
    alpha: float
    a_1_alpha: float
    p_3: float

    @property
    def a_2(self) -> float:
        return self.g / self.p_3


@dataclass
class PrimeSearch:
    """`K`: the gain, where it is given. `pool`: (corner, clock point) pairs that have mattered so far."""

    n: int
    variant: str
    K: Array | None = None
    pool: list[tuple[int, int]] = field(default_factory=list)

    def least_growth(self, alpha: float, a_1_alpha: float, p_3: float) -> Found | None:
        """P of the least g; each round takes g from the P before it until it no longer falls."""
        chain = Chain.floats(self.n)
        # In z = S^-1 w the period is 1 and P is well scaled.
        S = np.diag(float(alpha) ** -np.arange(float(self.n)))
        g, best = 40.0 * self.n, None
        for _ in range(_ROUNDS):
            P_z, margin = self._solve(S, alpha, a_1_alpha, p_3, g)
            P = np.linalg.solve(S, np.linalg.solve(S, P_z).T)
            if not self._is_feasible(P, alpha, a_1_alpha):
                break
            now, fresh = self._growth(P, alpha)
            better = best is None or now < best[0] * (1 - 2e-3)
            if best is None or now < best[0]:
                best = (now, P)
            if (not better and not fresh) or (margin <= 1e-9 and not fresh):
                break
            g = best[0]
        if best is None:
            return None
        g, P = best
        gain = deadbeat_gain(chain, P, alpha, np.linalg.solve) if self.K is None else self.K
        true_p_3 = float(np.linalg.eigvals(np.linalg.solve(P, condition_9_lower(chain, P, 0.0))).real.min())
        return Found(g, P, gain, alpha, a_1_alpha, true_p_3)

    def _condition_i(self, P: Array, alpha: float, a_1_alpha: float, *, room: float) -> Array:
        """(i), met by some K or by the given one; with room 1 as the solver is asked, with 0 as little as will do."""
        chain = Chain.floats(self.n)
        if self.K is None:
            return solvable_i(chain, P, alpha, a_1_alpha, EPSILON * (1 + room) / 2)  # type: ignore[no-any-return]
        return theorem_2_prime_i(chain, P, self.K, alpha, a_1_alpha / alpha, 1e-7 * room)  # type: ignore[no-any-return]

    def _is_feasible(self, P: Array, alpha: float, a_1_alpha: float) -> bool:
        if not np.all(np.isfinite(P)) or np.linalg.eigvalsh(P)[0] <= 0:
            return False
        gap = self._condition_i(P, alpha, a_1_alpha, room=0)
        return bool(np.linalg.eigvalsh(gap)[0] > 0 if gap.size else True)

    def _growth(self, P: Array, alpha: float) -> tuple[float, bool]:
        """g at the clock points, and whether a pair that was not in the pool matters."""
        if self.variant != "triangular":
            return largest_growth(P, alpha, self.variant), False
        worst = []
        for k, tau in enumerate(clock_points(alpha)):
            values = growth_at(P, corner_arrays(self.n), tau)
            corner = int(values.argmax())
            worst.append((float(values[corner]), corner, k))
        worst.sort(reverse=True)
        g = worst[0][0]
        fresh = [(corner, k) for value, corner, k in worst[:4] if value > 0.9 * g and (corner, k) not in self.pool]
        self.pool += fresh
        return g, bool(fresh)

    def _solve(self, S: Array, alpha: float, a_1_alpha: float, p_3: float, g: float) -> tuple[Array, float]:
        """P in the coordinates z and the margin by which it meets (ii) at g over the pool."""
        from cdobs_cli.certify.lmi import Program, full, symmetric

        n, chain, taus = self.n, Chain.floats(self.n), clock_points(alpha)
        inverse = np.diag(1 / np.diag(S))
        unknowns = {"P": symmetric(n), "t": full(1, 1)}
        if self.variant != "triangular":
            unknowns |= {f"mu.{k}": full(1, 1) for k in range(len(taus))}
        program = Program(unknowns)

        def condition_i(P: Array) -> Array:
            gap = self._condition_i(P, alpha, a_1_alpha, room=1)
            scale = S[n - len(gap) :, n - len(gap) :]
            return scale @ gap @ scale

        program.require(lambda x: condition_i(inverse @ x["P"] @ inverse))
        program.require(lambda x: condition_9_lower(chain, x["P"], p_3))
        program.require(lambda x: x["P"] - 1e-6 * chain.identity)
        if self.variant == "triangular":
            if not self.pool:
                self._growth(inverse @ np.diag(0.3 ** np.arange(n)) @ inverse, alpha)
            for corner, k in self.pool:
                T = inverse @ transported(chain, corner_arrays(n)[corner], taus[k]) @ S

                def dominates(x: dict[str, Array], T: Array = T) -> Array:
                    return theorem_2_prime_ii(x["P"], T, g) - x["t"] * chain.identity  # type: ignore[no-any-return]

                program.require(dominates)  # type: ignore[arg-type]
        else:
            self._require_last_row(program, S, taus, g)
        program.equate(lambda x: np.array([[np.trace(x["P"]) - 1]]))
        program.maximise(lambda x: x["t"])
        solution = program.solve()
        return solution.values["P"], solution.objective

    def _require_last_row(self, program: Program, S: Array, taus: Array, g: float) -> None:
        chain, inverse = Chain.floats(self.n), np.diag(1 / np.diag(S))
        unit, room = inverse[:, [-1]], np.diag([1.0] * self.n + [0.0])
        for k, tau in enumerate(taus):
            forth = inverse @ chain.exp(-tau) @ S

            def bound(x: dict[str, Array], forth: Array = forth, k: int = k) -> Array:
                P_tau, mu = forth.T @ x["P"] @ forth, x[f"mu.{k}"][0, 0]
                held: Array = last_row_bound(P_tau, unit, S @ S, g, mu, np.eye(1))
                return held - x["t"] * room

            program.require(bound)  # type: ignore[arg-type]


def longest_period(search: PrimeSearch, c: float, evaluations: int, alpha: float | None) -> Found | None:
    """The best (alpha, a_1 alpha, p_3) for the period guaranteed while c(x_hat, u) <= c; alpha may be given."""

    def value(point: Point) -> tuple[float, Found] | None:
        found = search.least_growth(exp(point[0]), point[1], point[2])
        if found is None:
            return None
        return float_period(Timing(found.alpha, found.a_1_alpha / found.alpha, found.a_2, 0.0), c), found

    kappa, free = 0.75 / search.n, alpha is None
    logs = [log(0.1 * 2.5**k) for k in range(5)] if alpha is None else [log(alpha)]
    lowest, highest = (log(1e-3), log(1e3)) if free else (logs[0], logs[0])
    return climb(
        value, [(one, kappa, 1.85) for one in logs], (0.4 if free else 0.0, 0.15 * kappa, 0.07),
        (lowest, 1e-3, 0.2), (highest, 0.95, 1.9995), evaluations,
    )  # fmt: skip


def best_p_3(search: PrimeSearch, alpha: float, a_1_alpha: float, evaluations: int) -> Found | None:
    """The least a_2 = g / p_3 over p_3, of the gain that is given."""

    def value(point: Point) -> tuple[float, Found] | None:
        found = search.least_growth(alpha, a_1_alpha, point[0])
        return None if found is None else (1 / found.a_2, found)

    return climb(value, [(p_3,) for p_3 in (0.4, 0.8, 1.2, 1.5, 1.8, 1.95)], (0.1,), (0.01,), (1.9995,), evaluations)
