"""The card of the family `updated_sampling`: high-gain observers that choose their sampling instants (Andrieu2014).

    x_hat' = A x_hat + phi(x_hat, u) + B u,   L' = a_2 L M c(x_hat, u),   M' = a_3 M c,   between samples
    x_hat+ = x_hat + delta_k calL K (C x_hat - y),   L+ = L (1 - a_1 alpha) + a_1 alpha,   M+ = 1

The next sample is when (t - t_k) L(t) = alpha.
Notation: A a chain of integrators, C = [1 0 .. 0], calL = diag(L, .., L^n), D = diag(1, .., n), e = x_hat - x,
c the incremental bound of phi, P and p_1 .. p_4 of (8)-(9), delta_k the sampling periods.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer

from cdobs_cli.chart import Exhibits
from cdobs_cli.errors import Problem
from cdobs_cli.exact.expression import Expression
from cdobs_cli.families.base import Family
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber, Rows, formula

if TYPE_CHECKING:
    from cdobs_cli.certificate import Check
    from cdobs_cli.design import Confinement, Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import HybridInclusion, Observer
    from cdobs_cli.plant import Box, Plant
    from cdobs_cli.run import Run, SimulationPlan


SCALARS = ("alpha", "a1", "a2", "a3")


class Gain(BaseModel):
    """A given gain: K, shape (n, 1), and the numbers alpha, a1, a2, a3 of (6)-(7)."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    K: Rows = Field(description="One column, a row for each state; A + K C is stable.")
    alpha: PositiveNumber = Field(description="The next sample is when the elapsed time times L is alpha.")
    a1: PositiveNumber = Field(description="How far L falls back towards 1 at a sample; a1 alpha is below 1.")
    a2: PositiveNumber = Field(description="How fast L grows with c between samples.")
    a3: NonNegativeNumber = Field(description="How fast M grows with c between samples; 0 keeps it at 1.")


class UpdatedSampling(Family):
    """`observer: {family: updated_sampling, ..}`."""

    source: ClassVar[str] = "Andrieu2014"

    family: Literal["updated_sampling"] = "updated_sampling"
    objective: Literal["max_period", "given_alpha"] = Field(
        default="max_period",
        description="The longest guaranteed time between samples (max_period), or a design for the alpha that is typed "
        "(given_alpha).",
    )
    method: Literal["theorem_2_prime", "theorem_2"] = Field(
        default="theorem_2_prime",
        description="The constants of the paper's Theorem 2, or those of a sharper form of it (theorem_2_prime).",
    )
    variant: Literal["triangular", "last_row"] = Field(
        default="triangular",
        description="Which entries of phi are uncertain: all on and below the diagonal, or those of the last row.",
    )
    alpha: PositiveNumber | None = Field(
        default=None, description="Under given_alpha: the number alpha of the sampling rule."
    )
    c: Annotated[Expression, formula("coordinates", "inputs"), PlainSerializer(str)] | None = Field(
        default=None,
        description="How fast phi may change at an estimate: an expression of states and inputs, which is proved to "
        "bound its slopes; found where left out.",
    )
    gain: Gain | None = Field(
        default=None,
        description="All of K, alpha, a1, a2 and a3, where they are given and only to be analysed; found where left "
        "out.",
    )

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.updated_sampling.structure import problems

        return problems(self, plant)

    def given(self) -> Mapping[str, ExactMatrix | None]:
        from cdobs_cli.exact.numbers import ExactMatrix

        typed = {"alpha": self.alpha} | ({name: getattr(self.gain, name) for name in SCALARS} if self.gain else {})
        letters = {name: None if (number := typed.get(name)) is None else ExactMatrix([[number]]) for name in SCALARS}
        return {"K": self.gain.K if self.gain else None, **letters}

    def synthesize(self, plant: Plant, effort: int) -> Design:
        from cdobs_cli.families.updated_sampling.synthesis import synthesize

        return synthesize(self, plant, effort)

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        from cdobs_cli.families.updated_sampling.claims import certify

        return certify(self, plant, design, effort)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.updated_sampling.lipschitz import stored_rate
        from cdobs_cli.families.updated_sampling.observer import observer

        return observer(plant, design, stored_rate(self, plant, design))

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        from cdobs_cli.families.updated_sampling.member import free_member

        return free_member(plant, gain)

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        from cdobs_cli.design import Confinement

        return Confinement("cut")

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        from cdobs_cli.families.updated_sampling.exhibits import exhibits

        return exhibits(plant, design, check, run)
