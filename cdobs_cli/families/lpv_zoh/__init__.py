"""The card of the family `lpv_zoh`: LPV observers with held innovation (Boukal2020).

    x_hat' = A x_hat + phi(x_hat, u) + B u + L r,    r held: r = y(t_k) - C x_hat(t_k) from t_k to t_(k+1)

Notation: tau_max the largest period, A_i = A + V at a corner of the slope box, F_i = A_i - L C,
w = C (e - e(t_k)), P and U Lyapunov and Wirtinger matrices, Y = P L, sigma the decay rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from cdobs_cli.errors import Problem
from cdobs_cli.families.constant_gain import OBJECTIVE_WORDS, ConstantGain, Objective
from cdobs_cli.fields import Rows

if TYPE_CHECKING:
    from cdobs_cli.certificate import Bound, Check, Claim
    from cdobs_cli.certify.design import Beyond
    from cdobs_cli.certify.gains import GainSearch
    from cdobs_cli.certify.judge import Judgement
    from cdobs_cli.certify.methods.base import Method, Question
    from cdobs_cli.certify.methods.named import Known
    from cdobs_cli.certify.methods.rung import Rung
    from cdobs_cli.chart import Exhibits
    from cdobs_cli.design import Design
    from cdobs_cli.hybrid import ErrorMaps, NoiseMaps, Observer, PlantView
    from cdobs_cli.plant import Plant
    from cdobs_cli.run import Run, SimulationPlan


class Gain(BaseModel):
    """A given gain: L, shape (n, p)."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    L: Rows = Field(description="A row for each state, a column for each output.")


class PrintedData(BaseModel):
    """(P, Y) of Theorem 1 as printed somewhere, shapes (n, n) and (n, 1), to be put to the test; `vertices`
    the printed A_i, where they are not the corners of the declared slopes."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    P: Rows = Field(description="The Lyapunov matrix as printed, a row and a column for each state.")
    Y: Rows = Field(description="P L as printed, a row for each state.")
    vertices: Annotated[tuple[Rows, ...], Field(min_length=1, max_length=256)] | None = Field(
        default=None, description="The matrices A_i as printed; the corners of the slopes where left out."
    )


class LpvZeroOrderHold(ConstantGain):
    """`observer: {family: lpv_zoh, ..}`."""

    source: ClassVar[str] = "Boukal2020"
    letter: ClassVar[str] = "L"
    error_source: ClassVar[str] = "Boukal2020, (24)"
    rate_share: ClassVar[float] = 0.002
    with_rates: ClassVar[bool] = True
    takes_delays: ClassVar[Literal["none", "one", "several"]] = "one"

    family: Literal["lpv_zoh"] = "lpv_zoh"
    objective: Objective = Field(default="given_period", description=OBJECTIVE_WORDS)
    method: Literal["best", "clock", "wirtinger", "repaired", "theorem_1"] = Field(
        default="best",
        description="How it is proved: by the paper's theorem as printed (theorem_1) or with its proof repaired "
        "(repaired), by an integral inequality (wirtinger), by a function of error and time since the "
        "sample (clock), or by whatever reaches further (best).",
    )
    gain: Gain | None = Field(
        default=None, description="The gain, where it is given and only to be analysed; found where left out."
    )
    printed: PrintedData | None = Field(
        default=None, description="Data of the theorem from a page, each put to the test by a claim of its own."
    )

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.lpv_zoh.structure import problems

        return [*super().problems(plant, simulation), *problems(self, plant)]

    def error_maps(self, view: PlantView[Any]) -> ErrorMaps[Any]:
        from cdobs_cli.families.lpv_zoh.theorems import error_maps, held_maps

        return held_maps(view) if view.outputs else error_maps(view)

    def noise_maps(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        from cdobs_cli.families.lpv_zoh.theorems import held_noise_maps, noise_maps

        return held_noise_maps(view) if view.outputs else noise_maps(view)

    def late_maps(self, view: PlantView[Any]) -> tuple[ErrorMaps[Any], NoiseMaps[Any]]:
        """Over (e, r), r the innovation that is held while samples are under way."""
        from cdobs_cli.families.lpv_zoh.theorems import held_maps, held_noise_maps

        return held_maps(view), held_noise_maps(view)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.lpv_zoh.observer import observer

        return observer(plant, design)

    def methods(self) -> tuple[Known, ...]:
        from cdobs_cli.certify.methods import named

        repaired = named.Named("repaired", f"{__name__}.repaired", "Repaired")
        printed = named.Named("theorem_1", f"{__name__}.printed_search", "PrintedTheorem1")
        without = named.OPEN_LOOP, named.UNCORRECTED, named.EVERY_PERIOD
        return (named.WIRTINGER, *named.GENERAL, repaired, printed, named.NO_GAIN, *without)

    def rungs(self, question: Question) -> Sequence[Rung]:
        from cdobs_cli.families.lpv_zoh.search_plan import rungs

        return rungs(self, question)

    def gain_searches(self, question: Question) -> Sequence[GainSearch]:
        from cdobs_cli.families.lpv_zoh.gains import ClockGain, HeldGain, MiddleGain, PeriodClimb
        from cdobs_cli.families.lpv_zoh.search_plan import REPAIRED, THEOREM_1, clock_is_tried

        if question.inclusion.outputs:
            return (MiddleGain(),)
        if self.method in ("repaired", "theorem_1"):
            return (PeriodClimb(REPAIRED if self.method == "repaired" else THEOREM_1),)
        if self.method == "wirtinger" or (self.method == "best" and not clock_is_tried(question)):
            return (HeldGain(),)
        return (ClockGain(),)

    def refuses(self, plant: Plant) -> str | None:
        from cdobs_cli.families.lpv_zoh.search_plan import too_many_corners

        return super().refuses(plant) or too_many_corners(plant)

    def beyond(self, question: Question, own: Sequence[Method]) -> Beyond:
        from cdobs_cli.families.lpv_zoh.search_plan import beyond

        return beyond(self, question, own)

    def claims_beside(self, judgement: Judgement) -> tuple[list[Claim], dict[str, Bound]]:
        from cdobs_cli.families.lpv_zoh.printed_claims import printed_claims

        return printed_claims(self, judgement.plant, judgement.design)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        from cdobs_cli.families.lpv_zoh.exhibits import exhibits

        return exhibits(self, plant, design, check, run)
