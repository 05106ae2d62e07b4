"""The search for the constants of Theorem 2 as the paper has them: P and K by (8)-(9), then alpha."""

from __future__ import annotations

from itertools import product
from math import exp, log

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certify import search
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.updated_sampling.compass import Point, climb
from cdobs_cli.families.updated_sampling.period import Timing, float_period
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    condition_8,
    condition_9,
    condition_9_lower,
    condition_9_upper,
    lemma_4,
    lemma_5,
    one_step_map,
    theorem_2_a_1,
    theorem_2_a_2_least,
)

Found = tuple[Array, Array, float]
_SLACK = 1e-3


def matrices(n: int, p_1: float, p_3: float, p_4: float, K: Array | None = None) -> tuple[Array, Array] | None:
    """P and K with (8)-(9) and the least p_2 for p_1, p_3, p_4; convex in (P, W = P K). K may be given."""
    from cdobs_cli.certify.lmi import Program, full, symmetric

    chain, identity = Chain.floats(n), np.eye(n)
    program = Program({"P": symmetric(n), "p_2": full(1, 1)} | ({"W": full(n, 1)} if K is None else {}))
    program.require(lambda x: condition_8(x["P"], p_1, x["p_2"], identity)[0])
    program.require(lambda x: condition_8(x["P"], p_1, x["p_2"], identity)[1])
    program.require(lambda x: condition_9(chain, x["P"], x["W"] if K is None else x["P"] @ K) - _SLACK * identity)
    program.require(lambda x: condition_9_lower(chain, x["P"], p_3))
    program.require(lambda x: condition_9_upper(chain, x["P"], p_4))
    program.maximise(lambda x: -x["p_2"])
    values = program.solve().values
    P = values["P"]
    if not np.all(np.isfinite(P)) or np.linalg.eigvalsh(P)[0] <= 0:
        return None
    gain: Array = np.linalg.solve(P, values["W"]).astype(float) if K is None else K
    return None if np.linalg.eigvalsh(condition_9(chain, P, P @ gain))[0] < 0 else (P, gain)


def numbers(P: Array) -> tuple[float, ...]:
    """p_1 .. p_4 of a given P, a little to the safe side."""
    chain = Chain.floats(len(P))
    dilation = np.linalg.eigvals(np.linalg.solve(P, condition_9_lower(chain, P, 0.0))).real
    both = (np.linalg.eigvalsh(P), dilation)
    return tuple(end for v in both for end in (float(v.min()) * (1 - 1e-7), float(v.max()) * (1 + 1e-7)))


def a_2_at(P: Array, K: Array, p: tuple[float, ...], alpha: float, a_1: float, weight: int) -> float:
    """The least a_2 of step 3 at alpha."""
    chain = Chain.floats(len(P))
    norm_Q = float(np.linalg.norm(one_step_map(chain, K, alpha), 2))
    norm_J = float(np.linalg.norm(chain.identity + alpha * (K @ chain.C), 2))
    N_1, N_2 = lemma_5(norm_Q, norm_J, exp(alpha), float(np.linalg.norm(P, 2)), (1 - a_1 * alpha) ** (2 * len(P)))
    return theorem_2_a_2_least(weight, N_1, N_2, p[0], p[2], max)  # type: ignore[no-any-return]


def largest_alpha(P: Array, K: Array, a_1: float, p_2: float) -> float:
    """alpha_m in floats: where (17) is first lost."""
    chain = Chain.floats(len(P))

    def lost(alpha: Exact) -> bool | None:
        size = float(alpha)
        return None if a_1 * size < 1 and np.linalg.eigvalsh(lemma_4(chain, P, K, size, a_1, p_2))[0] > 0 else True

    start = 1e-9
    first = search.smallest(lost, start, 1.6, 4e-9, span=1e18) if lost(search.short(start)) is None else None
    return 0.0 if first is None else float(first[0])


def best_alpha(P: Array, K: Array, weight: int, c: float, alpha: float | None) -> tuple[float, float] | None:
    """The longest guaranteed period for these matrices, and its alpha, which may be given."""
    p = numbers(P)
    a_1 = theorem_2_a_1(p[1], p[3])
    alpha_m = largest_alpha(P, K, a_1, p[1]) * (1 - 1e-6)
    if not alpha_m > 0 or (alpha is not None and alpha > alpha_m):
        return None
    trials = [alpha_m * 0.85**k for k in range(40)] if alpha is None else [alpha]
    timings = (Timing(trial, a_1, a_2_at(P, K, p, trial, a_1, weight), 2.0 * weight) for trial in trials)
    return max((float_period(timing, c), timing.alpha) for timing in timings)


def longest_period(n: int, weight: int, c: float, evaluations: int, alpha: float | None) -> Found | None:
    """P, K and alpha of the best p_1, p_3, p_4 for the period guaranteed while c(x_hat, u) <= c; alpha may be given."""

    def value(point: Point) -> tuple[float, Found] | None:
        found = matrices(n, exp(point[0]), point[1], point[2])
        best = None if found is None else best_alpha(*found, weight, c, alpha)
        return None if found is None or best is None else (best[0], (*found, best[1]))

    grid = product((0.05, 0.2, 0.5), (0.4, 0.8), (0.5, 2.0))
    starts = [(log(p_1), p_3, 2.0 * n + extra) for p_1, p_3, extra in grid]
    lower, upper = (log(1e-4), 0.01, 2.0 * n + 1e-3), (log(10), 1.999, 20.0 * n)
    return climb(value, starts, (0.5, 0.2, 0.6), lower, upper, evaluations)
