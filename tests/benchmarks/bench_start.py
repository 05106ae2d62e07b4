"""CPU of commands that must answer at once, beside `python -c pass`; and of `validate` over a folder of many specs.

python tests/benchmarks/bench_start.py [number of specs, default 2000]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import rooms
from table import cpu_of_command, row

SPEC = rooms.ROOT / "specs" / "reachability_pendulum.yaml"
PLANT = """spec_version: 1
title: Pendulum number {number}
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "{g}*sin(theta)"]
  lipschitz: [[0, 0], [{g}, 0]]
measurement:
  C: [[1, 0]]
  sampling: {{period: 0.4}}
observer: {{family: reachability, objective: given_period}}
simulation: {{horizon: 20, initial_state: [1, 0], initial_estimate: [0, 0]}}
"""


def many(folder: Path, count: int) -> None:
    """Specs that differ in a number each."""
    for number in range(count):
        g = f"{1 + number / 10_000:.4f}"
        (folder / f"pendulum_{number}.yaml").write_text(PLANT.format(number=number, g=g), encoding="utf-8")


def main(count: int) -> None:
    nothing = cpu_of_command("-c", "pass", repeats=9)
    tool = ("-m", "cdobs_cli")
    row("cdobs --help / python -c pass", cpu_of_command(*tool, "--help", repeats=5), nothing, 7)
    row("cdobs validate SPEC / python -c pass", cpu_of_command(*tool, "validate", SPEC, repeats=5), nothing, 20)
    with tempfile.TemporaryDirectory() as folder:
        many(Path(folder), count)
        each = 1e3 * cpu_of_command(*tool, "validate", folder) / count
    row(f"cdobs validate, each of {count} specs / 4 ms", each, 4.0, 1, "ms")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
