"""Does the bioreactor of Andrieu2014 need measurements at all? The observers of the shipped specs against none.

python tests/benchmarks/bench_open_loop.py
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import rooms
from table import row

from cdobs_cli.baselines.constant_gain import constant_gain
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.spec.model import load

SPECS = rooms.ROOT / "specs"
NAMES = (
    "updated_sampling_bioreactor_corrected",
    "updated_sampling_bioreactor_corrected_fast",
    "updated_sampling_bioreactor_best",
)


def compare(name: str) -> dict[str, tuple[int, float, float]]:
    """Measurements, first and last size of the error, by method."""
    spec = load(SPECS / f"{name}.yaml")
    assert spec.simulation is not None
    design = spec.observer.synthesize(spec.plant, 0)
    n, p = spec.plant.n, spec.plant.p
    silent = replace(constant_gain(spec.plant, ExactMatrix([["0"] * p] * n)), jump_at_start=False)
    observers = {"observer": spec.observer.observer(spec.plant, design), "open loop": silent}
    found = {}
    for method, observer in observers.items():
        # The copy without corrections is run under the same instants' law; what it measures it does not use.
        law = design.sampling if method == "observer" else spec.plant.sampling.periodic(spec.simulation.horizon)
        trajectory = simulate(HybridSystem(spec.plant, observer), spec.simulation, law).trajectories[0]
        error = np.linalg.norm(trajectory.x - trajectory.estimates["x_hat"], axis=1)
        found[method] = (len(trajectory.t_k) if method == "observer" else 0, float(error[0]), float(error[-1]))
    return found


def main() -> None:
    for name in NAMES:
        print(name)
        found = compare(name)
        for method, (measurements, first, last) in found.items():
            print(f"  {method:10} {measurements:5d} measurements   error {first:.3e} -> {last:.3e}")
        row(f"last error, {name.removeprefix('updated_sampling_')} / open loop", found["observer"][2],
            found["open loop"][2], 1, "")  # fmt: skip


if __name__ == "__main__":
    main()
