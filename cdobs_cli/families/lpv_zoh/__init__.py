"""The card of the family `lpv_zoh`: LPV observers with held innovation (Boukal2020).

    x_hat' = A x_hat + phi(x_hat, u) + B u + L r,    r held: r = y(t_k) - C x_hat(t_k) from t_k to t_(k+1)

Notation: tau_max the largest period, A_i = A + V at a corner of the slope box, F_i = A_i - L C,
w = C (e - e(t_k)), P and U Lyapunov and Wirtinger matrices, Y = P L, sigma the decay rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from cdobs_cli.errors import Problem
from cdobs_cli.families.base import Family
from cdobs_cli.fields import Rows

if TYPE_CHECKING:
    from cdobs_cli.bounds.estimate import Transient
    from cdobs_cli.certificate import Check
    from cdobs_cli.chart import Exhibits
    from cdobs_cli.design import Confinement, Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import HybridInclusion, Observer
    from cdobs_cli.plant import Box, Plant
    from cdobs_cli.run import Run, SimulationPlan


class Gain(BaseModel):
    """A given gain: L, shape (n, p)."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    L: Rows


class PrintedData(BaseModel):
    """(P, Y) of Theorem 1 as printed somewhere, shapes (n, n) and (n, 1), to be put to the test; `vertices`
    the printed A_i, where they are not the corners of the declared slopes."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    P: Rows
    Y: Rows
    vertices: Annotated[tuple[Rows, ...], Field(min_length=1, max_length=256)] | None = None


class LpvZeroOrderHold(Family):
    """`observer: {family: lpv_zoh, ..}`."""

    source: ClassVar[str] = "Boukal2020"

    family: Literal["lpv_zoh"] = "lpv_zoh"
    objective: Literal["given_period", "max_period", "decay_rate"] = "given_period"
    method: Literal["best", "clock", "wirtinger", "repaired", "theorem_1"] = "best"
    saturate: bool | Literal["auto"] = "auto"
    gain: Gain | None = None
    printed: PrintedData | None = None

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        from cdobs_cli.families.lpv_zoh.structure import problems

        return problems(self, plant)

    def given(self) -> Mapping[str, ExactMatrix | None]:
        return {"L": self.gain.L if self.gain else None}

    def synthesize(self, plant: Plant, effort: int) -> Design:
        from cdobs_cli.families.lpv_zoh.synthesis import synthesize

        return synthesize(self, plant, effort)

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        from cdobs_cli.families.lpv_zoh.claims import certify

        return certify(self, plant, design, effort)

    def observer(self, plant: Plant, design: Design) -> Observer:
        from cdobs_cli.families.lpv_zoh.observer import observer

        return observer(plant, design)

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        from cdobs_cli.exact.numbers import ExactMatrix
        from cdobs_cli.families.lpv_zoh.observer import inclusion

        # Without a design: what no gain helps against is seen without one.
        return inclusion(plant, gain or {"L": ExactMatrix([[0] * plant.p for _ in range(plant.n)])})

    def transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        from cdobs_cli.families.lpv_zoh.levels import levels

        return tuple(level.bounds for level in levels(plant, design))

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        from cdobs_cli.bounds.estimate import confine

        return confine(plant, self.saturate, self.transients(plant, design), start)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        from cdobs_cli.families.lpv_zoh.exhibits import exhibits

        return exhibits(self, plant, design, check, run)

    def envelope(self, plant: Plant, design: Design, check: Check) -> Mapping[str, Any] | None:
        from cdobs_cli.families.lpv_zoh.envelope import envelope

        return envelope(plant, design, check)
