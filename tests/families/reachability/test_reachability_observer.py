"""The observer's equations, its proved envelope and its exhibits along simulated runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from designing import designed
from reachability_plants import symmetric_chain

from cdobs_cli.certificate import Check
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.run import SimulationPlan
from cdobs_cli.simulate.engine import simulate


def nonlinear(n, T):
    p = symmetric_chain((1,) + (0,) * (n - 1), T)
    phi = (*(parse("0") for _ in range(n - 1)), parse("sin(x0)", frozenset({"x0"})))
    return replace(p, phi=phi)


@pytest.mark.parametrize(("n", "T"), [(2, "0.6"), (3, "0.7")])
def test_the_error_stays_under_the_proved_envelope_and_V_under_its_bound(n, T):
    family, p = Reachability(method="set"), nonlinear(n, T)
    design = designed(family, p, 0)
    check = family.certify(p, design, 0)
    envelope = {name: float(text) for name, text in check.envelope.items()}
    plan = SimulationPlan(
        Exact(8), tuple(Exact(1) for _ in range(n)), initial_estimate=tuple(Exact(0) for _ in range(n))
    )
    run = simulate(HybridSystem(p, family.observer(p, design)), plan, design.sampling)
    path = run.trajectories[0]
    error = np.linalg.norm(path.estimates["x_hat"] - path.x, axis=1)
    proved = envelope["factor"] * np.sqrt(n) * np.exp(-envelope["rate"] * path.t)
    assert np.all(error <= proved * (1 + 1e-6) + 1e-9)
    assert envelope["rate"] == pytest.approx(float(check.bounds["decay_rate"].proved), rel=1e-6)
    charts = {chart.name: chart for chart in family.exhibits(p, design, check, run).charts}
    measured, bound = charts["lyapunov"].panels[0].series
    assert np.all(np.asarray(measured.y)[: len(bound.y)] <= np.asarray(bound.y) * (1 + 1e-6) + 1e-16)
    assert "feasible_period" in charts
    # What a stored certificate says of itself is not drawn.
    nothing = {chart.name: chart for chart in family.exhibits(p, design, Check(()), run).charts}
    assert "lyapunov" not in nothing
    if n > 2:
        names = [series.label for series in nothing["feasible_period"].panels[0].series]
        assert "largest period of the set" not in names


def test_the_jump_is_the_papers():
    family, p = Reachability(gain={"K": [["1"], ["1.5"]]}), nonlinear(2, "0.6")
    observer = family.observer(p, designed(family, p, 0))
    env = {"hat.x0": 2.0, "hat.x1": -1.0, "y.0": 5.0}
    from cdobs_cli.exact.compiled import compile_floats

    jump = compile_floats(observer.jump, list(env), arrays=False)(*env.values())
    assert jump == pytest.approx((2 + (5 - 2), -1 + 1.5 * (5 - 2)))


def test_the_feasible_period_falls_with_the_slopes():
    family, p = Reachability(method="set"), nonlinear(2, "0.6")
    design = designed(family, p, 0)
    (chart,) = (c for c in family.exhibits(p, design, None, None).charts if c.name == "feasible_period")
    curves = {series.label: series for series in chart.panels[0].series}
    periods = curves["largest period of the set"]
    assert np.all(np.diff(periods.y) < 0)
    # One slope c: delta goes with 1 / sqrt(c).
    assert np.asarray(periods.y) * np.sqrt(periods.x) == pytest.approx(1.2110166, rel=1e-6)
    star = curves["delta_star, (31) holds below"]
    assert np.asarray(star.y) * np.sqrt(star.x) == pytest.approx(np.pi / 2, rel=1e-12)
