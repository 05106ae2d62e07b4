"""CPU seconds of commands, this checkout beside another one, in turns and in one run.

    python tests/benchmarks/bench_commands.py BASELINE [SPEC ..]

BASELINE is the folder of another checkout; of each spec `run` from nothing, and `check` of a current design, with the
ratio of this one to the other. A spec that the other checkout does not have is run by this one alone.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]
SPECS = ("reachability_pendulum", "lpv_zoh_sine_best", "interval_pendulum", "updated_sampling_unstable")


def seconds(checkout: Path, *arguments: str) -> float:
    """CPU of one command as a whole process."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONWARNINGS": "ignore"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "cdobs_cli", *arguments, "-q"], cwd=checkout, env=environment, check=False,
        capture_output=True,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(baseline: Path, names: list[str]) -> None:
    print(f"{'spec':<42} {'command':<7} {'before':>8} {'now':>8} {'ratio':>6}")
    total = {"run": [0.0, 0.0], "check": [0.0, 0.0]}
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            spec = f"specs/{name}.yaml"
            known = (baseline / spec).is_file()
            for command in ("run", "check"):
                out = [str(Path(folder) / side) for side in ("before", "now")]
                if command == "check":
                    for side in out:
                        (Path(side) / name / "check.json").unlink(missing_ok=True)
                before = seconds(baseline, command, spec, "-o", out[0]) if known else float("nan")
                now = seconds(HERE, command, spec, "-o", out[1])
                if known:
                    total[command][0] += before
                    total[command][1] += now
                print(f"{name:<42} {command:<7} {before:8.2f} {now:8.2f} {now / before:6.2f}", flush=True)
    for command, (before, now) in total.items():
        print(f"{'all that both have':<42} {command:<7} {before:8.2f} {now:8.2f} {now / before:6.2f}")


if __name__ == "__main__":
    chosen = sys.argv[2:] or list(SPECS)
    every = sorted(path.stem for path in (HERE / "specs").glob("*.yaml"))
    main(Path(sys.argv[1]).resolve(), every if chosen == ["all"] else chosen)
