"""CPU seconds of commands, of this checkout and of another one, in turns and in one run.

    python tests/benchmarks/bench_commands.py [BASELINE [SPEC ..]]

Of each spec `run` from nothing, and `check` of a current design. BASELINE is the folder of another checkout: the ratio
of this one to the other is given too. A spec that the other checkout does not have is run by this one alone, as all
are without BASELINE.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import rooms
from table import cpu_of_command, row

SPECS = ("reachability_pendulum", "lpv_zoh_sine_best", "interval_pendulum", "updated_sampling_unstable")


def seconds(checkout: Path | None, command: str, spec: str, out: Path) -> float:
    """nan where the checkout has no such spec."""
    if checkout is None or not (checkout / spec).is_file():
        return math.nan
    # `check` is asked anew.
    (out / Path(spec).stem / "check.json").unlink(missing_ok=True)
    return cpu_of_command("-m", "cdobs_cli", command, spec, "-o", out, "-q", checkout=checkout)


def main(baseline: Path | None, names: list[str]) -> None:
    print(f"{'spec':<42} {'command':<7} {'before':>8} {'now':>8} {'ratio':>6}")
    total = {"run": [0.0, 0.0, 0.0], "check": [0.0, 0.0, 0.0]}
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            for command, sums in total.items():
                before, now = (
                    seconds(checkout, command, f"specs/{name}.yaml", Path(folder) / side)
                    for checkout, side in ((baseline, "before"), (rooms.ROOT, "now"))
                )
                both = (before, now) if before == before else (0.0, 0.0)
                for place, value in enumerate((*both, now)):
                    sums[place] += value
                print(f"{name:<42} {command:<7} {before:8.2f} {now:8.2f} {now / before:6.2f}", flush=True)
    for command, (before, now, _) in total.items():
        if before:
            row(f"{command}, all specs of both / the other checkout", now, before, 1)
    row(f"check of {len(names)} current designs / run from nothing", total["check"][2], total["run"][2], 0.5)


if __name__ == "__main__":
    chosen = sys.argv[2:] or list(SPECS)
    every = sorted(path.stem for path in (rooms.ROOT / "specs").glob("*.yaml"))
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else None, every if chosen == ["all"] else chosen)
