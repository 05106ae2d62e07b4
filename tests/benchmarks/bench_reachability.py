"""How the set and its LMI grow with n: chains with one slope, the longest period at effort 1.

python tests/benchmarks/bench_reachability.py [largest n, default 6]
"""

from __future__ import annotations

import resource
import sys
import time

import rooms  # noqa: F401 - opens the folders
from reachability_plants import symmetric_chain
from table import row

from cdobs_cli.families.reachability import Reachability


def main(largest: int) -> None:
    print(f"{'n':>2} {'period':>9} {'members':>8} {'CPU synth':>10} {'CPU check':>10} {'memory MB':>10}")
    spent = {}
    for n in range(2, largest + 1):
        p = symmetric_chain((1,) + (0,) * (n - 1), "0.8")
        family = Reachability(objective="max_period", method="set")
        start = time.process_time()
        design = family.synthesize(p, 1)
        middle = time.process_time()
        check = family.certify(p, design, 1)
        end = time.process_time()
        spent[n] = end - start
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        period = check.bounds["period_max.set"].proved
        print(
            f"{n:>2} {period:>9} {2 ** (2 * n - 2):>8} {middle - start:>10.2f} {end - middle:>10.2f} {memory:>10.0f}",
            flush=True,
        )
    if largest > 2:
        # Four times the members.
        row(f"set method, n = {largest} / n = {largest - 1}", spent[largest], spent[largest - 1], 5)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 6)
