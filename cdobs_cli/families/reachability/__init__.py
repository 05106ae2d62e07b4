"""The card of the family `reachability`: Lipschitz observers corrected at samples (Dinh2014).

    between samples  x_hat' = A x_hat + phi(x_hat, u) + B u,    at samples  x_hat+ = x_hat + K (y_k - C x_hat)

Notation: delta the period, V(t) the slopes of phi, M(delta) a matrix of the set that holds every
Phi_V(delta), P or Q the Lyapunov matrix, W = P K.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.constant_gain import OBJECTIVE_WORDS, ConstantGain, Objective
from cdobs_cli.fields import ExpressionInDelta, Rows
from cdobs_cli.sensors import MAX_PHASES

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

MAX_STATES = 8
# An entry of a matrix of the set: one expression in `delta`, or a list of the values it takes.
Alternatives = Annotated[tuple[ExpressionInDelta, ...], Field(max_length=16)]
SetEntry = Annotated[
    Annotated[ExpressionInDelta, Tag("one value")] | Annotated[Alternatives, Tag("list of values")],
    Discriminator(lambda value: "list of values" if isinstance(value, list | tuple) else "one value"),
]
SetRow = Annotated[tuple[SetEntry, ...], Field(max_length=MAX_STATES)]
SetMatrix = Annotated[tuple[SetRow, ...], Field(max_length=MAX_STATES)]


def _kind_of_gain(value: Any) -> str:
    if isinstance(value, dict):
        return "by sensors"
    if isinstance(value, list | tuple) and value:
        first = value[0]
        inner = first[0] if isinstance(first, list | tuple) and first else None
        if isinstance(first, ExactMatrix) or isinstance(inner, list | tuple):
            return "by sample"
    return "one matrix"


class Gain(BaseModel):
    """A given gain: K, shape (n, p). Of sensors with periods of their own also by what is read, `camera+gyro`, a sensor
    alone standing for its columns wherever it is read; or a list, the gain of each sample of their common pattern. Of
    sensors that send on change by sensors, or as one matrix."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    K: Annotated[
        Annotated[Rows, Tag("one matrix")]
        | Annotated[dict[str, Rows], Tag("by sensors")]
        | Annotated[tuple[Rows, ...], Field(max_length=MAX_PHASES), Tag("by sample")],
        Discriminator(_kind_of_gain),
        Field(description="A row for each state, a column for each output; by sensors, or sample by sample."),
    ]


class MatrixSet(BaseModel):
    """The set M typed out: matrices of expressions in `delta`. Where an entry is a list, the set holds
    every combination of the listed values."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    matrices: Annotated[tuple[SetMatrix, ...], Field(max_length=1024)] = Field(
        description="Each a list of rows; an entry is an expression in delta, the period, or a list of them."
    )


TypedSet = Annotated[
    Annotated[Literal["clarke"], Tag("the word clarke")] | Annotated[MatrixSet, Tag("typed set")],
    Discriminator(lambda value: "typed set" if isinstance(value, dict | MatrixSet) else "the word clarke"),
]


class Reachability(ConstantGain):
    """`observer: {family: reachability, ..}`."""

    source: ClassVar[str] = "Dinh2014"
    error_source: ClassVar[str] = "Dinh2014, (8), (10)"

    takes_losses: ClassVar[bool] = True
    takes_sensors: ClassVar[bool] = True
    takes_delays: ClassVar[Literal["none", "one", "several"]] = "several"
    takes_on_change: ClassVar[bool] = True
    family: Literal["reachability"] = "reachability"
    objective: Objective = Field(default="given_period", description=OBJECTIVE_WORDS)
    method: Literal["best", "set", "clock"] = Field(
        default="best",
        description="How it is proved: by the set of error maps of the paper (set), by a function of error and time "
        "since the sample (clock), or by whatever reaches further (best).",
    )
    set: TypedSet = Field(
        default="clarke",
        description="The set of error maps: that of the slopes, entry by entry (clarke), or one typed out, of which "
        "it is then proved that it holds every error map.",
    )
    gain: Gain | None = Field(
        default=None, description="The gain, where it is given and only to be analysed; found where left out."
    )

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.reachability.structure import problems

        return [*super().problems(plant, simulation), *problems(self, plant)]

    def resolved(self, plant: Plant, horizon: float | None) -> Self:
        """With the given gain of sensors sample by sample."""
        from cdobs_cli.families.reachability.given_gain import by_sample, of_thresholds

        card = super().resolved(plant, horizon)
        law = plant.sampling
        if card.gain is None or not (law.has_sensors or law.is_on_change):
            return card
        if law.is_on_change:
            return card.model_copy(update={"gain": Gain.model_construct(K=of_thresholds(card.gain.K, plant))})
        return card.model_copy(update={"gain": Gain.model_construct(K=by_sample(card.gain.K, plant))})

    def given(self) -> Mapping[str, ExactMatrix | None]:
        from cdobs_cli.families.reachability.given_gain import side_by_side

        return {self.letter: None if self.gain is None else side_by_side(self.gain.K)}

    def error_maps(self, view: PlantView[Any]) -> ErrorMaps[Any]:
        from cdobs_cli.hybrid import corrected_copy

        return corrected_copy(view)

    def noise_maps(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        from cdobs_cli.hybrid import corrected_copy_noise

        return corrected_copy_noise(view)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.reachability.observer import observer

        return observer(plant, design)

    def methods(self) -> tuple[Known, ...]:
        from cdobs_cli.certify.methods import named

        own = named.Named("set", f"{__name__}.certificate", "ReachableSet")
        planar = named.PLANAR, named.CELLS_OF_GAINS
        without = named.OPEN_LOOP, named.UNCORRECTED, named.EVERY_PERIOD
        return (own, *named.GENERAL, *planar, *without, named.ON_CHANGE)

    def rungs(self, question: Question) -> Sequence[Rung]:
        from cdobs_cli.families.reachability.search_plan import rungs

        return rungs(self, question)

    def gain_searches(self, question: Question) -> Sequence[GainSearch]:
        from cdobs_cli.families.reachability.search_plan import gain_searches

        return gain_searches(self, question)

    def why_nothing(self, question: Question) -> str:
        from cdobs_cli.families.reachability.search_plan import why_nothing

        return why_nothing(self, question)

    def beyond(self, question: Question, own: Sequence[Method]) -> Beyond:
        from cdobs_cli.certify.design import Beyond
        from cdobs_cli.families.reachability.search_plan import beyond

        return Beyond(beyond(self, question, own))

    def claims_beside(self, judgement: Judgement) -> tuple[list[Claim], dict[str, Bound]]:
        from cdobs_cli.families.reachability.beside import claims_beside

        return claims_beside(self, judgement)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        from cdobs_cli.families.reachability.exhibits import exhibits

        return exhibits(self, plant, design, check, run)
