"""Observers with one constant gain: the verbs of a family, from its error system and its methods alone."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import log
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field

from cdobs_cli.errors import Problem
from cdobs_cli.families.base import Family
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber

if TYPE_CHECKING:
    from cdobs_cli.bounds.estimate import Transient
    from cdobs_cli.certificate import Bound, Certificate, Check, Claim
    from cdobs_cli.certify.design import Beyond
    from cdobs_cli.certify.gains import GainSearch
    from cdobs_cli.certify.judge import Judgement
    from cdobs_cli.certify.methods.base import Method, Question
    from cdobs_cli.certify.methods.named import Known
    from cdobs_cli.certify.methods.rung import Rung
    from cdobs_cli.design import Confinement, Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, NoiseMaps, PlantView
    from cdobs_cli.plant import Box, Plant
    from cdobs_cli.run import SimulationPlan


Objective = Literal["given_period", "max_period", "decay_rate", "min_error"]
OBJECTIVE_WORDS = (
    "The period as typed (given_period), the longest period (max_period), the fastest decay (decay_rate), or the "
    "least error under noise (min_error)."
)
RATE_WORDS = (
    "Under max_period and min_error: the least rate of decay, 1 / time. Under max_period, where left out, that of "
    "an error that falls to 1 % within the horizon; 0 asks for any."
)
ERROR_WORDS = "state: the largest error that noise and disturbance may leave; every objective but decay_rate keeps it."
WEIGHT_WORDS = (
    "Under min_error, state: how much the square of its error counts, 0 where left out; without weights all "
    "alike, by their scales."
)
_PERIODS = 50
_DECLARE = "declare measurement.noise or plant.disturbance"


class ConstantGain(Family):
    """Subclasses give the error system (`error_maps`, over the gain by its `letter`), the observer's equations,
    the methods, and the ways of finding a gain; `certify.design` and `certify.judge` do the rest.

    letter: the gain's, shape (n, p). error_source: where the error system stands. rate_share: under max_period the
    rate is at least this over the period. with_rates: whether the certificate kept is the fastest that is found.
    """

    objective: Objective
    rate_at_least: NonNegativeNumber | None = Field(default=None, description=RATE_WORDS)
    error_at_most: dict[str, PositiveNumber] | None = Field(default=None, description=ERROR_WORDS)
    weights: dict[str, NonNegativeNumber] | None = Field(default=None, description=WEIGHT_WORDS)
    saturate: bool | Literal["auto"] = Field(
        default="auto",
        description="How the estimate is kept where the slopes hold: true continues phi linearly beyond the domain, "
        "false proves that the estimate stays in it, auto tries the second first.",
    )
    letter: ClassVar[str] = "K"
    error_source: ClassVar[str]
    rate_share: ClassVar[float] = 0.0
    with_rates: ClassVar[bool] = False

    @abstractmethod
    def error_maps(self, view: PlantView[Any]) -> ErrorMaps[Any]:
        """The error system, which reads the gain by its letter."""

    @abstractmethod
    def noise_maps(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        """How disturbance and noise enter that error."""

    def late_maps(self, view: PlantView[Any]) -> tuple[ErrorMaps[Any], NoiseMaps[Any]]:
        """Both, over states of which a sample that has not arrived yet changes none."""
        return self.error_maps(view), self.noise_maps(view)

    @abstractmethod
    def methods(self) -> tuple[Known, ...]:
        """The methods whose certificates its designs may hold."""

    @abstractmethod
    def gain_searches(self, question: Question) -> Sequence[GainSearch]:
        """Ways of finding a gain, the first choice first."""

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        return [*self._problems_of_rate(), *self._problems_of_errors(plant)]

    def _problems_of_rate(self) -> Iterator[Problem]:
        if self.rate_at_least is None or self.objective in ("max_period", "min_error"):
            return
        what = "a rate to be kept belongs to the longest period, or to the least error"
        allowed, hint = "objective: max_period, or min_error", "objective decay_rate looks for the fastest one"
        yield Problem(("observer", "rate_at_least"), what, got=self.objective, allowed=allowed, hint=hint)

    def _problems_of_errors(self, plant: Plant) -> Iterator[Problem]:
        declared = plant.is_perturbed or plant.sampling.is_on_change
        if self.objective == "min_error" and not declared:
            yield Problem(("observer", "objective"), "least error needs noise or a disturbance", hint=_DECLARE)
        for name, typed in (("error_at_most", self.error_at_most), ("weights", self.weights)):
            if typed is None:
                continue
            at = ("observer", name)
            for state in typed:
                if state not in plant.states:
                    yield Problem((*at, state), "is no state", state, ", ".join(plant.states))
            if not declared:
                yield Problem(at, "an error under noise needs noise or a disturbance", hint=_DECLARE)
        if self.error_at_most is not None and self.objective == "decay_rate":
            what, allowed = "an error to be kept does not go with the fastest rate", "another objective"
            yield Problem(("observer", "error_at_most"), what, got=self.objective, allowed=allowed)
        if self.error_at_most is not None and plant.delays:
            what = "the error that is kept in a search is that of an estimate without delays"
            hint = "say it in `expect`: bounds.error.<state>, which counts them"
            yield Problem(("observer", "error_at_most"), what, hint=hint)
        if self.error_at_most is not None and getattr(self, "gain", None) is not None:
            what, hint = "an error to be kept belongs to a search for a gain", "of a given gain say it in `expect`"
            yield Problem(("observer", "error_at_most"), what, hint=hint)
        if self.weights is not None and self.weights and all(one.sign() == 0 for one in self.weights.values()):
            yield Problem(("observer", "weights"), "one weight at least is positive")

    @property
    def wanted_rate(self) -> Fraction:
        """What the longest period is searched at, per time unit; 0 asks for any rate."""
        rational = None if self.rate_at_least is None else self.rate_at_least.rational
        return rational or Fraction(0)

    def resolved(self, plant: Plant, horizon: float | None) -> Self:
        """Under max_period a rate that is left out is that of an error that falls to 1 % within the horizon, or within
        50 of the typed periods."""
        law = plant.sampling
        known = law.is_bounded or law.has_sensors
        if self.objective != "max_period" or self.rate_at_least is not None or not known:
            return self
        from cdobs_cli.exact.numbers import Exact, decimal_text

        time = horizon if horizon is not None else _PERIODS * float(law.period if law.has_sensors else law.T_max)
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
            f"no gain with a proof was found at T = {question.law.period}; more effort, a shorter period or "
            f"smaller slopes may help"
        )

    def beyond(self, question: Question, own: Sequence[Method]) -> Beyond:
        """What else a design keeps."""
        from cdobs_cli.certify.design import Beyond

        return Beyond()

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
        rows, columns = plant.gain_shape
        held = gain or {self.letter: ExactMatrix([[0] * columns for _ in range(rows)])}
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
        from cdobs_cli.certify.judge import transients

        return transients(self, plant, design)

    def noisy_transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        from cdobs_cli.certify.judge import noisy_transients

        return noisy_transients(self, plant, design)

    def finished(self, plant: Plant, design: Design, effort: int) -> Design:
        from cdobs_cli.certify.design import finished

        return finished(self, plant, design, effort)

    def bounds_from(self, plant: Plant, design: Design, start: Box, effort: int) -> Sequence[Certificate]:
        from cdobs_cli.certify.accuracy import from_start

        question = self.question(replace(plant, sampling=design.sampling), design.gain, effort)
        return tuple(one.method.certificate() for one in from_start(question.started(start)))

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        """A margin that holds under the declared disturbance and noise comes before one that holds without them, and so
        does a continuation."""
        from cdobs_cli.bounds.estimate import confine

        noisy = self.noisy_transients(plant, design)
        within = confine(plant, self.saturate, noisy, start) if noisy else None
        if within is not None and within.way != "open":
            return within
        return confine(plant, self.saturate, self.transients(plant, design), start)
