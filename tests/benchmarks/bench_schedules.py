"""Sensors with periods of their own: 200 random linear schedules, proved and refuted at the limit of their monodromy.

python tests/benchmarks/bench_schedules.py [how many]
"""

import sys
import time

import rooms  # noqa: F401 - opens the folders
from schedules import is_met
from table import row

if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    start = time.process_time()
    met = sum(is_met(seed) for seed in range(count))
    spent = time.process_time() - start
    print(f"{met} of {count} schedules have a limit: each within 0.5 % of it on either side, none beyond it")
    row("a random schedule, proved and refuted", spent / count, 1.0, 1.0)
