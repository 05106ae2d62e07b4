"""The search for the constants of Theorem 2 as the paper has them: P and K by (8)-(9), then alpha."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log
from typing import TYPE_CHECKING

from cdobs_cli.families.updated_sampling.compass import Point, climb
from cdobs_cli.families.updated_sampling.period import Timing, float_period
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    condition_8_lower,
    condition_8_upper,
    condition_9,
    condition_9_lower,
    condition_9_upper,
    lemma_4,
    lemma_5_N_1,
    lemma_5_N_2,
    one_step_map,
    theorem_2_a_1,
    theorem_2_a_2_least,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.design import SolverRecord

    Array = NDArray[np.float64]

_SLACK = 1e-3


@dataclass(frozen=True)
class PaperDesign:
    """P, K and the numbers of (8)-(9) as they are for this P, alpha and the a_1, a_2 that go with it."""

    P: Array
    K: Array
    p: tuple[float, float, float, float]
    alpha: float
    a_1: float
    a_2: float
    record: SolverRecord | None = None


def matrices(n: int, p_1: float, p_3: float, p_4: float, K: Array | None = None) -> tuple[Array, Array, SolverRecord] | None:
    """P and K with (8)-(9) and the least p_2 for p_1, p_3, p_4; convex in (P, W = P K). K may be given."""
    import numpy as np

    from cdobs_cli.certify.lmi import Program, full, symmetric

    chain, identity = Chain.floats(n), np.eye(n)
    unknowns = {"P": symmetric(n), "p_2": full(1, 1)} | ({"W": full(n, 1)} if K is None else {})
    program = Program(unknowns)
    program.require(lambda x: condition_8_lower(x["P"], p_1, identity))
    program.require(lambda x: condition_8_upper(x["P"], x["p_2"], identity))
    program.require(lambda x: condition_9(chain, x["P"], x["W"] if K is None else x["P"] @ K) - _SLACK * identity)
    program.require(lambda x: condition_9_lower(chain, x["P"], p_3))
    program.require(lambda x: condition_9_upper(chain, x["P"], p_4))
    program.maximise(lambda x: -x["p_2"])
    solution = program.solve()
    P = solution.values["P"]
    if not np.all(np.isfinite(P)) or np.linalg.eigvalsh(P)[0] <= 0:
        return None
    gain: Array = np.linalg.solve(P, solution.values["W"]).astype(float) if K is None else K
    if np.linalg.eigvalsh(condition_9(chain, P, P @ gain))[0] < 0:
        return None
    return P, gain, solution.record


def numbers(P: Array) -> tuple[float, float, float, float]:
    """p_1 .. p_4 of a given P, a little to the safe side."""
    import numpy as np

    chain = Chain.floats(len(P))
    ends = np.linalg.eigvalsh(P)
    dilation = np.linalg.eigvals(np.linalg.solve(P, condition_9_lower(chain, P, 0.0))).real
    return (
        float(ends[0]) * (1 - 1e-7), float(ends[-1]) * (1 + 1e-7),
        float(dilation.min()) * (1 - 1e-7), float(dilation.max()) * (1 + 1e-7),
    )  # fmt: skip


def a_2_at(P: Array, K: Array, p: tuple[float, float, float, float], alpha: float, a_1: float, weight: int) -> float:
    """The least a_2 of step 3 at alpha."""
    import numpy as np

    chain = Chain.floats(len(P))
    norm_Q = float(np.linalg.norm(one_step_map(chain, K, alpha), 2))
    norm_J = float(np.linalg.norm(chain.identity + alpha * (K @ chain.C), 2))
    norm_P, scale = float(np.linalg.norm(P, 2)), (1 - a_1 * alpha) ** (2 * len(P))
    N_1 = lemma_5_N_1(norm_Q, norm_J, exp(alpha), norm_P, scale)
    N_2 = lemma_5_N_2(norm_J, exp(alpha), norm_P, scale)
    return theorem_2_a_2_least(weight, N_1, N_2, p[0], p[2], max)  # type: ignore[no-any-return]


def largest_alpha(P: Array, K: Array, a_1: float, p_2: float) -> float:
    """alpha_m in floats: where (17) is first lost, by doubling and bisection."""
    import numpy as np

    chain = Chain.floats(len(P))

    def holds(alpha: float) -> bool:
        return a_1 * alpha < 1 and bool(np.linalg.eigvalsh(lemma_4(chain, P, K, alpha, a_1, p_2))[0] > 0)

    low = 1e-9
    if not holds(low):
        return 0.0
    while holds(low * 1.25):
        low *= 1.25
    high = low * 1.25
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def best_alpha(P: Array, K: Array, weight: int, c: float, alpha: float | None) -> tuple[float, float, float, float] | None:
    """(period, alpha, a_1, a_2) of the longest guaranteed period for these matrices; alpha may be given."""
    p = numbers(P)
    a_1 = theorem_2_a_1(p[1], p[3])
    alpha_m = largest_alpha(P, K, a_1, p[1]) * (1 - 1e-6)
    if not alpha_m > 0:
        return None

    def at(trial: float) -> tuple[float, float, float, float]:
        a_2 = a_2_at(P, K, p, trial, a_1, weight)
        return float_period(Timing(trial, a_1, a_2, 2.0 * weight), c), trial, a_1, a_2

    if alpha is not None:
        return at(alpha) if alpha <= alpha_m else None
    return max(at(alpha_m * 0.85**k) for k in range(40))


def longest_period(n: int, weight: int, c: float, evaluations: int, alpha: float | None = None) -> PaperDesign | None:
    """The best p_1, p_3, p_4 and alpha for the period guaranteed while c(x_hat, u) <= c."""

    def value(point: Point) -> tuple[float, PaperDesign] | None:
        found = matrices(n, exp(point[0]), point[1], point[2])
        if found is None:
            return None
        P, K, record = found
        best = best_alpha(P, K, weight, c, alpha)
        if best is None:
            return None
        return best[0], PaperDesign(P, K, numbers(P), best[1], best[2], best[3], record)

    starts = [(log(p_1), p_3, 2.0 * n + extra) for p_1 in (0.05, 0.2, 0.5) for p_3 in (0.4, 0.8) for extra in (0.5, 2.0)]
    tried = [(outcome[0], start) for start in starts if (outcome := value(start)) is not None]
    if not tried:
        return None
    best = climb(
        value, max(tried)[1], (0.5, 0.2, 0.6), (log(1e-4), 0.01, 2.0 * n + 1e-3), (log(10), 1.999, 20.0 * n), evaluations
    )  # fmt: skip
    return None if best is None else best[1]
