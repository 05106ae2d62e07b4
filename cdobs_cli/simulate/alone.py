"""The plant by itself, where no observer was found: what there would be to estimate."""

from __future__ import annotations

from dataclasses import replace

from cdobs_cli.errors import SpecError
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run, SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate

NO_OBSERVER = Observer((), (), (), (), {})


def plant_alone(plant: Plant, plan: SimulationPlan) -> Run | None:
    """The first run of the plan without an observer; None where its inputs are made of estimates or measurements, or
    it cannot be run."""
    if any(signal.variables - {"t"} for signal in plan.inputs.values()):
        return None
    law = plant.sampling
    if law.is_updated or law.is_on_change:  # an observer would choose the instants
        law = SamplingLaw.periodic(plan.horizon)
        plan = replace(plan, sampling_times=None)
    try:
        alone = replace(plant, sampling=law, delays=())  # nobody waits for what is late
        return simulate(HybridSystem(alone, NO_OBSERVER), replace(plan, runs=1), law)
    except SpecError:
        return None
