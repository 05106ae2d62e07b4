"""A simulation as asked for, and as it came out. Arrays are over (runs, ..) from the first day."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any

from cdobs_cli.codec import OPTIONAL, Noun
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.sensors import Sensor


ESTIMATE = "hat."  # before the name of a state, in the signal of an input: its estimate


@dataclass(frozen=True)
class SimulationPlan:
    """The `simulation` block: one run from `initial_state`, or `runs` of them from `initial_box`.

    signals: expressions of `t` by name (inputs; `d.0`.. disturbances; `v.0`.. noise at samples); those of inputs may
    also read the estimate `hat.<state>` and the last measurement `y.0`, .. (feedback). Without any `d.i` (`v.k`) the
    disturbance (the noise) is drawn within what the plant declares.
    sampling_times: expression of `t` giving T_k at t_k = t; None: the design's law. latest: whether all measurements
    arrive as late as may be; else their delays are drawn.
    """

    horizon: Exact
    initial_state: tuple[Exact, ...] | None = None
    initial_box: Box | None = None
    initial_estimate: tuple[Exact, ...] | None = None
    runs: int = 1
    seed: int = 0
    signals: Mapping[str, Expression] = field(default_factory=dict)
    sampling_times: Expression | None = None
    latest: bool = field(default=False, metadata={OPTIONAL: True})

    @property
    def inputs(self) -> dict[str, Expression]:
        """The signals of the inputs."""
        return {name: signal for name, signal in self.signals.items() if "." not in name}

    def initial_errors(self, n: int) -> Box:
        """A box that holds x_hat(0) - x(0) of every run, n components."""
        known = self.initial_box
        if known is None:
            assert self.initial_state is not None
            known = Box(self.initial_state, self.initial_state)
            estimate = self.initial_estimate or (EXACT_ZERO,) * n
        else:
            estimate = self.initial_estimate or known.middle
        return Box(
            tuple(value - high for value, high in zip(estimate, known.upper, strict=True)),
            tuple(value - low for value, low in zip(estimate, known.lower, strict=True)),
        )


@dataclass(frozen=True)
class Trajectory:
    """One run. t (N,) is the output grid, with both sides of each jump (equal t twice); x (N, n);
    estimates by name (N, n); internals by name (N,); t_k (K,), y_k (K, p): what was measured when; arrival_k (K, p):
    when it arrived, where not all is there at once, not a number where an output was not read."""

    t: NDArray[np.float64]
    x: NDArray[np.float64]
    estimates: Mapping[str, NDArray[np.float64]]
    internals: Mapping[str, NDArray[np.float64]]
    t_k: NDArray[np.float64]
    y_k: NDArray[np.float64]
    inputs: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    stopped: str | None = None
    arrival_k: NDArray[np.float64] | None = None

    def read_by(self, sensor: Sensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The instants at which a sensor is read (K_s,), and what it says (K_s, its outputs): y_k is NaN elsewhere."""
        import numpy as np

        own = self.y_k[:, list(sensor.outputs)]
        at = ~np.isnan(own).all(axis=1)
        return self.t_k[at], own[at]


@dataclass(frozen=True)
class Departure(Noun):
    """Leaving the domain: `what` (a state, the estimate of one, a condition) is first seen outside at `time`, at
    `value`; `allowed` is where it should be, and `beyond` how far outside it comes in all."""

    what: str
    time: float
    value: float
    allowed: str
    beyond: float


@dataclass(frozen=True)
class RunSummary(Noun):
    """The figures of one run, as in `simulation.json`; of all runs, the earliest departure.

    rmse: of each state's error, over the whole run; rmse_after_transient: over its second half; error_max: its largest
    size.
    """

    measurements: int
    period_min: float | None
    period_max: float | None
    error_final: float | None
    rmse: Mapping[str, float]
    rmse_after_transient: Mapping[str, float]
    inclusion_margin: float | None
    diverged: bool
    left_domain: bool
    departure: Departure | None = None
    stopped: str | None = None
    error_max: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Compared(Noun):
    """Root mean square errors of one state after the transient: of the observer, and of the filter beside it."""

    rmse: float
    rmse_ekf: float | None


@dataclass(frozen=True)
class Comparison(Noun):
    """The observer beside the extended Kalman filter on the same measurements, over runs number 0 to seeds - 1.

    reason: why there is no filter, or none that came to an end.
    """

    seeds: int
    states: Mapping[str, Compared]
    reason: str | None = None


@dataclass(frozen=True)
class Filtered:
    """The error of the filter beside the observer in run 0: t (N,), error (N, n)."""

    t: NDArray[np.float64]
    error: NDArray[np.float64]


@dataclass(frozen=True)
class Ensemble(Noun):
    """Many runs: the numbers of those shown, which one is worst, the share that diverged, and the samples of a run."""

    runs: int
    shown: tuple[int, ...]
    worst: int
    diverged: float
    measurements: Mapping[str, int]

    @staticmethod
    def of(summaries: Sequence[RunSummary], shown: tuple[int, ...], worst: int) -> Ensemble:
        counts = sorted(one.measurements for one in summaries)
        samples = {"least": counts[0], "median": counts[(len(counts) - 1) // 2], "most": counts[-1]}
        return Ensemble(len(counts), shown, worst, sum(one.diverged for one in summaries) / len(counts), samples)


@dataclass(frozen=True)
class Bands:
    """Of the errors of all runs: percentiles `levels` (Q,) of each state's |e| at times t (G,), values (Q, G); infinite
    where a run came to no end."""

    t: NDArray[np.float64]
    levels: tuple[float, ...]
    values: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Run:
    """All runs of one simulation; steps: of the integration, of the run that took most (not stored); implicit: how many
    runs were found stiff, and went on with an implicit method.

    ensemble: of many runs, whose trajectories are kept and what all of them came to; None where all are kept.
    """

    trajectories: tuple[Trajectory, ...]
    summaries: tuple[RunSummary, ...]
    overall: RunSummary
    digests: Mapping[str, str] = field(default_factory=dict)
    comparison: Comparison | None = None
    filtered: Filtered | None = None
    steps: int = 0
    implicit: int = 0
    ensemble: Ensemble | None = None
    bands: Bands | None = None

    @property
    def shown(self) -> tuple[int, ...]:
        """The numbers of the runs that trajectories are kept of."""
        return tuple(range(len(self.summaries))) if self.ensemble is None else self.ensemble.shown

    def document(self) -> dict[str, Any]:
        further: dict[str, Any] = {} if self.comparison is None else {"comparison": self.comparison.document()}
        further |= {"implicit": self.implicit} if self.implicit else {}
        further |= {} if self.ensemble is None else {"ensemble": self.ensemble.document()}
        return {
            "schema_version": 1, "runs": [summary.document() for summary in self.summaries],
            "overall": self.overall.document(), **further, "digests": dict(self.digests),
        }  # fmt: skip
