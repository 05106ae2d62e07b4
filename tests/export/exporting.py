"""Observers of every family and scheme, ready to be written down; with typed gains, so that nothing is searched."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from command import ROOT

from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Portable, portable
from cdobs_cli.export.step import with_step
from cdobs_cli.export.vectors import Vectors, held, vectors
from cdobs_cli.plant import Plant
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.spec.model import Spec, load
from cdobs_cli.synthesis import new_design, system_of

PLANT = """\
spec_version: 1
title: Pendulum with a motor
plant:
  states: [theta, omega]
  inputs: {u: {range: [-1, 1]}}
  A: [[0, 1], [0, -0.5]]
  phi: ["0", "-sin(theta) + u"]
  lipschitz: [[0, 0], [1, 0]]
"""
RUN = """\
simulation:
  horizon: 8
  initial_state: [1, 0]
  initial_estimate: [0, 0.2]
  signals: {u: "0.3*cos(t)"}
"""
A, B = "a: {{C: [[1, 0]]{}}}", "b: {{C: [[0, 1]]{}}}"
SCHEMES = {
    "periodic": "C: [[1, 0]], sampling: {period: 0.6}",
    "aperiodic": "C: [[1, 0]], sampling: {min_period: 0.1, max_period: 0.6}",
    "lossy": "C: [[1, 0]], sampling: {period: 0.3}, lost: {at_most: 2}",
    "random": "C: [[1, 0]], sampling: {period: 0.3}, lost: {probability: 0.3}",
    "lossy_gains": "C: [[1, 0]], sampling: {period: 0.3}, lost: {at_most: 2}, gains: by_phase",
    "multirate": f"sensors: {{{A.format(', period: 0.6, offset: 0.2')}, {B.format(', period: 0.2')}}}",
    "one_gain": f"sensors: {{{A.format(', period: 0.6')}, {B.format(', period: 0.2')}}}, gains: one",
    "lossy_sensors": f"sensors: {{{A.format(', period: 0.6, lost: {at_most: 1}')}, "
    f"{B.format(', period: 0.3, lost: {at_most: 2}')}}}",
    "out_of_step": f"sensors: {{{A.format(', min_period: 0.2, max_period: 0.5')}, "
    f"{B.format(', min_period: 0.15, max_period: 0.4')}}}",
    "long_pattern": f"sensors: {{{A.format(', period: 0.2')}, {B.format(', period: 19.4, offset: 0.4')}}}",
    "late": "C: [[1, 0]], sampling: {period: 0.3}, delay: [0.05, 0.75]",
    "late_sensors": f"sensors: {{{A.format(', period: 0.6, delay: [0.1, 0.9]')}, {B.format(', period: 0.2')}}}",
    "on_change": f"sensors: {{{A.format(', send_on_delta: 0.1')}, {B.format(', send_on_delta: 0.15')}}}",
    "checked": f"sensors: {{{A.format(', send_on_delta: 0.1, check_every: 0.1')}}}",
}
HELD = ("periodic", "late")  # of what the family that holds its innovation takes
SHIPPED = (
    "updated_sampling_unstable", "updated_sampling_unstable_carried", "interval_scalar", "interval_pendulum",
    "reachability_range_bearing",
    "lpv_zoh_bioreactor_lie",

)  # fmt: skip
CASES = (*(("reachability", one) for one in SCHEMES), *(("lpv_zoh", one) for one in HELD),
         *(("shipped", one) for one in SHIPPED))  # fmt: skip
NAMES = ["-".join(one) for one in CASES]


@dataclass(frozen=True)
class Ready:
    """What writers take."""

    portable: Portable
    about: About
    vectors: Vectors
    plant: Plant
    design: Design


@cache
def ready(case: tuple[str, str]) -> Ready:
    """Of a family and one of the schemes, or of a shipped spec."""
    family, name = case
    if family == "shipped":
        spec = load(ROOT / "specs" / f"{name}.yaml")
    else:
        text = f"{PLANT}measurement: {{{SCHEMES[name]}}}\nobserver: {{family: {family}}}\n{RUN}"
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"{family}_{name}.yaml"
            path.write_text(text)
            spec = load(path)
    given = spec.observer.given()
    if None not in given.values():
        return of(spec, new_design(spec, 0))
    gain = dict.fromkeys(given, _gain(spec.plant))
    return of(spec, Design(spec.observer.name, "given", spec.plant.sampling, gain))


def _gain(plant: Plant) -> ExactMatrix:
    """Each column tells which output it is of and, a little, which sample."""
    law = plant.sampling
    outputs = [k for reading in law.readings for k in reading.outputs] or list(range(plant.p))
    columns = [[60 if i == k else 25 for i in range(plant.n)] for k in outputs]
    rows = zip(*columns, strict=True)
    return ExactMatrix([[f"0.{value + (7 * k) % 31}" for k, value in enumerate(row)] for row in rows])


def of(spec: Spec, design: Design) -> Ready:
    """With a simulated run of it."""
    system = system_of(spec, design)
    assert spec.simulation is not None
    one = portable(spec.source_path.stem, system.plant, system.observer, design, system.original)
    asked = held(system, spec.simulation, design.sampling)
    told = vectors(one, asked[1], simulate(*asked, design.sampling).trajectories[0], system.plant.n)
    digests = (("design", "0" * 64), ("check", "1" * 64))
    about = About(spec.title, spec.source_path.name, "proved", (), digests, design.sampling.text("s"), spec.labels)
    period = float(design.sampling.T_max) or max(call.dt for call in told.calls)
    about, kept = with_step(one, about, told, period)
    assert kept is not None
    return Ready(one, about, kept, system.plant, design)
