"""The verdict in plain words: what the estimate does, up to which period, how large its error stays, and what that
takes for granted. Numbers are shortened to their safe side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import Decimal

from cdobs_cli.certificate import ERROR_BOUNDED, Bound
from cdobs_cli.delays import arrival_words
from cdobs_cli.labels import SECONDS
from cdobs_cli.report.model import Report
from cdobs_cli.report.numbers import end_text, ends_text, float_or_none
from cdobs_cli.sampling import SamplingLaw

_SETTLED = 100.0  # an error that has fallen to a hundredth counts as gone
_STATES = 4  # whose errors a sentence tells
_DIGITS = 4
# Of the headline's bounds those whose period is that of the sampling law.
_PERIODS = ("period_max", "period_max_any_gain", "guaranteed_period")


def words(report: Report) -> tuple[str, ...]:
    """Sentences, the most important one first."""
    told = (_convergence(report), _reach(report), _accuracy(report), *_assumed(report))
    return tuple(sentence for sentence in told if sentence)


def is_expected(report: Report) -> bool:
    """Whether a verdict other than proved is what the spec expects."""
    met = [holds for what, holds, _ in report.expectations if what.split(" ")[0].strip("`") == "verdict"]
    return report.verdict not in ("proved", "not checked") and bool(met) and all(met)


def verdict_text(report: Report) -> str:
    """`proved`, `refuted, as expected`."""
    return f"{report.verdict}, as expected" if is_expected(report) else report.verdict


def _convergence(report: Report) -> str:
    """Whether the estimate converges, or encloses the state."""
    law = report.design.sampling
    if report.design.outcome == "none":
        reason = " ".join((report.design.reason or "the search gave no reason").split()).rstrip(".")
        told = f"No observer was found: {reason}."
        return told if report.verdict != "refuted" else f"{told} That none can help is proved."
    if report.check is None:
        return "The design has not been checked."
    encloses = report.family.name == "interval"
    does, cannot = f"The estimate converges{_settling(report)}", "The estimate does not converge"
    if encloses:
        does, cannot = "The bounds enclose the state and stay bounded", "The bounds do not enclose the state for ever"
    if law.is_on_change:
        does = f"The error falls to what the thresholds allow, and stays there{_settling(report)},"
    if report.verdict == "proved":
        return f"{does}{_in_the_mean(law)} {_sampled(report)}{_whose(report)}."
    if report.verdict == "refuted":
        return f"{cannot} {_sampled(report)}: {_failure(report)}."
    what = "the bounds enclose the state" if encloses else "the estimate converges"
    missing = [claim.id for claim in report.check.claims if claim.required and claim.status == "undecided"]
    why = f" ({', '.join(missing)} open)" if missing and "convergence" not in missing else ""
    return f"It is not known whether {what} {_sampled(report)}: nothing was proved and nothing refuted{why}."


def _failure(report: Report) -> str:
    """How it fails."""
    claim = report.convergence
    assert report.check is not None
    lost = claim if claim is not None and claim.status == "refuted" else None
    lost = lost or next((one for one in report.check.claims if one.required and one.status == "refuted"), None)
    if lost is None or lost.witness is None:
        return f"`{lost.id}` is refuted" if lost is not None else "a claim is refuted"
    whose = {
        "class": "some plant with these slopes defeats it (the typed one may still converge)",
        "plant": "the plant as typed defeats it",
    }
    how = whose.get(lost.witness.about or "", "a counterexample was found")
    replayed = lost.witness.kind in ("constant", "switching", "vector") and "probability" not in lost.witness.data
    return f"{how}{'; replay it with cdobs simulate --witness' if replayed else ''}"


def _whose(report: Report) -> str:
    """Whether it holds of all plants with some slopes, which a known one is one of."""
    return ", for every plant with these slopes" if report.plant.slopes.uncertain else ""


def _in_the_mean(law: SamplingLaw) -> str:
    return " in mean square, and almost surely," if law.is_random else ""


def _sampled(report: Report) -> str:
    """`if samples come every 20 ms`, `.., where they arrive 35 ms later`."""
    unit = report.labels.time
    late = arrival_words(report.plant.delays, unit)
    return f"{_when(report.design.sampling, unit)}{late and f', where {late}'}"


def _when(law: SamplingLaw, unit: str) -> str:
    if law.is_on_change:
        return f"if sensors send {law.text(unit)}"
    if law.is_updated:
        return "at the samples that the observer asks for"
    if law.has_sensors:
        return f"with the sensors read as declared ({law.text(unit)})"
    if law.is_periodic and law.period.rational is not None:
        return f"if samples come every {duration(str(law.period), unit)}"
    return f"if samples come {law.text(unit)}"


def _settling(report: Report) -> str:
    """How long an error takes to fall to a hundredth, at most."""
    envelope = report.check.envelope if report.check is not None else {}
    factor, rate = float_or_none(envelope.get("factor")), float_or_none(envelope.get("rate"))
    if factor is None or rate is None or not rate > 0 or not math.isfinite(factor):
        return ""
    noisy = ", apart from what noise and disturbance add" if report.plant.is_perturbed else ""
    if math.isinf(rate):
        return ""
    time = math.log(_SETTLED * max(factor, 1.0)) / rate
    return f" (to 1 % within {duration(repr(time), report.labels.time, digits=2)}{noisy})"


def _reach(report: Report) -> str:
    """Up to which period it is proved, and from which on it fails."""
    headline, law = report.headline_bound, report.design.sampling
    if headline is None or report.check is None or report.design.outcome == "none":
        return ""
    name, bound = headline
    if name not in _PERIODS or law.is_updated != (name == "guaranteed_period"):
        return ""
    unit, (proved, refuted) = bound.unit, ends_text(bound)
    known = law.is_periodic or law.is_lossy or law.is_random
    which = "The longest period proved is" if known else "The longest time between samples proved is"
    if law.has_sensors:
        which = "With all periods in proportion, the shortest of them is proved up to"
    if bound.proved is None:
        told = f"No period is proved; from {duration(refuted, unit)} on {_fails(report, name, bound)}"
        return f"{told}." if bound.refuted is not None else ""
    if proved == "∞":
        return "No period is too long: the error decays by itself between samples."
    reach = f"{which} {duration(proved, unit)}"
    if name == "guaranteed_period":
        return f"At least {duration(proved, unit)} pass from one sample to the next."
    if bound.refuted is None:
        return f"{reach}; none is known for which it fails."
    return f"{reach}; at {duration(refuted, unit)} {_fails(report, name, bound)}."


def _fails(report: Report, name: str, bound: Bound) -> str:
    if name == "period_max_any_gain":
        return "every gain fails"
    replayed = name == "period_max" and report.design.counterexample(bound.refuted) is not None
    return f"it fails{' (a counterexample can be replayed)' if replayed else ''}"


def _accuracy(report: Report) -> str:
    """How large errors stay."""
    if report.check is None:
        return ""
    bounds, told = report.check.bounds, list[str]()
    for head, sign in (("error", "±"), ("rms", "")):
        named = [(name, bounds.get(f"{head}.{name}")) for name in report.plant.states]
        known = [(name, bound) for name, bound in named if bound is not None and bound.proved is not None]
        if not known or (head == "rms" and told):
            continue
        parts = [f"{name} {sign}{_size(bound)}" for name, bound in known[:_STATES]]
        more = f" (and {len(known) - _STATES} more)" if len(known) > _STATES else ""
        what = "is known in the long run to" if head == "error" else "has in the long run a root mean square error of"
        told.append(f"the state {what} {', '.join(parts)}{more}")
    under = " and ".join(
        one for one, there in (("noise", report.plant.is_noisy), ("disturbance", report.plant.is_disturbed)) if there
    )
    if told:
        return f"With the declared {under} {told[0]}." if under else f"{told[0][0].upper()}{told[0][1:]}."
    open_ = report.check.claim(ERROR_BOUNDED)
    if under and open_ is not None and open_.status == "undecided":
        return f"How large the error stays under the declared {under} is not known."
    return ""


def _size(bound: Bound) -> str:
    unit = "" if bound.unit in ("", "1") else f" {bound.unit}"
    return f"{end_text(bound.proved, 3, up=True)}{unit}"


def _assumed(report: Report) -> Iterator[str]:
    """What the verdict takes for granted."""
    if report.design.outcome == "none":
        return
    yield from (condition if condition.endswith(".") else f"{condition}." for condition in report.conditions)


def duration(text: str, unit: str, digits: int | None = None) -> str:
    """A time in a unit that suits it, where it is in seconds: `20 ms`, `35 min`. Rounded up to so many digits, where
    any are given; ends of a bracket have been rounded to their own side."""
    value = float_or_none(text)
    if value is None or unit != SECONDS or not math.isfinite(value) or value == 0:
        return f"{_short(text, digits)} {unit}"
    for name, size, least in (("h", "3600", 7200), ("min", "60", 300), ("s", "1", 0.1), ("ms", "0.001", 1e-4)):
        if value >= least:
            scaled = format(Decimal(text) / Decimal(size), "f")
            if name in ("s", "ms") or len(scaled.rstrip("0")) <= 8:
                return f"{_short(scaled, digits)} {name}"
    return f"{_short(format(Decimal(text) * 10**6, 'f'), digits)} µs"


def _short(text: str, digits: int | None) -> str:
    value = float_or_none(text)
    if value is None:
        return text
    if digits is not None or not math.isfinite(value):
        return end_text(text, digits or _DIGITS, up=True)
    return text.rstrip("0").rstrip(".") if "." in text else text
