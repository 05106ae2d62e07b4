"""A design: the gain as it is run, the sampling law it is for, and the certificates found for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

from cdobs_cli.certificate import Certificate
from cdobs_cli.codec import OPTIONAL, Artefact, Noun
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

Outcome = Literal["found", "given", "short", "none"]
COUNTEREXAMPLE = "counterexample"  # the method whose certificates hold a word that can be run
_NEAR = 1e-8  # relative: how far the end of a bracket is rounded
CHOICE = "choice"  # the entry of `details` for the families that were tried
Way = Literal["everywhere", "margin", "continuation", "cut", "open"]


@dataclass(frozen=True)
class SolverRecord(Noun):
    """Which solver was asked, and how it went. Nothing of this is ever evidence."""

    name: str
    version: str
    status: str
    iterations: int


@dataclass(frozen=True)
class Confinement(Noun):
    """How the estimate is kept where the slopes hold (`bounds.estimate` says what each way means).

    margin: by state, how far beyond the domain the estimate may go; start: the ends of each component of
    x_hat(0) - x(0) for which it goes no further. Decimals; both empty where the way is not `margin`.
    """

    way: Way = "open"
    margin: Mapping[str, str] = field(default_factory=dict)
    start: tuple[tuple[str, str], ...] = ()

    @property
    def continues(self) -> bool:
        """Whether the observer evaluates phi continued outside the box of the domain."""
        return self.way == "continuation"

    @property
    def initial_errors(self) -> Box:
        """The box of `start`. Raises: ExpressionError for what is no number."""
        return Box(tuple(Exact(low) for low, _ in self.start), tuple(Exact(high) for _, high in self.start))

    @property
    def margin_text(self) -> str:
        """`|e_x| <= 0.3, |e_v| <= 1`."""
        return ", ".join(f"|e_{name}| <= {by}" for name, by in self.margin.items())

    @property
    def start_text(self) -> str:
        """`e_x(0) in [-1, 1], e_v(0) in [0, 0]`."""
        return ", ".join(
            f"e_{name}(0) in [{low}, {high}]" for name, (low, high) in zip(self.margin, self.start, strict=True)
        )


@dataclass(frozen=True)
class FrontPoint(Noun):
    """What a gain of its own reaches at one (largest) period, each number proved when it was found: the decay rate; by
    state the error under the declared noise and disturbance (its root mean square where they are white)."""

    period: str
    rate: str | None
    error: Mapping[str, str]
    gain: Mapping[str, ExactMatrix]


@dataclass(frozen=True)
class Design(Artefact):
    """What `synthesize` made.

    gain: matrices by their paper letter (scalars are 1 x 1), exact decimals. slopes: bounds found for
    entries declared `auto`, {"i.j": [lower, upper]}. reason: why there is no design, with outcome `none`,
    or why it falls short of what was asked, with `short`.
    front: what other periods are worth, by increasing period. cut: whether the time for searches was over before they
    ended. details: what a family wants to keep for its report
    (plain JSON).
    """

    family: str
    outcome: Outcome
    sampling: SamplingLaw
    gain: Mapping[str, ExactMatrix]
    certificates: tuple[Certificate, ...] = ()
    solver: SolverRecord | None = None
    reason: str | None = None
    slopes: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)
    estimate: Confinement = Confinement()
    front: tuple[FrontPoint, ...] = ()
    cut: bool = field(default=False, metadata={OPTIONAL: True})
    digests: Mapping[str, str] = field(default_factory=dict)

    def counterexample(self, period: str | None) -> Certificate | None:
        """The stored counterexample of the law with its period replaced by this one, the refuted end of a bracket,
        rounded up; None where it was refuted otherwise."""
        if period is None:
            return None
        end = float(period)
        stored = (one for one in self.certificates if one.method == COUNTEREXAMPLE and not one.sampling.is_random)
        return next((one for one in stored if end * (1 - _NEAR) <= float(one.sampling.period) <= end), None)

    @property
    def choice(self) -> list[Mapping[str, Any]]:
        """Of each family what came of it and why it was chosen or not: {family, outcome, verdict, period, rate, why};
        empty where the family was typed."""
        return list(self.details.get(CHOICE, ()))
