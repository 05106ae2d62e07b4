"""A pendulum with everything a report can show, made by hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np

from cdobs_cli.certificate import Bound, Certificate, Check, Claim, Witness
from cdobs_cli.chart import Chart, Exhibits, Panel, Series, Table
from cdobs_cli.design import Design, SolverRecord
from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.base import Family
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Box, Domain, Input, Interval, Plant, Slopes
from cdobs_cli.report.model import Report
from cdobs_cli.run import Run, RunSummary, Trajectory
from cdobs_cli.sampling import SamplingLaw

HOSTILE = "Pendulum <script>alert('x')</script> & \"quotes\" | `code` *stars*"


class Copying(Family):
    """A family for tests: it copies the plant and corrects with K."""

    family: Literal["copying"] = "copying"
    source: ClassVar[str] = "Dinh2014, Theorem III.2"
    example: ClassVar[str] = ""

    def given(self) -> Mapping[str, ExactMatrix | None]:
        return {"K": None}

    def synthesize(self, plant: Plant, effort: int) -> Design:
        raise NotImplementedError

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        raise NotImplementedError

    def observer(self, plant: Plant, design: Design) -> Observer:
        hats = tuple(f"hat.{name}" for name in plant.states)
        innovation = Variable("y.0") - Variable(hats[0])
        jump = tuple(Variable(name) + design.gain["K"][i, 0].expression * innovation for i, name in enumerate(hats))
        start = tuple(Variable(f"initial.{name}") for name in plant.states)
        estimates: dict[str, tuple[Expression, ...]] = {"x_hat": tuple(Variable(name) for name in hats)}
        return Observer(hats, start, plant.right_hand_side("hat."), jump, estimates)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        curve = Series("proved", [0.5, 1.0, 2.0], [2.1, 1.7, 1.2], "line", "proved")
        limit = Series("limit", [], [1.0], "limit", "refuted")
        panel = Panel(r"slope $c$", "period (s)", (curve, limit))
        chart = Chart("period_slope", "Period against slope", "The proved period for each slope.", (panel,))
        table = Table(
            "rates", "Rates", "Rates at two periods.", ("period (s)", "rate (1/s)"), ((0.5, 0.123456789), (1, None))
        )
        return Exhibits((chart,), (table,), ("The reachable set is a box.",))


def make_plant() -> Plant:
    return Plant(
        states=("theta", "omega"),
        inputs=(Input("u", Interval(Exact("-1"), Exact("1"))),),
        A=ExactMatrix([["0", "1"], ["0", "-1/3"]]),
        phi=(parse("0"), parse("sin(theta)", frozenset({"theta"}))),
        B=ExactMatrix([["0"], ["1"]]),
        C=ExactMatrix([["1", "0"]]),
        slopes=Slopes(ExactMatrix([["0", "0"], ["-1", "0"]]), ExactMatrix([["0", "0"], ["1", "0"]])),
        sampling=SamplingLaw.periodic(Exact("0.6")),
        domain=Domain({"theta": Interval(Exact("-3.2"), Exact("3.2"))}, (parse("omega + 5", frozenset({"omega"})),)),
        noise=Box((Exact("-0.01"),), (Exact("0.01"),)),
    )


def make_design() -> Design:
    law = SamplingLaw.periodic(Exact("0.6"))
    solver = SolverRecord("clarabel", "0.11.1", "Solved", 14)
    certificate = Certificate("clock", law, {"P": [["2", "0.1"], ["0.1", "1"]]})
    gain = {"K": ExactMatrix([["1"], ["1.8361"]])}
    return Design("copying", "found", law, gain, (certificate,), solver, digests={"design": "b" * 64})


def make_check() -> Check:
    witness = Witness("switching", "class", ("0.9", "0.8131"), (("1",), ("-1",)), "1.0002", ((1, 0),))
    return Check(
        (
            Claim("slopes.2.1", "premise", "proved", "-1 <= d phi_2 / d theta <= 1", "declared slopes", True,
                  "0.000001234"),
            Claim("clock.0.6", "certificate", "proved", "V decreases along flows and jumps", "Dinh2014, (13)", False,
                  "0.03129", "clock"),
            Claim("convergence", "consequence", "proved", "The error converges for samples every 0.6 s",
                  "Dinh2014, Theorem III.2", True, None, None, "clock.0.6"),
            Claim("period.refuted", "consequence", "refuted", "Convergence at T = 1.7131", "Dinh2014, Section IV",
                  False, "-2e-4", "bang-bang", None, witness),
            Claim("printed.set", "printed", "undecided", "The printed set | contains the box", "Dinh2014, (31)"),
            Claim("printed.gain", "printed", "refuted", "A + K C is Hurwitz", "Dinh2014, (32)", witness=Witness(
                "vector", "class",
                data={"numbers": {"beta": ["1.4809", "1.4810"]}, "outside": [{"vertex": 1, "entry": [2, 2]}]})),
            Claim("domain_invariant", "consequence", "undecided", "States stay in the domain", "the plant"),
        ),
        {
            "period_max": Bound("1.71304318276", "1.71309999999", "s", "clock", "class"),
            "period_max.clarke": Bound("1.2110123", None, "s", "clarke", "this gain"),
            "period_max.clock": Bound("1.71304318276", "1.71309999999", "s", "clock", "this gain"),
            "period_max_any_gain": Bound(None, "inf", "s", None, "every gain"),
            "delta_star": Bound("1.57079632679", "1.5707963268", "s", "closed form", "the class"),
        },
        {"check": "c" * 64}, envelope={"factor": "2", "rate": "0.5"},
    )  # fmt: skip


def make_trajectory(seed: int = 0) -> Trajectory:
    """A decaying error on a fine grid, samples every 0.6 s standing in it twice."""
    samples = np.arange(0, 12, 0.6)
    t = np.unique(np.concatenate([np.linspace(0, 12, 401), samples]))
    t = np.sort(np.concatenate([t, samples[1:]]))
    x = np.stack([np.cos(t) * np.exp(-0.1 * t), -np.sin(t) * np.exp(-0.1 * t)], axis=1)
    error = np.exp(-0.7 * t)[:, None] * np.array([1.0 + 0.1 * seed, 0.5])
    y = np.interp(samples, t, x[:, 0])[:, None]
    return Trajectory(t, x, {"x_hat": x - error}, {}, samples, y)


def make_run(count: int = 1) -> Run:
    whole, late = {"theta": 0.123456, "omega": 0.0617}, {"theta": 0.001234, "omega": 0.00061}
    summary = RunSummary(20, 0.6, 0.6, 2.2e-4, whole, late, None, False, False)
    return Run(tuple(make_trajectory(i) for i in range(count)), (summary,) * count, summary, {"simulation": "d" * 64})


def make_report(
    *, title: str = HOSTILE, design: Design | None = None, check: Check | None = None, run: Run | None = None
) -> Report:
    expectations = (
        ("bounds.period_max.proved at least 0.6", True, "1.71304318276"),
        ("verdict equals refuted", False, "it is proved"),
    )
    report = Report(
        "reachability_pendulum", title, "specs/reachability_pendulum.yaml", make_plant(), Copying(),
        design or make_design(),
        check, run, expectations=expectations, digests={"plant": "a" * 64, "design": "b" * 64},
    )  # fmt: skip
    report.__dict__["versions"] = {"cdobs": "0.1.0", "python": "3.11"}
    return report
