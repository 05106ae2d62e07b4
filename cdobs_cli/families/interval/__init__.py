"""The card of the family `interval`: two bounds that enclose the state between samples (Efimov2016).

    x_lower(t) <= x(t) <= x_upper(t) for all t,    xdot = A x + B u + d,    y_k = C x(t_k) + v_k

Notation: z = S x the coordinates the bounds live in, Q0 = S A S^-1, Q1 = -S L C S^-1, e = (z - z_lower,
z_upper - z), E(s) the map of e over a time s since a sample, Mtot the matrix of the width, w* its witness,
Tbar the largest sampling period.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from cdobs_cli.errors import Problem
from cdobs_cli.families.base import Family
from cdobs_cli.fields import Rows

if TYPE_CHECKING:
    from cdobs_cli.certificate import Check
    from cdobs_cli.chart import Exhibits
    from cdobs_cli.design import Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import HybridInclusion, Observer
    from cdobs_cli.plant import Plant
    from cdobs_cli.run import Run, SimulationPlan


class Gain(BaseModel):
    """A given observer: S, shape (n, n), and L, shape (n, p)."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    S: Rows = Field(description="The coordinates z = S x that the bounds live in; a row and a column for each state.")
    L: Rows = Field(description="The gain, a row for each state, a column for each output.")


class Feedback(BaseModel):
    """Given feedback u = K_lower z_lower + K_upper z_upper at samples, both of shape (m, n)."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    K_lower: Rows = Field(description="Of the lower bounds: a row for each input, a column for each state.")
    K_upper: Rows = Field(description="Of the upper bounds: a row for each input, a column for each state.")


FeedbackField = Annotated[
    Annotated[Literal["none", "design"], Tag("a word")] | Annotated[Feedback, Tag("given gains")],
    Discriminator(lambda value: "given gains" if isinstance(value, dict | Feedback) else "a word"),
]


class Interval(Family):
    """`observer: {family: interval, ..}`."""

    disturbed: ClassVar[bool] = True
    source: ClassVar[str] = "Efimov2016"

    family: Literal["interval"] = "interval"
    objective: Literal["given_period", "max_period", "min_width"] = Field(
        default="given_period",
        description="The period as typed (given_period), the longest period (max_period), or the narrowest bounds in "
        "the end (min_width).",
    )
    tighten: Literal["none", "intersect", "hull"] = Field(
        default="none",
        description="What makes the bounds narrower: nothing, intersection with what each measurement allows "
        "(intersect), or bounds carried from sample to sample as a hull (hull).",
    )
    feedback: FeedbackField = Field(
        default="none",
        description="A control computed from the bounds at samples: none, one that is found (design), or given gains.",
    )
    gain: Gain | None = Field(
        default=None, description="S and L, where they are given and only to be analysed; found where left out."
    )

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.interval.structure import problems

        return problems(self, plant, simulation)

    def given(self) -> Mapping[str, ExactMatrix | None]:
        S, L = (self.gain.S, self.gain.L) if self.gain else (None, None)
        letters: dict[str, ExactMatrix | None] = {"S": S, "L": L}
        if self.feedback == "design":
            letters |= {"K_lower": None, "K_upper": None}
        elif self.feedback != "none":
            letters |= {"K_lower": self.feedback.K_lower, "K_upper": self.feedback.K_upper}
        return letters

    def controlled(self, inputs: tuple[str, ...]) -> frozenset[str]:
        return frozenset() if self.feedback == "none" else frozenset(inputs)

    def synthesize(self, plant: Plant, effort: int) -> Design:
        from cdobs_cli.families.interval.synthesis import synthesize

        return synthesize(self, plant, effort)

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        from cdobs_cli.families.interval.claims import certify

        return certify(self, plant, design, effort)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.interval.observer import hull_observer, interval_observer

        if self.tighten == "hull":
            return hull_observer(plant, design)
        return interval_observer(plant, design, intersect=self.tighten == "intersect")

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        from cdobs_cli.families.interval.observer import inclusion

        return inclusion(plant, gain)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        from cdobs_cli.families.interval.exhibits import exhibits

        return exhibits(self, plant, design, check, run)
