"""Enclosure is a promise: whatever is proved is simulated against corners of the boxes and extreme sampling."""

from dataclasses import replace

import numpy as np
import pytest
from interval_plants import PRINTED, box, pendulum, plant, scalar, up_to

from cdobs_cli.certify.falsify import exponentials
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.interval import Feedback, Gain, Interval
from cdobs_cli.families.interval.theorems import error_flow
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate


def signals(d, v):
    found = {f"d.{i}": parse(text, frozenset("t")) for i, text in enumerate(d)}
    return found | {f"v.{k}": parse(text, frozenset("t")) for k, text in enumerate(v)}


def run(family, at, x0, low, high, d, v, horizon="6", times=None, effort=0):
    design = family.synthesize(at, effort)
    check = family.certify(at, design, effort)
    plan = SimulationPlan(
        Exact(horizon), tuple(map(Exact, x0)), box(low, high), signals=signals(d, v),
        sampling_times=parse(times, frozenset("t")) if times else None,
    )  # fmt: skip
    return check, simulate(HybridSystem(at, family.observer(at, design)), plan, design.sampling)


@pytest.mark.parametrize("tighten", ["none", "intersect", "hull"])
def test_printed_pendulum_encloses_and_settles_at_its_width(tighten):
    feedback = Feedback(K_lower=[["-1/8", "-1/8"]], K_upper=[["-1/16", "-1/16"]])
    family = Interval(gain=PRINTED, tighten=tighten, feedback=feedback)
    check, done = run(
        family, pendulum(up_to("0.1", "0.01")), [5, -5], [-10, -10], [10, 10],
        ["0.5*sin(t)", "0.5*cos(2*t)"], ["0.1*sin(5*t)"], "36",
        "0.1*(0.5 + 0.4*sin(0.5*t))",
    )  # fmt: skip
    assert check.verdict == "proved" and not done.overall.diverged and done.overall.inclusion_margin >= 0
    trajectory = done.trajectories[0]
    late = trajectory.t > 30
    width = (trajectory.estimates["x_upper"] - trajectory.estimates["x_lower"])[late].max(axis=0)
    proved = [float(check.bounds[f"final_width.{name}"].proved) for name in ("x1", "x2")]
    assert np.all(width <= np.array(proved) * 1.001)
    if tighten == "none":
        assert width == pytest.approx([3.8, 13.4], rel=1e-3)


def test_printed_scalar_encloses_while_the_plant_converges_or_diverges():
    """The printed sampling times converge; T_k = 0.35 throughout diverges; both are enclosed all along."""
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]), feedback=Feedback(K_lower=[[-3]], K_upper=[[-3]]))
    printed = "0.175*(1 + sin(0.5*t)**2)"
    _, done = run(family, scalar(up_to("0.35")), [4], [-5], [5], ["0.1*cos(3*t)"], ["0.1*sin(5*t)"], "30", printed)
    late = done.trajectories[0].t > 20
    assert np.abs(done.trajectories[0].x[late]).max() < 2 and done.overall.inclusion_margin >= 0
    _, done = run(family, scalar(up_to("0.35")), [4], [-5], [5], ["0.1*cos(3*t)"], ["0.1*sin(5*t)"], "30", "0.35")
    assert np.abs(done.trajectories[0].x[-1]).max() > 100 and done.overall.inclusion_margin >= 0


class Stepper:
    """The observer and the plant stepped by matrix exponentials: independent of the engine and of the equations."""

    def __init__(self, A, C, S, L, d_box, v_box):
        self.A, self.C, self.S, self.L = A, C, S, L
        self.R = np.linalg.inv(S)
        Q0, Q1 = S @ A @ self.R, -S @ L @ C @ self.R
        self.M, self.N1 = error_flow(Q0), error_flow(Q1)
        self.d_box, self.v_box = d_box, v_box

    @staticmethod
    def flow(A, b, x, s):
        n = len(A)
        E = exponentials(np.block([[A, b.reshape(-1, 1)], [np.zeros((1, n + 1))]])[None] * s)[0]
        return E[:n, :n] @ x + E[:n, n]

    def advance(self, x, e, d, v, s):
        """x and e = (z - z_lower, z_upper - z) a time s after a sample; d, v constant over it."""
        plus, minus = np.maximum(self.S, 0), np.maximum(-self.S, 0)
        SL = self.S @ self.L
        up, down = np.maximum(SL, 0), np.maximum(-SL, 0)
        to_low, to_high = d - self.d_box[0], self.d_box[1] - d
        v_low, v_high = v - self.v_box[0], self.v_box[1] - v
        b = np.concatenate([
            plus @ to_low + minus @ to_high + up @ v_high + down @ v_low,
            plus @ to_high + minus @ to_low + up @ v_low + down @ v_high,
        ])  # fmt: skip
        return self.flow(self.A, d, x, s), self.flow(self.M, b + self.N1 @ e, e, s)

    def start(self, x, low, high):
        plus, minus = np.maximum(self.S, 0), np.maximum(-self.S, 0)
        return np.concatenate([plus @ (x - low) + minus @ (high - x), plus @ (high - x) + minus @ (x - low)])

    def margin(self, e):
        n = len(self.A)
        plus, minus = np.maximum(self.R, 0), np.maximum(-self.R, 0)
        return min((plus @ e[:n] + minus @ e[n:]).min(), (plus @ e[n:] + minus @ e[:n]).min())


@pytest.mark.parametrize("seed", range(14))
def test_random_plants_never_leave_their_bounds(seed):
    """Stable and unstable plants, one and two outputs; d and v at random corners, periods from tiny to Tbar."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    p = min(n, p)
    A = (rng.normal(size=(n, n)) + rng.uniform(-1, 0.7) * np.eye(n)).round(2)
    C = rng.normal(size=(p, n)).round(2)
    text = lambda M: [[f"{v:.2f}" for v in row] for row in M]  # noqa: E731
    T = f"{0.08 / max(1, np.linalg.norm(A, 2)):.4f}"
    at = plant(text(A), text(C), up_to(T), disturbance=box([-1] * n, [1] * n), noise=box(["-0.1"] * p, ["0.1"] * p))
    family = Interval(objective="min_width" if seed % 2 else "given_period")
    design = family.synthesize(at, 0)
    check = family.certify(at, design, 0)
    assert design.outcome == "found" and check.verdict == "proved"
    ones, tenth = np.ones(n), 0.1 * np.ones(p)
    stepper = Stepper(A, C, design.gain["S"].floats, design.gain["L"].floats, (-ones, ones), (-tenth, tenth))
    low, high = -rng.uniform(0, 2, n), rng.uniform(0, 2, n)
    x = np.where(rng.random(n) < 0.5, low, high)  # a corner of the box
    e = stepper.start(x, low, high)
    limit, width = 1e-9, None
    for k in range(160):
        d, v = rng.choice([-1.0, 1.0], n), 0.1 * rng.choice([-1.0, 1.0], p)
        T_k = float(T) * (1.0 if k % 3 == 0 else rng.choice([1e-6, rng.random(), 1.0]))
        for share in (0.3, 1.0):
            _, inside = stepper.advance(x, e, d, v, share * T_k)
            size = np.abs(inside).max()
            assert inside.min() >= -limit * size and stepper.margin(inside) >= -limit * size
        x, e = stepper.advance(x, e, d, v, T_k)
        width = np.abs(stepper.R) @ (e[:n] + e[n:])
    assert np.all(np.isfinite(width))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("tighten", ["none", "intersect", "hull"])
def test_the_simulated_observer_never_loses_the_state(seed, tighten):
    """The equations that are run, through the engine, with the state started in a corner of its box."""
    rng = np.random.default_rng(100 + seed)
    n, p = (2, 1) if seed % 2 else (3, 2)
    text = lambda M: [[f"{v:.2f}" for v in row] for row in M]  # noqa: E731
    A, C = text(rng.normal(size=(n, n)) - 0.3 * np.eye(n)), text(rng.normal(size=(p, n)))
    law = up_to("0.04", "0.001") if seed < 2 else SamplingLaw.periodic(Exact("0.04"))
    at = plant(A, C, law, disturbance=box([-1] * n, [2] * n), noise=box(["-0.1"] * p, ["0.3"] * p))
    corner = rng.choice(["-1", "1.5"], n).tolist()
    d = [str(value) for value in rng.choice([-1, 2], n)]
    d[0] = "0.5 + 1.5*sin(9*t)"
    times = "0.0205 + 0.0195*cos(40*t)" if seed < 2 else None
    v = [*["0.3"] * (p - 1), "0.1 + 0.2*cos(7*t)"]
    check, done = run(Interval(tighten=tighten), at, corner, ["-1"] * n, ["1.5"] * n, d, v, "1", times)
    assert check.verdict == "proved" and done.overall.inclusion_margin >= 0


def test_the_twin_that_must_not_hold_loses_it():
    """Twice the exact limit, the error started on the witness: z leaves its bounds."""
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]))
    at = replace(scalar(SamplingLaw.periodic(Exact("2.5"))), disturbance=None, noise=None)
    check, done = run(family, at, [1], [0], [1], [], [], "3")
    assert check.verdict == "refuted" and done.overall.inclusion_margin < 0
    S = ExactMatrix([[1]])
    assert family.gain is not None and family.gain.S == S
