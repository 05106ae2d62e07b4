"""The search for (P, K, alpha, a_1, a_2) of Theorem 2' that makes the guaranteed sampling period longest.

For fixed alpha, a_1 alpha and p_3 the least g of (ii) is a generalised eigenvalue problem in P: K drops out
of (i) by the projection lemma (or is given). Slopes and clock values enter as they are found to matter.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, log
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.design import SolverRecord

    Array = NDArray[np.float64]

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
    """`pool`: (corner, clock point) pairs that have mattered so far; `record`: how the last solve went."""

    n: int
    variant: str
    pool: list[tuple[int, int]] = field(default_factory=list)
    record: SolverRecord | None = None

    def least_growth(self, alpha: float, a_1_alpha: float, p_3: float, K: Array | None = None) -> Found | None:
        """P of the least g; each round takes g from the P before it until it no longer falls."""
        import numpy as np

        chain, n = Chain.floats(self.n), self.n
        # In z = S^-1 w the period is 1 and P is well scaled.
        S = np.diag(float(alpha) ** -np.arange(float(n)))
        g, best = 40.0 * n, None
        for _ in range(_ROUNDS):
            P_z, margin = self._solve(chain, S, alpha, a_1_alpha, p_3, g, K)
            P = np.linalg.solve(S, np.linalg.solve(S, P_z).T)
            if not self._is_feasible(chain, P, alpha, a_1_alpha, K):
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
        gain = deadbeat_gain(chain, best[1], alpha, np.linalg.solve) if K is None else K
        true_p_3 = float(np.linalg.eigvals(np.linalg.solve(best[1], condition_9_lower(chain, best[1], 0.0))).real.min())
        return Found(best[0], best[1], gain, alpha, a_1_alpha, true_p_3)

    def _is_feasible(self, chain: Chain[Array], P: Array, alpha: float, a_1_alpha: float, K: Array | None) -> bool:
        import numpy as np

        if not np.all(np.isfinite(P)) or np.linalg.eigvalsh(P)[0] <= 0:
            return False
        if K is None:
            gap = solvable_i(chain, P, alpha, a_1_alpha, EPSILON / 2)
        else:
            gap = theorem_2_prime_i(chain, P, K, alpha, a_1_alpha / alpha, 0.0)
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

    def _solve(
        self, chain: Chain[Array], S: Array, alpha: float, a_1_alpha: float, p_3: float, g: float, K: Array | None
    ) -> tuple[Array, float]:
        """P in the coordinates z and the margin by which it meets (ii) at g over the pool."""
        import numpy as np

        from cdobs_cli.certify.lmi import Program, full, symmetric

        n, identity = self.n, np.eye(self.n)
        taus = clock_points(alpha)
        inverse = np.diag(1 / np.diag(S))
        unknowns = {"P": symmetric(n), "t": full(1, 1)}
        if self.variant != "triangular":
            unknowns |= {f"mu.{k}": full(1, 1) for k in range(len(taus))}
        program = Program(unknowns)

        def original(P_z: Array) -> Array:
            return inverse @ P_z @ inverse

        if K is None:
            program.require(lambda x: S[1:, 1:] @ solvable_i(chain, original(x["P"]), alpha, a_1_alpha, EPSILON) @ S[1:, 1:])
        else:
            program.require(lambda x: S @ theorem_2_prime_i(chain, original(x["P"]), K, alpha, a_1_alpha / alpha, 1e-7) @ S)
        program.require(lambda x: condition_9_lower(chain, x["P"], p_3))
        program.require(lambda x: x["P"] - 1e-6 * identity)
        if self.variant == "triangular":
            if not self.pool:
                self._growth(original(np.diag(0.3 ** np.arange(n))), alpha)
            for corner, k in self.pool:
                T = inverse @ transported(chain, corner_arrays(n)[corner], taus[k]) @ S
                program.require(lambda x, T=T: theorem_2_prime_ii(x["P"], T, g) - x["t"] * identity)  # type: ignore[misc]
        else:
            self._require_last_row(program, chain, S, inverse, taus, g)
        program.equate(lambda x: np.array([[np.trace(x["P"]) - 1]]))
        program.maximise(lambda x: x["t"])
        solution = program.solve()
        self.record = solution.record
        return solution.values["P"], solution.objective

    def _require_last_row(self, program: object, chain: Chain[Array], S: Array, inverse: Array, taus: Array, g: float) -> None:
        import numpy as np

        unit = S[:, [-1]] * 0
        unit[-1, 0] = inverse[-1, -1]
        one = np.eye(1)
        room = np.diag([1.0] * self.n + [0.0])
        for k, tau in enumerate(taus):
            forth = inverse @ chain.exp(-tau) @ S

            def bound(x: dict[str, Array], forth: Array = forth, k: int = k) -> Array:
                P_tau = forth.T @ x["P"] @ forth
                return last_row_bound(P_tau, unit, S @ S, g, x[f"mu.{k}"][0, 0], one) - x["t"] * room  # type: ignore[no-any-return]

            program.require(bound)  # type: ignore[attr-defined]


def longest_period(n: int, variant: str, c: float, evaluations: int, alpha: float | None = None) -> tuple[Found, PrimeSearch] | None:
    """The best (alpha, a_1 alpha, p_3) for the period guaranteed while c(x_hat, u) <= c; alpha may be given."""
    search = PrimeSearch(n, variant)

    def value(point: Point) -> tuple[float, Found] | None:
        found = search.least_growth(exp(point[0]), point[1], point[2])
        if found is None:
            return None
        return float_period(Timing(found.alpha, found.a_1_alpha / found.alpha, found.a_2, 0.0), c), found

    kappa, p_3 = 0.75 / n, 1.85
    starts = [log(alpha)] if alpha is not None else [log(0.1 * 2.5**k) for k in range(5)]
    tried = [(outcome[0], start) for start in starts if (outcome := value((start, kappa, p_3))) is not None]
    if not tried:
        return None
    start = max(tried)[1]
    free = alpha is None
    best = climb(
        value, (start, kappa, p_3), (0.4 if free else 0.0, 0.15 * kappa, 0.07),
        (log(1e-3) if free else start, 1e-3, 0.2), (log(1e3) if free else start, 0.95, 1.9995), evaluations,
    )  # fmt: skip
    return None if best is None else (best[1], search)


def best_p_3(search: PrimeSearch, alpha: float, a_1_alpha: float, K: Array, evaluations: int) -> Found | None:
    """The least a_2 = g / p_3 of a given gain over p_3."""

    def value(point: Point) -> tuple[float, Found] | None:
        found = search.least_growth(alpha, a_1_alpha, point[0], K)
        return None if found is None else (1 / found.a_2, found)

    tried = [(outcome[0], p_3) for p_3 in (0.4, 0.8, 1.2, 1.5, 1.8, 1.95) if (outcome := value((p_3,))) is not None]
    if not tried:
        return None
    best = climb(value, (max(tried)[1],), (0.1,), (0.01,), (1.9995,), evaluations)
    return None if best is None else best[1]
