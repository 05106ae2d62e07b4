"""The ladder and the growth of the clock certificate, and cones assembled directly against cvxpy.

    python tests/benchmarks/bench_clock.py growth [--largest 8] [--folder DIR]
    python tests/benchmarks/bench_clock.py direct
    python tests/benchmarks/bench_clock.py [ladder]

growth: for canonical plants of n states, c = (1, 0, ..) and (1, .., 1): the period proved, solve and proof seconds,
flow inequalities and cuts imposed, peak memory; a process for each plant. direct: a bisection of 40 steps at n = 3
through Search and through cvxpy on the same inequalities, in one run. ladder: the pendulum by every method.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "certify"))

# Where the search for a period starts.
START = {
    False: dict.fromkeys(range(2, 9), 0.9),
    True: dict(zip(range(2, 9), (0.7, 0.5, 0.35, 0.28, 0.22, 0.18, 0.15), strict=True)),
}


def one(n: int, ones: bool, effort: int) -> None:
    from example_inclusions import canonical, impulsive, periodic

    from cdobs_cli.certify.methods.base import Question
    from cdobs_cli.certify.methods.clock.design import ImpulsiveGain

    c = [1] * n if ones else [1] + [0] * (n - 1)
    question = Question(impulsive(canonical(c, periodic(str(START[ones][n]))), [["0"]] * n), effort=effort)
    began = time.perf_counter()
    best = ImpulsiveGain().longest(question)
    searched = time.perf_counter() - began
    began = time.perf_counter()
    proved = best.method.prove(question.with_gain({"K": best.gain})).holds
    shape = best.method.shape
    flow = shape.pieces * (shape.D + 1) * 2 ** len(question.inclusion.entries)
    print(
        json.dumps(
            {
                "n": n, "c": "ones" if ones else "first", "T": str(best.law.T_max), "proved": proved,
                "search_s": round(searched, 2), "proof_s": round(time.perf_counter() - began, 2),
                "flow_inequalities": flow, "degree": shape.d, "pieces": shape.pieces,
                "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            }
        )
    )  # fmt: skip


def growth(largest: int, effort: int, folder: Path) -> None:
    found = []
    for ones in (False, True):
        for n in range(2, largest + 1):
            command = [sys.executable, __file__, "one", "--states", str(n), "--effort", str(effort)] + (
                ["--ones"] if ones else []
            )
            line = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
            print(line, flush=True)
            found.append(json.loads(line))
    draw_growth(found, folder)


def draw_growth(found: list[dict], folder: Path) -> None:
    """Seconds, inequalities and memory against n: clock_growth.svg, .png, .csv."""
    from cdobs_cli.chart import Chart, Panel, Series
    from cdobs_cli.report.drawings import figure_files

    quantities = {
        "search_s": "search (s)",
        "proof_s": "proof (s)",
        "flow_inequalities": "flow inequalities",
        "peak_MB": "memory (MB)",
    }
    labels = {"first": "c = (1, 0, ..)", "ones": "c = (1, .., 1)"}
    rows = {c: [row for row in found if row["c"] == c] for c in labels}

    def series(name: str, c: str) -> Series:
        return Series(labels[c], [row["n"] for row in rows[c]], [max(row[name], 0.01) for row in rows[c]])

    panels = tuple(
        Panel("states n", text, y_scale="log", series=tuple(series(name, c) for c in labels))
        for name, text in quantities.items()
    )
    folder.mkdir(parents=True, exist_ok=True)
    chart = Chart(
        "clock_growth", "Growth with the number of states", "The largest period found, at one effort.", panels
    )
    for ending, content in figure_files(chart, ("svg", "png")).items():
        (folder / f"clock_growth.{ending}").write_bytes(content)


def direct(steps: int = 40) -> None:
    """The same 40 periods, the same inequalities and the same solver: only the way to the cones differs."""
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
        began = time.perf_counter()
        for _ in range(steps):
            middle = (low + high) / 2
            low, high = (middle, high) if feasible(middle, cuts) else (low, middle)
        results[name] = (time.perf_counter() - began, low)
        print(
            f"{name:7s} {results[name][0]:8.2f} s for {steps} steps to T = {low:.6f}, clarabel {clarabel.__version__}",
            flush=True,
        )
    print(f"ratio {results['cvxpy'][0] / results['direct'][0]:.1f}")


def ladder() -> None:
    """The pendulum: what each method proves, any gain."""
    from example_inclusions import canonical, impulsive, periodic

    from cdobs_cli.certify.methods.base import Question
    from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
    from cdobs_cli.certify.methods.planar.extremals import limit_any_gain, planar_class

    pendulum = impulsive(canonical([1, 0], periodic("1")), [["0"], ["0"]])
    print("printed set, (31) and (13)      0.668   (Dinh2014)")
    for effort in range(4):
        best = ImpulsiveGain().longest(Question(pendulum, effort=effort))
        print(f"clock certificate, effort {effort}     {best.law.T_max}")
    family, _ = planar_class(pendulum)
    print(f"exact limit for K_1 = 1         {limit_any_gain(family, 3.0):.10f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["growth", "direct", "ladder", "one"], nargs="?", default="ladder")
    parser.add_argument("--largest", type=int, default=8)
    parser.add_argument("--effort", type=int, default=1)
    parser.add_argument("--states", type=int, default=3)
    parser.add_argument("--ones", action="store_true")
    parser.add_argument("--folder", type=Path, default=Path("results/benchmarks"))
    options = parser.parse_args()
    match options.what:
        case "growth":
            growth(options.largest, options.effort, options.folder)
        case "direct":
            direct()
        case "ladder":
            ladder()
        case "one":
            one(options.states, options.ones, options.effort)


if __name__ == "__main__":
    main()
