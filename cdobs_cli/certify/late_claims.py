"""What is said of a design whose measurements arrive late: claims and bounds of the estimate at the present, made of
those of an observer without delays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from flint import arb

from cdobs_cli.certificate import Bound, Claim, Status
from cdobs_cli.certify import accuracy
from cdobs_cli.certify.late import Late, LateMaps, NoBoundError, Norm, late_error
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.delays import arrival_words, longest
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass

SOURCE = "cdobs, late measurements"
_HOW = "balls, every word of samples that are missing"
_KINDS: tuple[tuple[str, Norm], ...] = (("error", "size"), ("error_transient", "size"), ("rms", "mean square"))


@dataclass(frozen=True)
class Sized:
    """Bounds of an estimate without delays, and from which errors those hold that hold for all time."""

    bounds: Mapping[str, Bound]
    start: tuple[arb, ...] | None


def starts(items: Iterable[accuracy.Item], n: int) -> tuple[arb, ...] | None:
    """The largest errors before the first sample that stored bounds for all time begin from."""
    listed = [start for item in items if (start := getattr(item.method, "start", None)) is not None]
    if not listed or any(len(start) != n for start in listed):
        return None
    boxes = [Box(tuple(Exact(low) for low, _ in one), tuple(Exact(high) for _, high in one)) for one in listed]
    sizes = zip(*(box.sizes for box in boxes), strict=True)
    return tuple(max((arb(one).upper() for one in column), key=float) for column in sizes)


def late_accuracy(
    question: Question, maps: LateMaps, claims: Sequence[Claim], sized: Sized
) -> tuple[list[Claim], dict[str, Bound]]:
    """Claims and bounds of `accuracy` made those of the estimate at the present."""
    plant, bounds = question.plant, dict[str, Bound]()
    reasons: dict[str, str] = {}
    for kind, norm in _KINDS:
        names = [f"{kind}.{state}" for state in plant.states]
        free = [one.proved for name in names if (one := sized.bounds.get(name)) is not None]
        before = [Exact(one).ball() for one in free if one not in (None, "inf")]
        if not before:
            continue
        try:
            if len(before) < plant.n:
                raise NoBoundError("not every state has a bound without delay")
            if kind == "error_transient":
                if sized.start is None:
                    raise NoBoundError("it is not known from which errors the bound without delay holds")
                before = [one.max(first) for one, first in zip(before, sized.start, strict=True)]
            found = late_error(question.inclusion, maps, norm).errors(before)
        except NoBoundError as error:
            reasons |= dict.fromkeys(names, str(error))
            continue
        for name, error_now in zip(names, found, strict=True):
            refuted = sized.bounds[name].refuted if _may_be_at_once(plant) else None
            bounds[name] = replace(sized.bounds[name], proved=upper_text(error_now, accuracy.DIGITS), refuted=refuted)
    bounds |= accuracy.total(plant, bounds)
    told = [_of_now(claim, plant, sized.bounds, bounds, reasons) for claim in claims]
    conclusion = accuracy.error_bounded(question, bounds)
    why = next(iter(reasons.values()), None)
    if conclusion.status != "proved" and why is not None:
        conclusion = replace(conclusion, statement=f"{conclusion.statement.removesuffix('.')}: {why}.")
    conclusion = replace(conclusion, statement=_at_present(conclusion.statement, plant))
    return [conclusion, *(claim for claim in told if claim is not None)], bounds


def _may_be_at_once(plant: Plant) -> bool:
    """Whether every sample may arrive when it is taken: what an estimate without delays attains is attained then."""
    return all(one.lower.sign() == 0 for one in plant.delays)


def _at_present(statement: str, plant: Plant) -> str:
    return f"{statement.removesuffix('.')}, at the present: {arrival_words(plant.delays)}."


def _of_now(
    claim: Claim, plant: Plant, free: Mapping[str, Bound], bounds: Mapping[str, Bound], reasons: Mapping[str, str]
) -> Claim | None:
    """A claim about an estimate without delays as one of the present estimate; None where there is none such."""
    if claim.id.endswith(".reached"):
        return claim if _may_be_at_once(plant) else None
    if claim.id in bounds and claim.id in free:
        before, now = f"<= {free[claim.id].proved}", f"<= {bounds[claim.id].proved}"
        statement = _at_present(claim.statement.replace(before, now, 1), plant)
        statement = f"{statement.removesuffix('.')} ({before} without delay)."
        return replace(claim, statement=statement, source=f"{claim.source}; {SOURCE}", method=_HOW)
    if claim.id not in free or claim.status != "proved":
        return claim if claim.id not in free else replace(claim, status="undecided")
    why = reasons.get(claim.id, "a bound over time is not carried over")
    statement = f"{claim.statement.removesuffix('.')} without delay; of the estimate at the present, {why}."
    return replace(claim, status="undecided", statement=statement)


@dataclass(frozen=True)
class Growth:
    """How an estimate decays while samples are under way: factor and rate of |e(t)| <= factor |e(0)| exp(-rate t),
    where one without delay is known, and g with |e(t)| <= g |e| before what is missing; or why neither is known."""

    g: arb | None
    envelope: Mapping[str, str]
    reason: str = ""


def growth(question: Question, maps: LateMaps, envelope: Mapping[str, str]) -> Growth:
    """Of a gain, from its envelope without delay: the rate stays, over the delay the factor grows by g exp(rate D)."""
    plant = question.plant
    late = late_error(question.inclusion, maps)
    try:
        g = late.growth
    except NoBoundError as error:
        return Growth(None, {}, str(error))
    if not envelope:
        return Growth(g, {})
    D = longest(plant.delays).ball()
    if late.n < late.N:  # what is held is of the sample before
        D = D + question.law.T_max.ball()
    factor, rate = (Exact(envelope[name]).ball() for name in ("factor", "rate"))
    factor = factor.max(arb(1))  # until the first sample is there the error is what it was before it
    factor = (factor * g * (rate * D).exp()).upper()
    if not factor.is_finite():
        return Growth(g, {})
    return Growth(g, {"factor": upper_text(factor, 6), "rate": lower_text(rate, 9)})


def late_claim(question: Question, found: Growth, free: Mapping[str, str]) -> Claim:
    """`late`: how the error at the present decays."""
    head = f"At the present, where {arrival_words(question.plant.delays)}, "
    status: Status = "proved"
    if found.g is None:
        status = "undecided"
        told = f"it is not shown how far the error is from that without delay: {found.reason}"
    elif found.envelope:
        factor, rate = found.envelope["factor"], found.envelope["rate"]
        decays = "" if rate == "0" else f"exp(-{rate} t) "
        told = f"|e(t)| <= {factor} {decays}|e(0)|; without delay the factor is {free['factor']}, the rate the same"
    else:
        told = f"|e(t)| <= {upper_text(found.g, 6)} |e(s)|, s the first stamp of which a sample is missing"
    return Claim("late", "certificate", status, f"{head}{told}.", SOURCE, method=_HOW)


def delay_max() -> Bound:
    """No delay is too long for what is computed again from the stamp on."""
    about = "computed again from the stamp on, gain and rate are those without delay"
    return Bound("inf", None, "s", "recompute", about)


def late_transients(
    question: Question, maps: LateMaps, free: Sequence[Callable[[Box], tuple[arb, ...]]], *, quiet: bool
) -> list[Callable[[Box], tuple[arb, ...]]]:
    """How large an error becomes on the way, at the present, from that without delay; quiet: without disturbance and
    noise."""
    late: Late = late_error(question.inclusion, maps)
    if quiet:
        late = late.quiet

    def of(transient: Callable[[Box], tuple[arb, ...]]) -> Callable[[Box], tuple[arb, ...]]:
        def bounds(start: Box) -> tuple[arb, ...]:
            pairs: Any = zip(transient(start), start.sizes, strict=True)
            try:
                return late.errors([bound.max(arb(first).upper()) for bound, first in pairs])
            except NoBoundError:
                return (arb.pos_inf(),) * question.plant.n

        return bounds

    return [of(transient) for transient in free]
