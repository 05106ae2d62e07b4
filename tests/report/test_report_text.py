"""report.md and the terminal summary, against stored text."""

import csv
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from command import made
from report_pendulum import Copying, make_check, make_design, make_plant, make_report, make_run

from cdobs_cli.chart import Chart
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Input, TypedDynamics
from cdobs_cli.report.model import Report
from cdobs_cli.report.summary import summary_lines
from cdobs_cli.report.text import markdown
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.alone import plant_alone

GOLDEN = Path(__file__).parent / "golden"


def test_markdown(files: dict[str, bytes]) -> None:
    assert files["report.md"].decode() == (GOLDEN / "report.md").read_text(encoding="utf-8")


def test_stiff_runs_are_told_in_the_simulation() -> None:
    told = "The run is stiff and was integrated with an implicit method (Radau)."
    assert told in markdown(make_report(run=replace(make_run(), implicit=1)))
    assert told not in markdown(make_report(run=make_run()))


def test_summary(report: Report) -> None:
    assert "\n".join(summary_lines(report)) + "\n" == (GOLDEN / "summary.txt").read_text(encoding="utf-8")


def test_summary_without_a_design() -> None:
    law = make_design().sampling
    none = Design("copying", "none", law, {}, reason="the pair (A, C) is not detectable")
    report = make_report(design=none)
    lines = summary_lines(report)
    assert lines[0] == "reachability_pendulum: no design found"
    assert lines[1] == "  No observer was found: the pair (A, C) is not detectable."
    assert report.charts == ()


def test_conditions_name_domain_and_constant_period() -> None:
    first, second = make_report(check=make_check()).conditions
    assert first.startswith("Assumed: the plant stays in -3.2 ≤ theta ≤ 3.2")
    assert "not implied" in second


def test_a_plant_in_other_coordinates_is_shown_in_both() -> None:
    names = frozenset({"S", "X", "D"})
    dynamics = tuple(parse(text, names) for text in ("X*S/(X + S) - D*X", "D*(0.1 - S) - X*S/(X + S)"))
    typed = TypedDynamics(("X", "S"), (Input("D"),), dynamics, (parse("X", names),), SamplingLaw.periodic(Exact("0.6")))
    change = Swap(("X", "S"), ("theta", "omega"), (parse("X", names), parse("2*S", names)))
    report = Report(
        "bio", "Bioreactor", "bio.yaml", make_plant(), Copying(), make_design(), None, make_run(), typed, change
    )
    text = markdown(report)
    assert r"\dot{S} &= D \left( 0.1 - S \right) - \frac{X S}{X + S}" in text
    assert r"\omega &= 2 S" in text
    chart = next(chart for chart in report.charts if chart.name == "typed_states")
    assert isinstance(chart, Chart)
    assert list(chart.panels[1].series[0].y) == list(make_run().trajectories[0].x[:, 1] / 2)


@dataclass(frozen=True)
class Swap:
    """theta = X, omega = 2 S."""

    states: tuple[str, ...]
    names: tuple[str, ...]
    map: tuple[Expression, ...]

    def original_values(self, z: Any) -> Any:
        return z * [1.0, 0.5]


def test_without_a_design_the_plant_is_shown_by_itself(tmp_path: Path) -> None:
    spec = Path(__file__).parents[1] / "pages" / "unseen_angle.yaml"
    made(tmp_path, spec.read_text())
    text = (tmp_path / "out" / "report.md").read_text()
    assert "No design was found" in text and "this is the plant by itself" in text
    assert not (tmp_path / "out" / "simulation.json").exists()
    rows = list(csv.DictReader((tmp_path / "out" / "figures" / "states.csv").open()))
    assert {row["series"] for row in rows} == {"state", "measurement"}
    angle = [float(row["y"]) for row in rows if row["panel"] == "1" and row["series"] == "state"]
    # theta' = theta + omega with omega = 0.2
    assert angle[-1] == pytest.approx(0.3 * math.exp(4) - 0.2, rel=1e-6)


UNSEEN = """\
spec_version: 1
plant: {states: [x, y], A: [[0.2, 1], [0, 0.3]], phi: ["0", "0"], lipschitz: [[0, 0], [0, 0]]}
measurement: MEASURED
observer: {family: reachability}
simulation: {horizon: 2, initial_state: [1, 1], initial_estimate: [0, 0]}
"""
FIRST, SECOND = "a: {C: [[0, 1]], period: 0.1", "b: {C: [[0, 2]], period: 0.3"


@pytest.mark.parametrize("measured", [
    "{C: [[0, 1]], sampling: {period: 0.1}, lost: {at_most: 2}, gains: by_phase}",
    "{C: [[0, 1]], sampling: {period: 0.1}, lost: {probability: 0.2}}",
    "{C: [[0, 1]], sampling: {period: 0.1}, delay: [0, 0.15]}",
    f"{{sensors: {{{FIRST}}}, {SECOND}}}}}}}", f"{{sensors: {{{FIRST}, delay: 0.05}}, {SECOND}}}}}}}",
    f"{{sensors: {{{FIRST}, lost: {{at_most: 2}}}}, {SECOND}}}}}}}",
    "{sensors: {a: {C: [[0, 1]], min_period: 0.1, max_period: 0.3}, b: {C: [[0, 2]], min_period: 0.2, max_period: 1}}}",
    "{sensors: {a: {C: [[0, 1]], period: 0.01}, b: {C: [[0, 2]], period: 3}}}",
    "{sensors: {a: {C: [[0, 1]], send_on_delta: 0.1}}}",
    "{sensors: {a: {C: [[0, 1]], send_on_delta: 0.1, check_every: 0.05}}}",
])  # fmt: skip
def test_a_plant_that_nobody_can_observe_is_refuted_and_shown_however_it_is_measured(
    tmp_path: Path, measured: str
) -> None:
    """x grows and no output shows it."""
    result = made(tmp_path, UNSEEN.replace("MEASURED", measured))
    assert result.status == "finding" and result.check is not None and result.check["verdict"] == "refuted"
    rows = list(csv.DictReader((tmp_path / "out" / "figures" / "states.csv").open()))
    last = [float(row["y"]) for row in rows if row["panel"] == "1" and row["series"] == "state"][-1]
    # x' = 0.2 x + y, y = exp(0.3 t)
    assert last == pytest.approx(10 * math.exp(0.6) - 9 * math.exp(0.4), rel=1e-6)


def test_a_plant_that_needs_the_estimate_is_not_run_by_itself() -> None:
    plan = SimulationPlan(Exact("1"), (Exact("0"), Exact("0")), signals={"u": parse("t", frozenset({"t"}))})
    run = plant_alone(make_plant(), plan)
    assert run is not None and not run.trajectories[0].estimates
    fed = replace(plan, signals={"u": Variable("hat.theta")})
    assert plant_alone(make_plant(), fed) is None
