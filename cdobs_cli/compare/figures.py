"""What is compared of each observer: what is proved of it, how it errs in simulation, and what it takes."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

from cdobs_cli.baselines.output_predictor import output_predictor, predictor_gain
from cdobs_cli.certificate import Bound
from cdobs_cli.compare.entries import POLES, Entry, linearised_at_start, must_be_placed
from cdobs_cli.comparison import errors_beside
from cdobs_cli.design import Design
from cdobs_cli.outcome import Result
from cdobs_cli.records import dataclass
from cdobs_cli.report.model import HEADLINE_BOUNDS
from cdobs_cli.spec.model import Spec
from cdobs_cli.synthesis import system_of

NO_CERTIFICATE = "no certificate"


@dataclass(frozen=True)
class Figures:
    """One observer.

    certificate: the verdict, or that there is none; law: how it samples, in words; errors: proved, by state (of boxes
    in the long run, of covariances in mean square); rmse: by state over `seeds` runs, after the transient where noise
    or disturbance is declared, else of the whole runs; measurements: of a run; cpu: seconds of design, proof and
    simulation; remark: what there is to know.
    """

    name: str
    kind: str
    certificate: str
    law: str = ""
    period: Bound = field(default_factory=Bound)
    rate: Bound = field(default_factory=Bound)
    errors: Mapping[str, Bound] = field(default_factory=dict)
    measurements: int | None = None
    rmse: Mapping[str, float] = field(default_factory=dict)
    seeds: int | None = None
    cpu: float | None = None
    remark: str = ""

    def error(self, state: str) -> Bound:
        return self.errors.get(state, Bound(unit="", better="less"))


def figures_of(entry: Entry, result: Result, cpu: float | None, states: Sequence[str], unit: str) -> Figures:
    """Of an observer that was designed, checked and run."""
    bounds = {name: Bound.from_document(one) for name, one in (result.check or {}).get("bounds", {}).items()}
    known = [name for name in HEADLINE_BOUNDS if name in bounds]
    errors: dict[str, Bound] = {}
    for state in states:
        found = next((bounds[name] for name in (f"error.{state}", f"rms.{state}") if name in bounds), None)
        errors |= {} if found is None else {state: found}
    rmse, seeds = _rmse(result.simulation)
    verdict = str((result.check or {}).get("verdict") or result.status)
    whole = (result.simulation or {}).get("overall", {})
    remark = next((one.text for one in result.messages if one.severity == "error"), "")
    return Figures(
        entry.name, entry.kind, f"{NO_CERTIFICATE} ({verdict})" if verdict == "undecided" else verdict,
        Design.from_document(result.design).sampling.text(unit) if result.design else "",
        bounds[known[0]] if known else Bound(), bounds.get("decay_rate", Bound()), errors, whole.get("measurements"),
        rmse, seeds, cpu, remark,
    )  # fmt: skip


def _rmse(simulation: Mapping[str, Any] | None) -> tuple[dict[str, float], int | None]:
    """By state, and over how many runs; nothing of a run that was not or that diverged."""
    if simulation is None or simulation["overall"]["diverged"]:
        return {}, None
    comparison = simulation.get("comparison")
    if comparison is not None:
        return {name: one["rmse"] for name, one in comparison["states"].items()}, comparison["seeds"]
    return dict(simulation["overall"]["rmse"]), len(simulation["runs"])


def filter_figures(of: Figures, result: Result) -> Figures | str | None:
    """Of the extended Kalman filter on the measurements of an observer; in a sentence why there is none; None where
    nothing was simulated."""
    comparison = (result.simulation or {}).get("comparison")
    if comparison is None:
        return None
    if comparison["reason"] is not None:
        return str(comparison["reason"])
    rmse = {name: one["rmse_ekf"] for name, one in comparison["states"].items()}
    return Figures(
        f"extended Kalman filter beside {of.name}", "baseline", NO_CERTIFICATE, of.law, measurements=of.measurements,
        rmse=rmse, seeds=comparison["seeds"], remark="the filter proves nothing of its error",
    )  # fmt: skip


def predictor_figures(of: Figures, spec: Spec, result: Result) -> Figures | str | None:
    """Of the output predictor on the measurements of an observer; in a sentence why there is none; None where nothing
    was simulated. Its linear part decays between samples as the placed gain's does from one to the next."""
    if result.simulation is None or result.design is None or spec.simulation is None:
        return None
    design = Design.from_document(result.design)
    system = system_of(spec.chosen(design.family), design)
    if "x_hat" not in system.observer.estimates:
        return "No output predictor is run beside an observer of bounds."
    busy = time.process_time()
    try:
        must_be_placed(spec)
        rate = -math.log(POLES) / float(system.plant.sampling.period)
        predictor = output_predictor(system.plant, predictor_gain(*linearised_at_start(spec), rate))
        rmse = errors_beside(
            system, predictor, spec.simulation, design.sampling, of.seeds or 1, late=system.plant.is_perturbed
        )
    except ValueError as error:
        return f"There is no output predictor: {str(error).rstrip('.')}."
    return Figures(
        f"output predictor beside {of.name}", "baseline", NO_CERTIFICATE, of.law, measurements=of.measurements,
        rmse=rmse, seeds=of.seeds, cpu=time.process_time() - busy,
        remark="its theorem holds for periods that are short enough, and is not evaluated here",
    )  # fmt: skip
