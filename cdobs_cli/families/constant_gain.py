"""Observers with one constant gain: the verbs of a family, from its error system and its methods alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import log
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from cdobs_cli.errors import Problem
from cdobs_cli.families.base import Family
from cdobs_cli.fields import NonNegativeNumber

if TYPE_CHECKING:
    from cdobs_cli.bounds.estimate import Transient
    from cdobs_cli.certificate import Bound, Certificate, Check, Claim
    from cdobs_cli.certify.gains import GainSearch
    from cdobs_cli.certify.judge import Judgement
    from cdobs_cli.certify.methods.base import Method, Question
    from cdobs_cli.certify.methods.rung import Rung
    from cdobs_cli.design import Confinement, Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, NoiseMaps, PlantView
    from cdobs_cli.plant import Box, Plant
    from cdobs_cli.run import SimulationPlan


_PERIODS = 50


class ConstantGain(Family):
    """Subclasses give the error system (`error_maps`, over the gain by its `letter`), the observer's equations,
    the methods, and the ways of finding a gain; `certify.design` and `certify.judge` do the rest.

    letter: the gain's, shape (n, p). error_source: where the error system stands. rate_share: under max_period the
    rate is at least this over the period. with_rates: whether the certificate kept is the fastest that is found.
    """

    objective: Literal["given_period", "max_period", "decay_rate"]
    rate_at_least: NonNegativeNumber | None = None
    letter: ClassVar[str] = "K"
    error_source: ClassVar[str]
    rate_share: ClassVar[float] = 0.0
    with_rates: ClassVar[bool] = False
    bounds_errors: ClassVar[bool] = True

    @abstractmethod
    def error_maps(self, view: PlantView[Any]) -> ErrorMaps[Any]:
        """The error system, which reads the gain by its letter."""

    @abstractmethod
    def noise_maps(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        """How disturbance and noise enter that error."""

    @abstractmethod
    def methods(self) -> tuple[type[Method], ...]:
        """The methods whose certificates its designs may hold."""

    @abstractmethod
    def gain_searches(self, question: Question) -> Sequence[GainSearch]:
        """Ways of finding a gain, the first choice first."""

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        if self.rate_at_least is None or self.objective == "max_period":
            return []
        what = "a rate to be kept belongs to the longest period"
        hint = "objective decay_rate looks for the fastest one"
        return [
            Problem(("observer", "rate_at_least"), what, got=self.objective, allowed="objective: max_period", hint=hint)
        ]

    @property
    def wanted_rate(self) -> Fraction:
        """What the longest period is searched at, per time unit; 0 asks for any rate."""
        rational = None if self.rate_at_least is None else self.rate_at_least.rational
        return rational or Fraction(0)

    def resolved(self, plant: Plant, horizon: float | None) -> Self:
        """Under max_period a rate that is left out is that of an error that falls to 1 % within the horizon, or within
        50 of the typed periods."""
        if self.objective != "max_period" or self.rate_at_least is not None or not plant.sampling.is_bounded:
            return self
        from cdobs_cli.exact.numbers import Exact, decimal_text

        time = horizon if horizon is not None else _PERIODS * float(plant.sampling.T_max)
        return self.model_copy(update={"rate_at_least": Exact(decimal_text(log(100) / time, 4))})

    def rungs(self, question: Question) -> Sequence[Rung]:
        """The lines of the ladder that are asked for a certificate."""
        from cdobs_cli.certify.methods.rung import GENERAL

        return (GENERAL,)

    def refuses(self, plant: Plant) -> str | None:
        """Why no gain is looked for."""
        from cdobs_cli.certify.methods.clock.certificate import too_many_outputs
        from cdobs_cli.certify.reasons import undetectable

        return too_many_outputs(plant) or undetectable(plant)

    def why_nothing(self, question: Question) -> str:
        """Why a search found no gain."""
        return (
            f"no gain with a proof was found at T = {question.law.T_max}; more effort, a shorter period or "
            f"smaller slopes may help"
        )

    def beyond(self, question: Question, own: Sequence[Method]) -> tuple[list[Certificate], dict[str, Any]]:
        """What else a design keeps: certificates of other gains, laws that no gain survives; the report's details."""
        return [], {}

    def claims_beside(self, judgement: Judgement) -> tuple[list[Claim], dict[str, Bound]]:
        """What only this family's paper says of a design."""
        return [], {}

    def question(self, plant: Plant, gain: Mapping[str, ExactMatrix], effort: int) -> Question:
        """The error system of a gain under the plant's law; of a zero gain where none is given."""
        from cdobs_cli.certify.methods.base import Question

        return Question(self.inclusion(plant, gain), effort=effort, card=self)

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        from cdobs_cli.exact.numbers import ExactMatrix
        from cdobs_cli.hybrid import HybridInclusion

        # Without a design: what no gain helps against is seen without one.
        held = gain or {self.letter: ExactMatrix([[0] * plant.p for _ in range(plant.n)])}
        return HybridInclusion(
            self.error_maps, plant, held, plant.sampling, plant.slopes.quantities, self.noise_maps
        )  # fmt: skip

    def given(self) -> Mapping[str, ExactMatrix | None]:
        gain = getattr(self, "gain", None)
        return {self.letter: getattr(gain, self.letter) if gain else None}

    def synthesize(self, plant: Plant, effort: int) -> Design:
        from cdobs_cli.certify.design import synthesize

        return synthesize(self, plant, effort)

    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        from cdobs_cli.certify.judge import judge

        return judge(self, plant, design, effort)

    def transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        from cdobs_cli.certify.judge import levels

        return tuple(level.bounds for level in levels(self, plant, design))

    def noisy_transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        from cdobs_cli.certify.judge import noisy_transients

        return noisy_transients(self, plant, design) if plant.domain else ()

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        """A margin that holds under the declared disturbance and noise comes before one that holds without them, and so
        does a continuation."""
        from cdobs_cli.bounds.estimate import confine

        saturate, noisy = getattr(self, "saturate", False), self.noisy_transients(plant, design)
        within = confine(plant, saturate, noisy, start) if noisy else None
        if within is not None and within.way != "open":
            return within
        return confine(plant, saturate, self.transients(plant, design), start)

    def started(self, plant: Plant, design: Design, start: Box, effort: int) -> Design:
        from cdobs_cli.certify.design import started

        return started(self, plant, design, start, effort)

    def envelope(self, plant: Plant, design: Design, check: Check) -> Mapping[str, Any] | None:
        from cdobs_cli.certify.judge import envelope

        return envelope(self, plant, design)
