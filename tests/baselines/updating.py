"""Measurements used against error reached, on the plant of specs/updated_sampling_unstable.yaml or of another spec.

Each method is run over a grid of its own settings on the same seeds; its front is the fewest measurements
for each error. The error is |x_hat - x|, root mean square over runs and over the last two thirds of the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from cdobs_cli.baselines.constant_gain import constant_gain, placed_gain
from cdobs_cli.baselines.kalman import extended_kalman_filter
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.updated_sampling import UpdatedSampling
from cdobs_cli.families.updated_sampling.lipschitz import rate_of
from cdobs_cli.hybrid import HybridInclusion, HybridSystem, Observer, corrected_copy
from cdobs_cli.plant import Box
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.spec.model import Spec, load
from cdobs_cli.spec.simulation_block import NOISE_FUNCTIONS

SPEC = Path(__file__).parents[2] / "specs" / "updated_sampling_unstable.yaml"
METHODS = ("updated", "constant period", "Kalman filter", "updated, proved")


@dataclass(frozen=True)
class Point:
    """One setting of one method: measurements per run over the whole horizon, and the error (inf: stopped)."""

    method: str
    settings: str
    measurements: float
    error: float
    worst: float = float("nan")  # of the runs, each by itself


class Comparison:
    """The spec's plant and input, uniform noise of this half width, so many runs from one seed."""

    def __init__(self, runs: int, horizon: str, seed: int = 1, noise: str = "0.01", path: Path = SPEC) -> None:
        self.spec: Spec = load(path)
        assert self.spec.simulation is not None
        self.noise = noise
        drawn = parse(f"uniform(-{noise}, {noise})", frozenset(), {}, NOISE_FUNCTIONS)
        signals = {**self.spec.simulation.signals, "v.0": drawn}
        self.plan: SimulationPlan = replace(
            self.spec.simulation, runs=runs, horizon=Exact(horizon), seed=seed, signals=signals
        )

    def point(self, method: str, settings: str, observer: Observer, law: SamplingLaw) -> Point:
        width = Exact(self.noise)
        plant = replace(self.spec.plant, sampling=law, noise=Box((-width,), (width,)))
        run = simulate(HybridSystem(plant, observer), self.plan, law)
        squares = []
        for trajectory in run.trajectories:
            if trajectory.stopped is not None:
                return Point(method, settings, float("inf"), float("inf"), float("inf"))
            late = trajectory.t >= trajectory.t[-1] / 3
            t, e = trajectory.t[late], (trajectory.estimates["x_hat"] - trajectory.x)[late]
            squares.append(np.trapezoid((e * e).sum(axis=1), t) / (t[-1] - t[0]))
        count = float(np.mean([len(trajectory.t_k) for trajectory in run.trajectories]))
        return Point(method, settings, count, float(np.sqrt(np.mean(squares))), float(np.sqrt(np.max(squares))))

    def updated(self, alpha: str, a_2: str) -> Point:
        """K alpha = [-3/4, -3/20]/alpha^(i-1), a_1 alpha = 0.3: the spec's tuning, at other alpha and a_2."""
        size = Fraction(alpha)
        gain = {
            "K": [[str(Fraction(-3, 4) / size)], [str(Fraction(-3, 20) / size**2)]],
            "alpha": alpha, "a1": str(Fraction(3, 10) / size), "a2": a_2, "a3": 0,
        }  # fmt: skip
        family = UpdatedSampling.model_validate({"family": "updated_sampling", "gain": gain})
        assert family.gain is not None
        matrices = {"K": family.gain.K} | {
            name: ExactMatrix([[getattr(family.gain, name)]]) for name in ("alpha", "a1", "a2", "a3")
        }
        plant = self.spec.plant
        design = Design(
            family.name, "given", plant.sampling, matrices, details={"rate": rate_of(family, plant).document()}
        )
        return self.point("updated", f"alpha {alpha}, a2 {a_2}", family.observer(plant, design), plant.sampling)

    def proved(self) -> Point:
        family = UpdatedSampling()
        design = family.synthesize(self.spec.plant, 0)
        settings = f"alpha {design.gain['alpha'][0, 0]}, a2 {design.gain['a2'][0, 0]}"
        return self.point(
            "updated, proved", settings, family.observer(self.spec.plant, design), self.spec.plant.sampling
        )

    def constant(self, period: str, radius: float) -> Point:
        K = placed_gain(self.spec.plant.A.floats, self.spec.plant.C.floats, float(Exact(period)), radius)
        law = SamplingLaw.periodic(Exact(period))
        return self.point("constant period", f"period {period}, poles {radius}", constant_gain(self.spec.plant, K), law)

    def kalman(self, period: str, q: str) -> Point:
        """R is the variance of the uniform noise, P(0) that of the initial box; q acts on the last state."""
        observer = self._filter(q)
        return self.point("Kalman filter", f"period {period}, q {q}", observer, SamplingLaw.periodic(Exact(period)))

    def _filter(self, q: str) -> Observer:
        n, variance = self.spec.plant.n, Exact(Fraction(1, 3) * Fraction(self.noise) ** 2)
        Q = ExactMatrix([[q if i == j == n - 1 else 0 for j in range(n)] for i in range(n)])
        P_0 = ExactMatrix([["1/3" if i == j else 0 for j in range(n)] for i in range(n)])
        return extended_kalman_filter(self.spec.plant, Q, ExactMatrix([[variance]]), P_0)

    def carried(self, **options: object) -> tuple[Point, Observer] | None:
        """A certificate carried online, with its observer; None where no law is proved."""
        family = UpdatedSampling.model_validate({"family": "updated_sampling", "method": "carried", **options})
        width = Exact(self.noise)
        plant = replace(self.spec.plant, noise=Box((-width,), (width,)))
        design = family.synthesize(plant, 0)
        if design.outcome == "none" or family.certify(plant, design, 0).verdict != "proved":
            return None
        law, observer = design.details["law"], family.observer(plant, design)
        share = (options.get("law") or {}).get("share", "1")  # type: ignore[attr-defined]
        settings = f"T_min {law['T_min']}, sigma {law['sigma']}, share {share}"
        return self.point("carried", settings, observer, plant.sampling), observer

    def kalman_at_the_same(self, carried: Observer, q: str) -> Point:
        """The filter at the instants that the observer of a carried certificate chooses, both run together."""
        own = self._filter(q)
        both = replace(
            carried,
            states=carried.states + own.states, start=carried.start + own.start, flow=carried.flow + own.flow,
            jump=carried.jump + own.jump, estimates=own.estimates, internals={},
        )  # fmt: skip
        return self.point("Kalman filter, same instants", f"q {q}", both, self.spec.plant.sampling)

    def clocked(self, period: str) -> Point | None:
        """A constant period with a gain that the clock certificate proves for the largest slopes; None without."""
        plant = self.spec.plant
        nothing = {"K": ExactMatrix([[0]] * plant.n)}
        inclusion = HybridInclusion(
            corrected_copy, replace(plant, sampling=SamplingLaw.periodic(Exact(period))), nothing,
            SamplingLaw.periodic(Exact(period)), plant.slopes.quantities,
        )  # fmt: skip
        met = design_impulsive(Question(inclusion, effort=0))
        if met is None:
            return None
        law = SamplingLaw.periodic(Exact(period))
        return self.point("constant, clock", f"period {period}", constant_gain(plant, met[0]), law)

    def tuned(self, alpha: str, a_1_alpha: str, a_2: str, radius: float) -> Point:
        """The observer of the theorems with poles of its one-step map at `radius`, met by no theorem."""
        size, plant = Fraction(alpha), self.spec.plant
        K = placed_gain(plant, float(size), radius).floats
        column = [[str(Fraction(-float(one)).limit_denominator(10**6) / size)] for one in K[:, 0]]
        gain = {"K": column, "alpha": alpha, "a1": str(Fraction(a_1_alpha) / size), "a2": a_2, "a3": 0}
        family = UpdatedSampling.model_validate({"family": "updated_sampling", "gain": gain})
        matrices = {name: matrix for name, matrix in family.given().items() if matrix is not None}
        rate = rate_of(family, plant).document()
        design = Design(family.name, "given", plant.sampling, matrices, details={"rate": rate})
        settings = f"alpha {alpha}, a1 alpha {a_1_alpha}, a2 {a_2}, poles {radius}"
        return self.point("hand-tuned", settings, family.observer(plant, design), plant.sampling)

    def points(
        self,
        alphas: Iterable[str],
        a_2s: Iterable[str],
        periods: Iterable[str],
        radii: Iterable[float],
        qs: Iterable[str],
    ) -> Iterator[Point]:
        """The whole grid."""
        a_2s, periods, radii, qs = list(a_2s), list(periods), list(radii), list(qs)
        yield self.proved()
        yield from (self.updated(alpha, a_2) for alpha in alphas for a_2 in a_2s)
        for period in periods:
            yield from (self.constant(period, radius) for radius in radii)
            yield from (self.kalman(period, q) for q in qs)


def front(points: Iterable[Point], method: str) -> list[Point]:
    """The points of a method that no other of its points beats, by measurements."""
    kept: list[Point] = []
    for point in sorted(
        (p for p in points if p.method == method and np.isfinite(p.error)), key=lambda p: (p.measurements, p.error)
    ):
        if not kept or point.error < kept[-1].error:
            kept.append(point)
    return kept


def fewest(points: Iterable[Point], method: str, error: float) -> Point | None:
    """The setting with the fewest measurements that reaches an error."""
    return next((point for point in front(points, method) if point.error <= error), None)
