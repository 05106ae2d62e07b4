"""Processor time of a design with its check, and its proved period; against another checkout, each in its own process.

    python tests/benchmarks/bench_design.py [FOLDER] [--all] [--spec PATH ..]

FOLDER holds the package of another version; both are run in turn on the same specs, at effort 1, one thread. Prints
for each spec the seconds of processor time, the verdict, the law and the bracket of the period; with FOLDER also the
ratio of the times. Of a spec of the same name in FOLDER that one is run there. Specs that take more than 20 s are run
with --all, or when they are named.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import rooms
from table import ONE_THREAD, cpu_of_command, row

HERE = rooms.ROOT
NAMES = (
    "lpv_zoh_sine_best", "lpv_zoh_flexible_joint", "lpv_zoh_four_tanks", "lpv_zoh_duffing", "plant_reactor",
    "plant_cart", "plant_pmsm", "plant_flexible_arm", "plant_motor",
)  # fmt: skip
LONG = {"plant_pmsm", "plant_flexible_arm", "lorenz", "laub_loomis"}
LORENZ = """spec_version: 1
title: Lorenz system on a box that holds the attractor, x sampled
plant:
  states: [x, y, z]
  parameters: {s: 10, r: 28, b: "8/3"}
  dynamics: ["s*(y - x)", "r*x - y - x*z", "x*y - b*z"]
  output: ["x"]
  domain: {x: [-20, 20], y: [-28, 28], z: [0, 50]}
measurement:
  sampling: {max_period: 0.002}
observer: {family: lpv_zoh, objective: max_period, rate_at_least: 0}
"""
REACTOR = """spec_version: 1
title: Stirred reactor, temperature sampled
plant:
  states: [Ca, T]
  inputs: {Tc: {range: [290, 310]}}
  parameters: {q: 100, V: 100, Caf: 1, Tf: 350, k0: 7.2e10, ER: 8750, dH: 5e4, rhoCp: 239, UA: 5e4}
  dynamics:
    - q/V*(Caf - Ca) - k0*exp(-ER/T)*Ca
    - q/V*(Tf - T) + dH/rhoCp*k0*exp(-ER/T)*Ca + UA/(V*rhoCp)*(Tc - T)
  output: [T]
  domain: {Ca: [0.4, 0.6], T: [345, 355]}
measurement:
  sampling: {max_period: 0.01}
observer: {family: lpv_zoh, objective: max_period, rate_at_least: 0}
"""
FLEXIBLE_JOINT = """spec_version: 1
title: Single link on a flexible joint, motor angle sampled
plant:
  states: [theta, omega, psi]
  A: [[0, 1, 0], [-4, -0.4, 4], [2, 0, -2]]
  phi: ["0", "-sin(theta)", "0"]
  lipschitz: [[0, 0, 0], [1, 0, 0], [0, 0, 0]]
measurement:
  C: [[0, 0, 1]]
  sampling: {max_period: 0.3}
observer: {family: lpv_zoh, objective: max_period, rate_at_least: 0}
"""
LAUB_LOOMIS = """spec_version: 1
title: Laub-Loomis, seven states, eight slopes that vary
plant:
  states: [x1, x2, x3, x4, x5, x6, x7]
  dynamics:
    - 1.4*x3 - 0.9*x1
    - 2.5*x5 - 1.5*x2
    - 0.6*x7 - 0.8*x2*x3
    - 2 - 1.3*x3*x4
    - 0.7*x1 - x4*x5
    - 0.3*x1 - 3.1*x6
    - 1.8*x6 - 1.5*x2*x7
  output: [x1, x4]
  domain: {x1: [0.4, 1.3], x2: [0.6, 1.4], x3: [0.8, 1.7], x4: [1.5, 2.7], x5: [0.5, 1.2], x6: [0, 0.3], x7: [0.1, 0.7]}
measurement:
  sampling: {max_period: 0.05}
observer: {family: lpv_zoh, objective: given_period}
"""


def run(package: Path, spec: Path) -> tuple[float, dict, dict] | None:
    """Seconds of processor time, the design and its check; None where there is none."""
    own = package / "specs" / spec.name
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "cdobs_cli", "check", str(own if own.is_file() else spec), "-o", out]
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(package)}
        subprocess.run(command, env=environment, cwd=package, capture_output=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        found = [next(iter(Path(out).rglob(f"{name}.json")), None) for name in ("design", "check")]
        documents = [json.loads(path.read_text()) for path in found if path is not None]
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return (seconds, *documents) if len(documents) == 2 else None


def of_any_rate(spec: Path, folder: Path) -> Path:
    """The spec without `rate_at_least: 0`, for versions that keep no rate."""
    plain = folder / f"{spec.stem}_of_any_rate.yaml"
    plain.write_text(spec.read_text().replace(", rate_at_least: 0", ""))
    return plain


def told(seconds: float, design: dict, check: dict) -> str:
    period = next(reversed(design["sampling"].values()))
    bound = check["bounds"].get("period_max", {})
    bracket = f"[{bound.get('proved')}, {bound.get('refuted')}]"
    return f"{seconds:7.1f} s  {design['outcome']:6s} {check['verdict']:10s} law {period:>12s}  period {bracket}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--spec", type=Path, nargs="*")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        written = {
            "lorenz": LORENZ, "flexible_joint": FLEXIBLE_JOINT, "reactor": REACTOR, "laub_loomis": LAUB_LOOMIS,
        }  # fmt: skip
        for name, text in written.items():
            (Path(made) / f"{name}.yaml").write_text(text)
        known = [
            *(HERE / "specs" / f"{name}.yaml" for name in NAMES), *(Path(made) / f"{name}.yaml" for name in written)
        ]  # fmt: skip
        specs = options.spec or [spec for spec in known if options.all or spec.stem not in LONG]
        spent = []
        for spec in specs:
            print(spec.stem, flush=True)
            here = run(HERE, spec.resolve())
            print(f"  here   {told(*here) if here else 'no design'}", flush=True)
            if options.folder is not None:
                there = run(options.folder.resolve(), spec.resolve()) or run(
                    options.folder.resolve(), of_any_rate(spec, Path(made))
                )
                ratio = f"  ratio {here[0] / there[0]:.3f}" if here and there else ""
                print(f"  there  {told(*there) if there else 'no design'}{ratio}", flush=True)
                spent += [(here[0], there[0])] if here and there else []
            elif here:
                spent.append((here[0], cpu_of_command("-c", "pass")))
    other = "the other checkout" if options.folder else "starts of python"
    row(f"{len(spent)} designs with their checks / {other}", *map(sum, zip(*spent, strict=True)))


if __name__ == "__main__":
    main()
