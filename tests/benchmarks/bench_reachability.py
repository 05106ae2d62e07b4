"""How the set and its LMI grow with n: chains with one slope, the longest period at effort 1.

python tests/benchmarks/bench_reachability.py [largest n, default 6]
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "families" / "reachability"))

from reachability_plants import symmetric_chain

from cdobs_cli.families.reachability import Reachability


def main(largest: int) -> None:
    print(f"{'n':>2} {'period':>9} {'members':>8} {'CPU synth':>10} {'CPU check':>10} {'memory MB':>10}")
    for n in range(2, largest + 1):
        p = symmetric_chain((1,) + (0,) * (n - 1), "0.8")
        family = Reachability(objective="max_period", method="set")
        start = time.process_time()
        design = family.synthesize(p, 1)
        middle = time.process_time()
        check = family.certify(p, design, 1)
        end = time.process_time()
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        period = check.bounds["period_max.set"].proved
        print(
            f"{n:>2} {period:>9} {2 ** (2 * n - 2):>8} {middle - start:>10.2f} {end - middle:>10.2f} {memory:>10.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 6)
