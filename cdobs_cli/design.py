"""A design: the gain as it is run, the sampling law it is for, and the certificates found for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from cdobs_cli.certificate import Certificate
from cdobs_cli.codec import read_fields
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Box
from cdobs_cli.sampling import SamplingLaw

Outcome = Literal["found", "given", "none"]
Way = Literal["everywhere", "margin", "continuation", "cut", "open"]


@dataclass(frozen=True)
class SolverRecord:
    """Which solver was asked, and how it went. Nothing of this is ever evidence."""

    name: str
    version: str
    status: str
    iterations: int

    def document(self) -> dict[str, Any]:
        return {"name": self.name, "version": self.version, "status": self.status, "iterations": self.iterations}


@dataclass(frozen=True)
class Confinement:
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

    def document(self) -> dict[str, Any]:
        return {"way": self.way, "margin": dict(self.margin), "start": [list(ends) for ends in self.start]}


@dataclass(frozen=True)
class Design:
    """What `synthesize` made.

    gain: matrices by their paper letter (scalars are 1 x 1), exact decimals. slopes: bounds found for
    entries declared `auto`, {"i.j": [lower, upper]}. reason: why there is no design, with outcome `none`.
    details: what a family wants to keep for its report (plain JSON).
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
    digests: Mapping[str, str] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        return {
            "schema_version": 1, "family": self.family, "outcome": self.outcome, "reason": self.reason,
            "sampling": self.sampling.document(), "gain": {name: matrix.texts() for name, matrix in self.gain.items()},
            "slopes": {name: list(ends) for name, ends in self.slopes.items()},
            "certificates": [certificate.document() for certificate in self.certificates],
            "estimate": self.estimate.document(), "details": dict(self.details), "solver": self.solver.document() if self.solver else None,
            "digests": dict(self.digests),
        }  # fmt: skip

    @staticmethod
    def from_document(document: dict[str, Any]) -> Design:
        """Raises: KeyError, TypeError, ValueError on anything `document` did not write."""
        return read_fields(Design, {key: value for key, value in document.items() if key != "schema_version"})
