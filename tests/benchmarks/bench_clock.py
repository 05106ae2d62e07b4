"""The ladder of the clock certificate, and cones assembled directly against cvxpy.

    python tests/benchmarks/bench_clock.py [ladder | direct] [--steps 6]

ladder: the pendulum by every method. direct: a bisection at n = 3 through Search and through cvxpy on the same
inequalities, in one run. Without a word both. `growth.py` draws how it grows with n.
"""

from __future__ import annotations

import argparse
import time

import rooms  # noqa: F401 - opens the folders
from table import row


def direct(steps: int) -> None:
    """The same periods, the same inequalities and the same solver: only the way to the cones differs."""
    import clarabel
    import cvxpy as cp
    import numpy as np
    from example_inclusions import canonical, impulsive, periodic

    from cdobs_cli.certify.bernstein import derivative, elevation
    from cdobs_cli.certify.methods.base import Question
    from cdobs_cli.certify.methods.clock.certificate import _guess_gain, basis
    from cdobs_cli.certify.methods.clock.form import Shape, in_basis

    c, shape = [1, 1, 1], Shape(4, 5, 4, 0)

    def open_loop(T):
        return impulsive(canonical(c, periodic(f"{T:.16f}")), [["0"]] * 3)

    def by_search(T, cuts):
        return _guess_gain(Question(open_loop(T), memory=cuts), shape) is not None

    def by_cvxpy(T, _):
        inclusion = open_loop(T)
        S = np.array(basis(inclusion), dtype=float)
        maps = in_basis(inclusion.floats, S, np.linalg.inv(S))
        C = inclusion.plant.C.floats @ S
        P = [cp.Variable((3, 3), symmetric=True) for _ in range(shape.count)]
        W, t = cp.Variable((3, 1)), cp.Variable()
        constraints = [cp.trace(P[0]) == 1, cp.bmat([[P[0], P[0] - W @ C], [(P[0] - W @ C).T, P[-1]]]) >> t * np.eye(6)]
        G, E = (np.array(rows, dtype=float) for rows in (derivative(4, 5), elevation(4, 5)))
        for piece in range(4):
            local = P[4 * piece : 4 * piece + 5]
            for g, e in zip(G, E, strict=True):
                slope = sum(weight * matrix for weight, matrix in zip(g, local, strict=True))
                value = sum(weight * matrix for weight, matrix in zip(e, local, strict=True)) / 4
                constraints += [slope + value @ (A * T) + (A * T).T @ value << -t * np.eye(3) for A in maps.corners()]
        problem = cp.Problem(cp.Maximize(t), constraints)
        problem.solve(solver=cp.CLARABEL, max_threads=1, tol_gap_abs=1e-8, tol_gap_rel=1e-8, tol_feas=1e-8)
        return problem.status in ("optimal", "optimal_inaccurate") and t.value > 0

    results = {}
    for name, feasible in (("direct", by_search), ("cvxpy", by_cvxpy)):
        low, high, cuts = 0.3, 0.9, {}
        began = time.process_time()
        for _ in range(steps):
            middle = (low + high) / 2
            low, high = (middle, high) if feasible(middle, cuts) else (low, middle)
        results[name] = (time.process_time() - began, low)
        print(
            f"{name:7s} {results[name][0]:8.2f} s for {steps} steps to T = {low:.6f}, clarabel {clarabel.__version__}",
            flush=True,
        )
    row("clock certificate, cones assembled directly / by cvxpy", results["direct"][0], results["cvxpy"][0], 0.1)


def ladder() -> None:
    """The pendulum: what each method proves, any gain."""
    from example_inclusions import canonical, impulsive, periodic

    from cdobs_cli.certify.methods.base import Question
    from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
    from cdobs_cli.certify.methods.planar.extremals import limit_any_gain, planar_class

    pendulum = impulsive(canonical([1, 0], periodic("1")), [["0"], ["0"]])
    spent = []
    print("printed set, (31) and (13)      0.668   (Dinh2014)")
    for effort in range(4):
        began = time.process_time()
        best = ImpulsiveGain().longest(Question(pendulum, effort=effort))
        print(f"clock certificate, effort {effort}     {best.law.T_max}")
        spent.append(time.process_time() - began)
    row("clock certificate of the pendulum, effort 2 / effort 1", spent[2], spent[1])
    family, _ = planar_class(pendulum)
    print(f"exact limit for K_1 = 1         {limit_any_gain(family, 3.0):.10f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["direct", "ladder", "both"], nargs="?", default="both")
    parser.add_argument("--steps", type=int, default=6)
    options = parser.parse_args()
    if options.what != "direct":
        ladder()
    if options.what != "ladder":
        direct(options.steps)


if __name__ == "__main__":
    main()
