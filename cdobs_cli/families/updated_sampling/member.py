"""The simplest member of the class: f = 0 with c = 0, where L stays 1 and samples come every alpha."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling


def error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """edot = A e, e+ = (I + alpha K C) e, for e = x_hat - x.

    Source: Andrieu2014, (10), (12)
    """
    unit = [view.unit(i) for i in range(view.A.shape[0])]
    identity = unit[0] @ unit[0].T
    for column in unit[1:]:
        identity = identity + column @ column.T
    jump = identity + view.gain["K"] @ view.gain["alpha"] @ view.C
    return ErrorMaps(view.A, (), (), (), jump)


def free_member(plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
    """The error of the member f = 0, c = 0 as an inclusion without uncertain slopes."""
    zero = ExactMatrix([[0] * plant.n] * plant.n)
    law = SamplingLaw.periodic(gain["alpha"][0, 0])
    return HybridInclusion(error_maps, replace(plant, slopes=Slopes(zero, zero), sampling=law), gain, law, ())


def asked(family: UpdatedSampling, plant: Plant, gain: Mapping[str, ExactMatrix], effort: int) -> Question:
    """What the theorems are asked: the plant, the gain, and the law by which the observer chooses its instants."""
    return Question(HybridInclusion(error_maps, plant, gain, plant.sampling, ()), effort=effort, card=family)
