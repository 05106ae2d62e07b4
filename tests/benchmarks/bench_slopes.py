"""The slope prover: times of the listed plants, and 1e5 points on each of many random expressions.

python tests/benchmarks/bench_slopes.py [expressions]
"""

import sys
import time
from functools import partial

import rooms  # noqa: F401 - opens the folders
from table import cpu, row
from test_proved_bounds import sampled_violations
from test_slopes import bioreactor, make_plant

from cdobs_cli.bounds.slopes import resolve, slope_claims


def timed(name, work):
    start = time.perf_counter()
    result = work()
    print(f"{name:48} {1e3 * (time.perf_counter() - start):9.1f} ms  {result}")


def decided(plant):
    return {claim.id: claim.status for claim in slope_claims(plant) if claim.id.startswith("slopes")}


def line(phi, low, high):
    return make_plant(["a", "b"], ["0", phi], [["0", "0"], [low, "0"]], [["0", "0"], [high, "0"]])


if __name__ == "__main__":
    for phi, low, high in (
        ("sin(a)", "-1", "1"),
        ("0.3*sin(a)", "-0.3", "0.3"),
        ("tanh(a)", "0", "1"),
        ("sat(a)", "0", "1"),
    ):
        timed(f"{phi} on R", partial(decided, line(phi, low, high)))
    box = {"x1": ("-2", "2"), "x2": ("-3", "3")}
    oscillator = make_plant(["x1", "x2"], ["0", "(1 - x1**2)*x2"], box=box, auto=[(1, 0), (1, 1)])
    timed("van der Pol, auto", lambda: resolve(oscillator)[1])
    for below, second in (("2.05", "6.51"), ("1.99", "6.49"), ("2", "6.5")):
        timed(f"bioreactor, {below} and {second}", partial(decided, bioreactor(below, second)))
    timed("bioreactor, auto", lambda: resolve(bioreactor(auto=[(0, 0), (1, 0), (1, 1)]))[1])
    start = time.perf_counter()
    violations, looseness = sampled_violations(7, int(sys.argv[1]) if len(sys.argv) > 1 else 100, 100_000)
    seconds = time.perf_counter() - start
    print(f"{len(looseness)} random slopes, 1e5 points each: {len(violations)} violations, {seconds:.1f} s")
    plant = bioreactor(auto=[(0, 0), (1, 0), (1, 1)])
    found, proved = cpu(partial(resolve, plant)), cpu(partial(decided, bioreactor("2.05", "6.51")))
    row("slopes of the bioreactor, found and proved / proved as typed", found, proved, 4)
