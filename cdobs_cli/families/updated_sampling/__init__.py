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


class Rule(BaseModel):
    """When a carried certificate asks for a sample, beside the floor of Pi, which always does."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    trigger: Literal["pi", "integral"] = Field(
        default="pi",
        description="Only when Pi has come down to its floor (pi), or as well when the integral of sqrt(c / largest c) "
        "since the last sample reaches kappa (integral).",
    )
    kappa: PositiveNumber | None = Field(
        default=None, description="With integral: a time, the longest from sample to sample at the largest c."
    )


class CarriedLaw(BaseModel):
    """Constants of a carried certificate; what is left out is found."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    F: Rows | None = Field(
        default=None,
        description="The floor of Pi at samples, (n, n): given, the whole law is; then split, sigma, T_min too.",
    )
    share: PositiveNumber | None = Field(
        default=None,
        description="F is this share of the largest that there is, 1 where left out: a smaller one asks for fewer "
        "measurements where c is small, and leaves larger proved errors.",
    )
    split: Rows | None = Field(
        default=None,
        description="(n, n), positive where a slope is: the l of 2 a b <= l a^2 + b^2 / l, at the largest c.",
    )
    Lambda: Rows | None = Field(
        default=None, description="One row: the weight of each output; 1 / (size of its noise)^2 where left out."
    )
    gamma: Rows | None = Field(default=None, description="One row: the weight of each state's disturbance.")
    sigma: PositiveNumber | None = Field(default=None, description="The rate of decay at the largest c, 1 / time.")
    theta: NonNegativeNumber | None = Field(
        default=None, description="split follows c^-theta, below 1; 1/4 where left out."
    )
    idle: PositiveNumber | None = Field(
        default=None,
        description="sigma follows sqrt(c), down to this share of it, at most 1; 0.1 where left out, 1 where an error "
        "is asked for.",
    )
    T_min: PositiveNumber | None = Field(default=None, description="No sample comes sooner after the last one.")
    epsilon: PositiveNumber | None = Field(
        default=None,
        description="A sample is due when det(Pi - F) is this share of det F; 10^-(3 + 3 n) where left out.",
    )


class UpdatedSampling(Family):
    """`observer: {family: updated_sampling, ..}`."""

    source: ClassVar[str] = "Andrieu2014"

    family: Literal["updated_sampling"] = "updated_sampling"
    objective: Literal["max_period", "given_alpha", "min_error"] = Field(
        default="max_period",
        description="The longest guaranteed time between samples (max_period), a design for the alpha that is typed "
        "(given_alpha), or, of method carried, the least proved error for a budget of measurements (min_error).",
    )
    method: Literal["theorem_2_prime", "theorem_2", "carried"] = Field(
        default="theorem_2_prime",
        description="The constants of the paper's Theorem 2, or those of a sharper form of it (theorem_2_prime); or a "
        "certificate that the observer carries along, and its gain from that (carried).",
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

    rule: Rule | None = Field(default=None, description="Of method carried: what else asks for a sample.")
    budget: PositiveNumber | None = Field(
        default=None,
        description="Of method carried: measurements per time, at most; none comes sooner than 1 / budget.",
    )
    reset: bool = Field(
        default=False, description="Of method carried: whether Pi starts anew at each sample, from the least it may be."
    )
    read: Literal["all", "one"] = Field(
        default="all",
        description="Of method carried: whether a sample reads all outputs, or one of them, which Pi chooses.",
    )
    error_at_most: dict[str, PositiveNumber] | None = Field(
        default=None,
        description="Of method carried, state: the largest proved error; the longest time between samples that keeps "
        "it is found.",
    )
    law: CarriedLaw | None = Field(
        default=None, description="Of method carried: constants of the certificate; what is left out is found."
    )

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.updated_sampling.structure import problems

        return problems(self, plant)

    @property
    def is_carried(self) -> bool:
        """Whether the observer carries its certificate, and has no gain of its own."""
        return self.method == "carried"

    @property
    def is_given(self) -> bool:
        if self.is_carried:
            from cdobs_cli.families.updated_sampling.carried.typed import is_whole

            return is_whole(self)
        return super().is_given

    def given(self) -> Mapping[str, ExactMatrix | None]:
        if self.is_carried:
            return {}
        from cdobs_cli.exact.numbers import ExactMatrix

        typed = {"alpha": self.alpha} | ({name: getattr(self.gain, name) for name in SCALARS} if self.gain else {})
        letters = {name: None if (number := typed.get(name)) is None else ExactMatrix([[number]]) for name in SCALARS}
        return {"K": self.gain.K if self.gain else None, **letters}

    def synthesize(self, plant: Plant, effort: int) -> Design:
        if self.is_carried:
            from cdobs_cli.families.updated_sampling.carried.synthesis import synthesize as carried

            return carried(self, plant, effort)
        from cdobs_cli.families.updated_sampling.synthesis import synthesize

        return synthesize(self, plant, effort)

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        if self.is_carried:
            from cdobs_cli.families.updated_sampling.carried.claims import certify as carried

            return carried(self, plant, design)
        from cdobs_cli.families.updated_sampling.claims import certify

        return certify(self, plant, design, effort)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.updated_sampling.lipschitz import stored_rate

        if self.is_carried:
            from cdobs_cli.families.updated_sampling.carried.claims import as_run

            return as_run(self, plant, design)
        from cdobs_cli.families.updated_sampling.observer import observer

        return observer(plant, design, stored_rate(self, plant, design))

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        if self.is_carried:
            return super().inclusion(plant, gain)
        from cdobs_cli.families.updated_sampling.member import free_member

        return free_member(plant, gain)

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        from cdobs_cli.design import Confinement

        return Confinement("cut")

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        if self.is_carried:
            from cdobs_cli.families.updated_sampling.carried.exhibits import exhibits as carried

            return carried(self, plant, design, check, run)
        from cdobs_cli.families.updated_sampling.exhibits import exhibits

        return exhibits(plant, design, check, run)
