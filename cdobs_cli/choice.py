"""The family that does best: each that takes plant and law is tried at effort 0, the best is designed.

No clock decides: a family is left untried where its matrices at all corners of the slopes are too many, so equal specs
give equal choices.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from statistics import geometric_mean
from typing import Any

from cdobs_cli.certificate import Bound, Check
from cdobs_cli.design import CHOICE, Design
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass
from cdobs_cli.spec.model import Spec
from cdobs_cli.synthesis import certify, new_design

MAX_SIZE = 2**14  # entries of the flow matrices at all corners of the slopes
_PERIODS = ("period_max", "guaranteed_period", "positivity_period_max")


@dataclass(frozen=True)
class Trial:
    """What a family did at effort 0; verdict None where it was not tried. error: the geometric mean over the states of
    what is proved of the error under the declared noise and disturbance."""

    family: str
    outcome: str
    verdict: str | None = None
    period: str | None = None
    rate: str | None = None
    reason: str | None = None
    error: float | None = None

    @property
    def proved(self) -> bool:
        return self.verdict == "proved"

    def merit(self, objective: str) -> tuple[bool, bool, bool, float, float]:
        """A larger one is better: proved first, then any design, then the objective, then the other figure."""
        period, rate = (-1.0 if text is None else _number(text) for text in (self.period, self.rate))
        figures = (period, rate) if objective == "max_period" or not self.proved else (rate, period)
        if self.error is not None and self.by_error(objective):
            figures = (-self.error, rate)
        return (self.proved, self.outcome != "none", self.by_error(objective), *figures)

    def by_error(self, objective: str) -> bool:
        """Whether its error is what counts."""
        return self.proved and self.error is not None and objective in ("given_period", "min_error")


def chosen_design(spec: Spec, effort: int) -> tuple[Spec, Design]:
    """The spec with the family that does best by the objective, and its design, with the table of all in `details`."""
    assert spec.choice is not None
    made = {name: _trial(spec.chosen(name)) for name in spec.choice.cards}
    trials = [trial for trial, _ in made.values()]
    objective = spec.choice.block.objective or str(getattr(spec.observer, "objective", ""))
    best = max(trials, key=lambda trial: trial.merit(objective))
    chosen, tried = spec.chosen(best.family), made[best.family][1]
    design = tried if effort == 0 and tried is not None else new_design(chosen, effort)
    rows = [_row(trial, best, objective, alone=len(trials) == 1) for trial in trials]
    rows += [_entry(Trial(name, "not taken"), why) for name, why in spec.choice.refused.items()]
    return chosen, replace(design, details={**design.details, CHOICE: rows})


def _trial(spec: Spec) -> tuple[Trial, Design | None]:
    """Of the spec's family; untried where it is the only one, or too large."""
    name = spec.observer.name
    assert spec.choice is not None
    if len(spec.choice.cards) == 1:
        return Trial(name, "untried"), None
    if size(spec) > MAX_SIZE:
        return Trial(name, "untried", reason=f"too large to be tried ({size(spec)} numbers, at most {MAX_SIZE})"), None
    design = new_design(spec, 0)
    check = certify(spec, design, 0)
    return Trial(name, design.outcome, check.verdict, _period(design, check), _proved(check, "decay_rate"),
                 design.reason, _mean_error(spec, check)), design  # fmt: skip


def _mean_error(spec: Spec, check: Check) -> float | None:
    names = [(f"error.{state}", f"rms.{state}") for state in spec.plant.states]
    proved = [next((one for one in map(partial(_proved, check), pair) if one is not None), None) for pair in names]
    sizes = [_number(one) for one in proved if one is not None]
    return geometric_mean(sizes) if len(sizes) == spec.plant.n else None


def size(spec: Spec) -> int:
    """Entries of the flow matrices at all corners of the slopes."""
    return int(spec.plant.n**2 * 2 ** min(len(spec.plant.slopes.uncertain), 64))


def _period(design: Design, check: Check) -> str | None:
    """The longest period proved: the law's own, or a bound beyond it."""
    own = str(design.sampling.period) if check.verdict == "proved" and design.sampling.is_bounded else None
    bounds = [_proved(check, name) for name in _PERIODS]
    return max((text for text in (own, *bounds) if text is not None), key=_number, default=None)


def _proved(check: Check, name: str) -> str | None:
    bound = check.bounds.get(name, Bound())
    return bound.proved if bound.proved is not None and _number(bound.proved) > 0 else None


def _number(text: str) -> float:
    return float(text) if text.endswith("inf") else float(Exact(text))


def _row(trial: Trial, best: Trial, objective: str, *, alone: bool) -> dict[str, Any]:
    return _entry(trial, _why(trial, best, objective, alone=alone))


def _why(trial: Trial, best: Trial, objective: str, *, alone: bool) -> str:
    """In a line."""
    by_error = best.by_error(objective)
    by_rate = not by_error and objective != "max_period" and best.proved and best.rate is not None
    what = "the least error" if by_error else "the largest decay rate" if by_rate else "the longest period"
    if trial is best:
        if alone:
            return "chosen: the only family that takes plant and law"
        if trial.verdict is None:
            return "chosen: the first of those that are too large to be tried"
        if trial.outcome == "none":
            return f"chosen: no family found a design; {trial.reason}"
        return f"chosen: proved, with {what}" if trial.proved else f"chosen: not proved, {what} of all"
    if trial.verdict is None or trial.outcome == "none":
        return trial.reason or "no design"
    if not trial.proved:
        return f"{trial.verdict} at effort 0"
    if by_error:
        return "proved, with larger errors" if trial.error is not None else "proved, and its error is not"
    return "proved, with a smaller decay rate" if by_rate and trial.rate != best.rate else "proved, and no better"


def _entry(trial: Trial, why: str) -> dict[str, Any]:
    return {
        "family": trial.family, "outcome": trial.outcome, "verdict": trial.verdict, "period": trial.period,
        "rate": trial.rate, "why": why,
    }  # fmt: skip
