"""A family that the tool does not know: a copy of the model corrected at samples, with the clock certificate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict

from cdobs_cli.certify.gains import GainSearch
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
from cdobs_cli.certify.methods.named import Known
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.constant_gain import ConstantGain
from cdobs_cli.fields import Rows
from cdobs_cli.hybrid import ErrorMaps, NoiseMaps, Observer, PlantView, corrected_copy, corrected_copy_noise
from cdobs_cli.plant import Plant


class Gain(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    K: Rows


class Copy(ConstantGain):
    """`observer: {family: copy}`."""

    source: ClassVar[str] = "Dinh2014"
    error_source: ClassVar[str] = "a copy of the model, corrected at samples"

    family: Literal["copy"] = "copy"
    objective: Literal["given_period", "max_period", "decay_rate"] = "given_period"
    gain: Gain | None = None

    def methods(self) -> tuple[Known, ...]:
        return GENERAL.methods

    def gain_searches(self, question: Question) -> Sequence[GainSearch]:
        return (ImpulsiveGain(),)

    def error_maps(self, view: PlantView[Any]) -> ErrorMaps[Any]:
        return corrected_copy(view)

    def noise_maps(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        return corrected_copy_noise(view)

    def observer(self, plant: Plant, design: Design) -> Observer:
        K: ExactMatrix = design.gain["K"]
        hat = tuple(f"hat.{name}" for name in plant.states)
        residuals = [Variable(f"y.{k}") - row for k, row in enumerate(plant.outputs("hat."))]
        corrections: list[Expression] = [ZERO] * plant.n
        for i in range(plant.n):
            for k, residual in enumerate(residuals):
                corrections[i] = corrections[i] + K[i, k].expression * residual
        return Observer(
            states=hat,
            start=tuple(Variable(f"initial.{name}") for name in plant.states),
            flow=plant.right_hand_side("hat."),
            jump=tuple(Variable(name) + change for name, change in zip(hat, corrections, strict=True)),
            estimates={"x_hat": tuple(Variable(name) for name in hat)},
        )
