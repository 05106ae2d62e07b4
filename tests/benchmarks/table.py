"""All figures of the benchmarks as one table: name | measured | reference | ratio | wanted.

    python tests/benchmarks/table.py [SCRIPT ..]

Runs the scripts (every bench_*.py) one after the other, as each is run alone, on one thread, and ends with the rows
that they gave to `row`. Measured and reference are of the same run, so ratios compare between machines: CPU seconds
where no other unit is given. Exit code 1 where a script fails; a ratio that is not as wanted is marked.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import rooms

GATHERED = "CDOBS_BENCHMARK_ROWS"  # the file that rows go to, beside the screen
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"), "1")


def row(name: str, measured: float, reference: float, at_most: float | None = None, unit: str = "s") -> None:
    """Say one figure: the ratio measured / reference is wanted to be `at_most`, or is only looked at."""
    figure = {"name": name, "measured": measured, "reference": reference, "at_most": at_most, "unit": unit}
    print(line(figure), flush=True)
    if GATHERED in os.environ:
        with Path(os.environ[GATHERED]).open("a", encoding="utf-8") as file:
            file.write(json.dumps(figure) + "\n")


def line(figure: dict) -> str:
    ratio, at_most, unit = figure["measured"] / figure["reference"], figure["at_most"], figure["unit"]
    numbers = [f"{figure[side]:.4g} {unit}" for side in ("measured", "reference")]
    wanted = "" if at_most is None else f"<= {at_most:g}" + ("" if ratio <= at_most else "  MISSED")
    return f"{figure['name']:<62} {numbers[0]:>14} {numbers[1]:>14} {ratio:>10.3g}  {wanted}".rstrip()


def cpu(work: Callable[[], object], repeats: int = 1) -> float:
    """CPU seconds of this process: the least of some repeats."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def cpu_of_command(*arguments: str | Path, checkout: Path = rooms.ROOT, repeats: int = 1) -> float:
    """CPU seconds of `python ARGUMENTS` with all its children, the package that of a checkout."""
    return min(_children(arguments, checkout) for _ in range(repeats))


def _children(arguments: Sequence[str | Path], checkout: Path) -> float:
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(checkout), "PYTHONWARNINGS": "ignore"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, *map(str, arguments)]
    subprocess.run(command, cwd=checkout, env=environment, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(scripts: Sequence[Path]) -> int:
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        gathered = Path(folder) / "rows"
        gathered.touch()
        for script in scripts:
            print(f"== {script.name}", flush=True)
            environment = os.environ | ONE_THREAD | {GATHERED: str(gathered)}
            if subprocess.run([sys.executable, script], env=environment, check=False).returncode:
                failed.append(script.name)
        figures = [json.loads(text) for text in gathered.read_text(encoding="utf-8").splitlines()]
    print(f"\n{'name':<62} {'measured':>14} {'reference':>14} {'ratio':>10}  wanted")
    for figure in figures:
        print(line(figure))
    if failed:
        print(f"failed: {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    chosen = [Path(name).resolve() for name in sys.argv[1:]]
    sys.exit(main(chosen or sorted(Path(__file__).resolve().parent.glob("bench_*.py"))))
