"""The bracket of every period as one figure: how far each method proves, and from where it fails."""

from __future__ import annotations

import math
from collections.abc import Mapping

from cdobs_cli.certificate import Bound
from cdobs_cli.records import dataclass
from cdobs_cli.report.numbers import bracket_words, float_or_none


@dataclass(frozen=True)
class Rung:
    """One method: what it proves and what is refuted, as numbers to draw (inf allowed)."""

    label: str
    proved: float | None
    refuted: float | None
    text: str


@dataclass(frozen=True)
class Ladder:
    """A bar chart of brackets on one axis; `name` is its file name."""

    name: str
    title: str
    caption: str
    x_label: str
    rungs: tuple[Rung, ...]


_CAPTION = (
    "Solid: proved. Hatched: refuted from there on, by a counterexample at that period. "
    "Between the two nothing is known."
)


def period_ladder(bounds: Mapping[str, Bound]) -> Ladder | None:
    """The ladder of `period_max`, its methods, `period_max_any_gain` and the bounds that are periods too; None
    where no end of any is known."""
    rungs = []
    for name, label in _labels(bounds).items():
        bound = bounds[name]
        proved, refuted = float_or_none(bound.proved), float_or_none(bound.refuted)
        if proved is not None or (refuted is not None and refuted < math.inf):
            rungs.append(Rung(label, proved, refuted, bracket_words(bound)))
    if not rungs:
        return None
    unit = next((bounds[name].unit for name in _labels(bounds)), "s")
    title, x_label = "What is known of the sampling period", f"sampling period ({unit})"
    return Ladder("periods", title, _CAPTION, x_label, tuple(rungs))


def _labels(bounds: Mapping[str, Bound]) -> dict[str, str]:
    single = {
        "period_max": "this gain", "period_max_any_gain": "any gain", "guaranteed_period": "guaranteed",
        "tau_max": "printed theorem", "positivity_period_max": "positivity",
    }  # fmt: skip
    # Further periods that a family bounds: lmi_15_period_max is the rung "lmi 15".
    others = [name for name in bounds if name.endswith("_period_max") and name not in single]
    single |= {name: name.removesuffix("_period_max").replace("_", " ") for name in others}
    labels = {}
    for name, label in single.items():
        if name in bounds:
            labels[name] = label
        prefix = f"{name}."
        methods = (other for other in bounds if other.startswith(prefix))
        rising = sorted(methods, key=lambda other: _height(bounds[other]))
        labels |= {other: other.removeprefix(prefix).replace("_", " ") for other in rising}
    return labels


def _height(bound: Bound) -> tuple[float, float]:
    """Lowest rung first."""
    proved, refuted = float_or_none(bound.proved), float_or_none(bound.refuted)
    return (0.0 if proved is None else proved, math.inf if refuted is None else refuted)
