"""Error bounds: chains of integrators with one slope, n = 2 .. 5, CPU time and memory of each bound.

python tests/benchmarks/bench_accuracy.py [largest n]
"""

import resource
import sys
import time

import rooms  # noqa: F401 - opens the folders
from example_inclusions import periodic, plant
from noisy_examples import noisy
from table import row

from cdobs_cli.certify.adversary import attained
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.peak.certificate import Peak
from cdobs_cli.families.reachability import Reachability


def chain(n):
    A = [[int(j == i + 1) for j in range(n)] for i in range(n)]
    low = [["-1" if (i, j) == (n - 1, 0) else 0 for j in range(n)] for i in range(n)]
    high = [["1" if (i, j) == (n - 1, 0) else 0 for j in range(n)] for i in range(n)]
    made = plant(A, low, high, [[int(j == 0) for j in range(n)]], periodic("0.3"))
    return noisy(made, [*[0] * (n - 1), "0.05"], ["0.01"])


if __name__ == "__main__":
    print(f"{'n':>2} {'state':>5} {'proved':>10} {'reached':>10} {'solve s':>8} {'prove s':>8} {'memory MB':>9}")
    spent = {}
    for n in range(2, 1 + (int(sys.argv[1]) if len(sys.argv) > 1 else 5)):
        made = chain(n)
        free = Reachability().question(made, {}, 1)
        met = design_impulsive(free)
        assert met is not None
        question = free.with_gain({"K": met[0]})
        for i in (0, n - 1):
            start = time.process_time()
            proposal = Peak.propose(question.of_state(i).afresh())
            solved = time.process_time() - start
            spent[n] = spent.get(n, 0.0) + solved
            start = time.process_time()
            error = None if proposal is None else proposal.prove(question).error
            proved = time.process_time() - start
            reached = attained(question.inclusion, i, 1)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            told = ["-" if value is None else f"{float(value):.5g}" for value in (error, reached and reached[0])]
            print(f"{n:>2} {i + 1:>5} {told[0]:>10} {told[1]:>10} {solved:8.2f} {proved:8.3f} {memory:9.0f}")
    largest = max(spent)
    if largest > 2:
        row(f"error bounds, n = {largest} / n = {largest - 1}", spent[largest], spent[largest - 1], 4)
