"""The verdict, once for every family with a constant gain: stored certificates, proved again, become claims; the
ladder of methods, the bracket of the period, and the one conclusion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from flint import arb

from cdobs_cli.certificate import CONVERGENCE, Bound, Check, Claim, Status, Witness
from cdobs_cli.certify import accuracy
from cdobs_cli.certify.falsify import every_gain_fails_from, refute, slowest_decay
from cdobs_cli.certify.linear import is_linear, stable_intervals
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.dead_beat import DeadBeat, resets
from cdobs_cli.certify.stored import Judged, Reader, judged
from cdobs_cli.certify.unseen import Unseen, unseen
from cdobs_cli.delays import put_in_words
from cdobs_cli.design import Design
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text, lower_text, text_below, upper_text
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.certify.late import LateMaps
    from cdobs_cli.certify.levels import Level

_UNSEEN = "unseen direction"
_UNCORRECTED = "growth without samples"


class Card(Reader, Protocol):
    """What is asked of a family's card."""

    error_source: ClassVar[str]

    @property
    def late_maps(self) -> LateMaps:
        """Error and noise over states of which a sample that has not arrived yet changes none."""

    @property
    def wanted_rate(self) -> Fraction:
        """What the longest period is searched at, per time unit; 0 asks for any rate."""

    def question(self, plant: Plant, gain: Mapping[str, ExactMatrix], effort: int) -> Question:
        """The error system of a gain under the plant's law; of a zero gain where none is given."""

    def claims_beside(self, judged: Judgement) -> tuple[list[Claim], dict[str, Bound]]:
        """What only this family's paper says of a design."""


@dataclass(frozen=True)
class Judgement:
    """A design on its way to its claims: the question about its gain under its law, and its certificates judged."""

    card: Card
    design: Design
    question: Question
    items: tuple[Judged, ...]

    @property
    def law(self) -> SamplingLaw:
        return self.design.sampling

    @property
    def plant(self) -> Plant:
        return self.question.plant

    @property
    def here(self) -> list[Judged]:
        """Of the design's gain and its very law, of each claim the best proved first."""
        own = [item for item in self.converging if item.own and item.method.law == self.law]
        return sorted(own, key=lambda item: (not item.proof.holds, -float(item.proof.rate.lower())))

    @property
    def converging(self) -> list[Judged]:
        return [item for item in self.items if item.method.reach == "convergence"]

    @property
    def sizing(self) -> list[Judged]:
        """Of the design's gain, about the size of its error."""
        return [item for item in self.items if item.own and item.method.reach in accuracy.REACHES]

    @property
    def covering(self) -> list[Judged]:
        """Proved of the design's gain for every sequence of periods of its law."""
        return [
            item for item in self.converging if item.own and item.proof.holds and item.method.covers.contains(self.law)
        ]

    @property
    def usable(self) -> list[Judged]:
        """Proved for the design's law with its period replaced, of this gain or another."""
        proved = [item for item in self.converging if item.proof.holds]
        return [item for item in proved if item.method.covers.contains(self.law.with_period(item.T))]

    @property
    def longest(self) -> Judged | None:
        """Of the design's gain the longest period."""
        return _longest([item for item in self.usable if item.own])

    @property
    def longest_exact(self) -> Judged | None:
        """The longest period of any gain that a method proves whose best gain is the best there is."""
        return _longest([item for item in self.usable if item.method.exact])

    @property
    def is_dead_beat(self) -> bool:
        return any(item.own and isinstance(item.method, DeadBeat) for item in self.usable)

    @property
    def defeated(self) -> list[Judged]:
        """Counterexamples of the design's gain, for its law with its period replaced, the shortest first."""
        proved = [item for item in self.items if item.own and item.method.reach == "no convergence"]
        fitting = [item for item in proved if item.proof.holds and item.method.law == self.law.with_period(item.T)]
        return sorted(fitting, key=lambda item: float(item.T))

    @property
    def hopeless(self) -> list[Judged]:
        """Proofs that every gain fails, for laws that the design's law at some period holds."""
        proved = [item for item in self.items if item.method.reach == "no gain" and item.proof.holds]
        return [item for item in proved if self.law.with_period(item.T).contains(item.method.law)]


def judgement_of(card: Card, plant: Plant, design: Design, effort: int) -> Judgement:
    """A design with its certificates proved again, under the law that it is for."""
    gain = design.gain if _has_gain(card, plant, design) else {}
    question = card.question(replace(plant, sampling=design.sampling), gain, effort)
    return Judgement(card, design, question, tuple(judged(card, plant, design, question)))


def _has_gain(card: Card, plant: Plant, design: Design) -> bool:
    gain = design.gain.get(card.letter)
    return design.outcome != "none" and gain is not None and gain.shape == plant.gain_shape


def judge(card: Card, plant: Plant, design: Design, effort: int) -> Check:
    """All claims and bounds of a design under the law that it is for."""
    judgement = judgement_of(card, plant, design, effort)
    plant, question = judgement.plant, judgement.question
    hidden = unseen(plant)
    if not _has_gain(card, plant, design):
        return _without_gain(judgement, hidden)
    beside, beside_bounds = card.claims_beside(judgement)
    claims = _certificate_claims(judgement)
    bounds = _bounds(judgement)
    lost = _lost_by_every_gain(judgement)
    if hidden is not None:
        lost.append(_every_gain(f"Every gain fails: {hidden.sentence(plant)}."))
    conclusion = _conclusion(judgement, hidden, claims)
    sized = [accuracy.Item(item.method, item.proof) for item in judgement.sizing]
    of_errors, error_bounds = accuracy.accuracy(question, sized)
    envelope, late = _envelope(judgement), []
    if plant.delays:
        from cdobs_cli.certify.late_claims import Sized, delay_max, growth, late_accuracy, late_claim, starts

        if of_errors:
            sizes = Sized(error_bounds, starts(sized, plant.n))
            of_errors, error_bounds = late_accuracy(question, card.late_maps, of_errors, sizes)
        found = growth(question, card.late_maps, envelope)
        late, envelope = [late_claim(question, found, envelope)], dict(found.envelope)
        if not plant.domain or design.estimate.way != "margin":
            bounds["delay_max"] = delay_max()
    told = (conclusion, *late, *of_errors, *claims, *beside, *lost, *_intervals(question))
    unique = {claim.id: claim for claim in reversed(told)}
    every = bounds | beside_bounds | error_bounds
    return Check(tuple(reversed(unique.values())), every, envelope=envelope)


def _convergence(judgement: Judgement, status: Status, statement: str, **more: Any) -> Claim:
    return Claim(
        CONVERGENCE, "consequence", status, statement, judgement.card.error_source, required=True, **more
    )  # fmt: skip


def _every_gain(statement: str, method: str = _UNSEEN) -> Claim:
    return Claim("every_gain", "certificate", "proved", statement, "exact rational arithmetic", method=method)


def _without_gain(judgement: Judgement, hidden: Unseen | None) -> Check:
    """No gain to speak of: refuted where none helps, else open for the reason that the search gave."""
    law, plant = judgement.law, judgement.plant
    defeated = next((item for item in judgement.hopeless if law.contains(item.method.law)), None)
    reason = judgement.design.reason or "the stored gain does not fit the plant"
    witness: Witness | None = None
    ends = [item.T for item in judgement.hopeless]
    if defeated is not None:
        reason = "no gain survives this sampling law"
        witness = Witness("vector", "class", data=dict(defeated.method.certificate().data))
    grown = _lost_by_chance(judgement)
    if grown is not None:
        reason, witness = grown
    if hidden is not None:
        reason, witness = hidden.sentence(plant), hidden.witness(plant)
        if not law.is_on_change:
            ends.append(hidden.period if hidden.period is not None and not law.is_lossy else law.period)
    bounds: dict[str, Bound] = {}
    if ends:
        about = witness.about if witness is not None else "class"
        by = _UNSEEN if hidden is not None else judgement.hopeless[0].method.name
        bounds["period_max_any_gain"] = Bound(None, _above(min(ends, key=float)), method=by, about=about)
    status: Status = "refuted" if witness is not None else "undecided"
    method = _UNSEEN if hidden is not None else None
    claim = _convergence(judgement, status, f"The error converges to 0: {reason}.", method=method, witness=witness)
    return Check((claim,), bounds)


def _conclusion(judgement: Judgement, hidden: Unseen | None, claims: Sequence[Claim]) -> Claim:
    """Proved by a certificate that covers the law, else refuted by a counterexample."""
    statement = _converges(judgement.law, judgement.plant)
    covering = judgement.covering
    if covering:
        best = max(covering, key=lambda item: float(item.proof.rate.lower()))
        margin = lower_text(best.proof.rate, 9) if best.proof.rate > 0 else None
        by = best.method.rung if best.method.law == judgement.law else f"period_max.{best.method.rung}"
        by = next((claim.id for claim in claims if claim.status == "proved" and claim.id.startswith(by)), by)
        return _convergence(judgement, "proved", statement, margin=margin, method=best.method.name, by=by)
    witness = hidden.witness(judgement.plant) if hidden is not None else None
    here = next((item for item in judgement.defeated if item.method.law == judgement.law), None)
    if witness is None and here is not None:
        witness = Witness.from_document(here.method.certificate().data["witness"])
    elif witness is None and judgement.design.outcome != "short":  # of such a gain shorter periods were kept
        witness = refute(judgement.question.inclusion, 0)
    defeated = next((item for item in judgement.hopeless if judgement.law.contains(item.method.law)), None)
    grown = _lost_by_chance(judgement)
    if witness is None and grown is not None:
        why, witness = grown
        told = f"{statement.removesuffix('.')}: {why}"
        return _convergence(judgement, "refuted", told, method=_UNCORRECTED, witness=witness)
    if witness is None and defeated is not None:
        witness = Witness("vector", "class", data=dict(defeated.method.certificate().data))
        return _convergence(
            judgement, "refuted", f"{statement}: no gain survives it", method=defeated.method.name, witness=witness
        )
    if witness is None:
        return _convergence(judgement, "undecided", statement)
    method = _UNSEEN if witness.kind == "vector" else f"{witness.kind} slopes"
    return _convergence(judgement, "refuted", statement, method=method, witness=witness)


def _lost_by_chance(judgement: Judgement) -> tuple[str, Witness] | None:
    """Where so many samples are lost by chance that every gain fails: why, and from which probability on."""
    law = judgement.law
    least = every_gain_fails_from(judgement.question.inclusion) if law.is_random else None
    if least is None or not Exact(least).is_at_most(law.probability):
        return None
    why = f"E |e|^2 grows for every gain from a probability of {least} on (single runs may still converge)"
    return why, Witness("vector", "class", data={"probability": least})


def _converges(law: SamplingLaw, plant: Plant) -> str:
    late = put_in_words(plant.delays)
    if law.is_random:
        blind = "for every slope history in the class that does not know which samples will be lost"
        return f"The error converges to 0 in mean square, and almost surely, {blind}, sampling {law.words}{late}."
    if law.is_on_change:
        ball = "falls to a neighbourhood of 0 that the thresholds fix and stays there"
        return f"The error {ball}, for every slope history in the class, sampling {law.words}{late}."
    return f"The error converges to 0 for every slope history in the class, sampling {law.words}{late}."


def _certificate_claims(judgement: Judgement) -> list[Claim]:
    """Those of the design's gain and law, then of each rung the longest period for this gain and for some gain."""
    here = judgement.here
    claims = [claim for item in here for claim in item.method.claims(judgement.question, item.proof)]
    for item in judgement.items:
        if item.method.reach == "some gain" and item.proof.holds:
            name, method = f"period_max_any_gain.{item.method.rung}", item.method
            claims.append(
                Claim(name, "certificate", "proved", f"{method.statement}.", method.source, method=method.how)
            )
    others = [item for item in judgement.converging if item not in here]
    for item in sorted(others, key=lambda item: (not item.proof.holds, -float(item.T))):
        whose, name = ("This", "period_max") if item.own else ("Some", "period_max_any_gain")
        claims.append(
            Claim(
                f"{name}.{item.method.rung}", "certificate", "proved" if item.proof.holds else "undecided",
                f"{whose} gain converges, sampling {item.method.covers.words}.", item.method.source,
                margin=lower_text(item.proof.rate, 6) if item.proof.rate > 0 else None, method=item.method.name,
            )
        )  # fmt: skip
    return claims


def _bounds(judgement: Judgement) -> dict[str, Bound]:
    """The bracket of the period with its ladder of methods, of all gains met, and the rate under the law."""
    if judgement.law.is_on_change:  # it has no period
        return _decay_rate(judgement)
    own = [item for item in judgement.usable if item.own]
    if judgement.is_dead_beat and resets(judgement.question.inclusion):
        told = "one sample erases every error, whatever the period"
        bounds = {name: _endless(DeadBeat.name, told) for name in ("period_max", "period_max_any_gain")}
    else:
        bounds = _brackets(judgement, own) | _any_gain(judgement)
    rate = judgement.card.wanted_rate
    at_rate = [item for item in own if item.proof.rate >= fraction_ball(rate)] if rate else []
    if at_rate:
        bounds["period_max_at_rate"] = _period(_longest(at_rate), None, f"this gain, at the rate {fraction_text(rate)}")
    return bounds | _decay_rate(judgement) | _loss_probability(judgement)


def _loss_probability(judgement: Judgement) -> dict[str, Bound]:
    """How often samples may be lost at the law's period: with this gain proved and refuted, with every gain refuted."""
    law = judgement.law
    if not law.is_random:
        return {}
    own = [item for item in judgement.items if item.own and item.proof.holds and _is_as(item.method.law, law)]
    proved = [item.method.law.probability for item in own if item.method.reach == "convergence"]
    refuted = [item.method.law.probability for item in own if item.method.reach == "no convergence"]
    lost = every_gain_fails_from(judgement.question.inclusion)
    most = max(proved, key=float, default=None)
    above = 0.0 if most is None else float(most)
    # Fewer losses are not implied: some gains do worse with every sample than without one.
    failing = [p for p in (*refuted, *([Exact(lost)] if lost is not None else [])) if float(p) > above]
    least = min(failing, key=float, default=None)
    ends = (None if most is None else text_below(most), None if least is None else _above(least))
    about = f"sampling every {law.period}, in mean square"
    bounds = {"loss_probability_max": Bound(*ends, "", "clock", f"this gain, {about}")}
    if lost is not None:
        bounds["loss_probability_max_any_gain"] = Bound(ends[0], lost, "", _UNCORRECTED, f"every gain, {about}")
    return bounds


def _is_as(law: SamplingLaw, other: SamplingLaw) -> bool:
    """Whether they differ in the probability of losses alone."""
    return law.is_random and law.period == other.period


def _decay_rate(judgement: Judgement) -> dict[str, Bound]:
    """The fastest rate proved under the law, and the slowest constant corner."""
    decaying = [item for item in judgement.covering if item.proof.rate > 0]
    fastest = max(decaying, key=lambda item: float(item.proof.rate.lower()), default=None)
    # Where samples are lost by chance no one word of periods says how slow the mean square is.
    blind = judgement.law.is_random or judgement.law.is_graph or judgement.law.is_on_change
    slowest = None if blind else slowest_decay(judgement.question.inclusion)
    if fastest is None and slowest is None:
        return {}
    proved, method = (None, None) if fastest is None else (lower_text(fastest.proof.rate, 9), fastest.method.rung)
    refuted = None if slowest is None else upper_text(slowest, 9)
    return {"decay_rate": Bound(proved, refuted, "1/s", method, "this gain under its law")}


def _endless(method: str, about: str) -> Bound:
    return Bound("inf", None, "s", method, about)


def _brackets(judgement: Judgement, own: list[Judged]) -> dict[str, Bound]:
    """Of the design's gain: the longest period proved, by each rung too, and the shortest refuted above it."""
    about, best = f"this gain, {judgement.law.open_end}", judgement.longest
    above = 0.0 if best is None else float(best.T)
    failing = next((item for item in judgement.defeated if float(item.T) > above), None)
    refuted = None if failing is None else _above(failing.T)
    if best is None and refuted is None:
        return {}
    rungs = dict.fromkeys(item.method.rung for item in own)
    ladder = {f"period_max.{rung}": _longest([item for item in own if item.method.rung == rung]) for rung in rungs}
    return {"period_max": _period(best, refuted, about)} | {
        name: _period(item, refuted, about) for name, item in ladder.items()
    }


def _any_gain(judgement: Judgement) -> dict[str, Bound]:
    """Of all gains: the longest period proved of one of them, the shortest at which every one fails."""
    some = (item for item in judgement.items if item.method.reach == "some gain" and item.proof.holds)
    some = (item for item in some if item.method.covers.contains(judgement.law.with_period(item.T)))
    endless = next((item.method for item in some if item.method.endless), None)
    if endless is not None:
        return {"period_max_any_gain": _endless(endless.name, endless.statement)}
    best, ends = _longest(judgement.usable), [item.T for item in judgement.hopeless]
    if best is None and not ends:
        return {}
    lost = _above(min(ends, key=float)) if ends else None
    about = "some gain proved, every gain refuted" if ends else "some gain"
    return {"period_max_any_gain": _period(best, lost, about)}


def _period(item: Judged | None, refuted: str | None, about: str) -> Bound:
    proved, method = (None, None) if item is None else (text_below(item.T), item.method.rung)
    return Bound(proved, refuted, "s", method, about)


def _longest(items: list[Judged]) -> Judged | None:
    return max(items, key=lambda item: float(item.T), default=None)


def _above(T: Exact) -> str:
    """A decimal not below T: T itself where it is one."""
    return upper_text(T.ball()) if T.rational is None or "/" in str(T) else str(T)


def _lost_by_every_gain(judgement: Judgement) -> list[Claim]:
    """The shortest period at which every gain fails."""
    item = min(judgement.hopeless, key=lambda item: float(item.T), default=None)
    if item is None:
        return []
    method = item.method
    statement = f"{method.sentence}, sampling {method.law.words}."
    return [Claim("period_max_any_gain.refuted", "certificate", "proved", statement, method.source, method=method.how)]


def _intervals(question: Question) -> list[Claim]:
    """For a linear plant: the constant periods that this gain survives, lost and regained as they grow."""
    T = float(question.law.period)
    intervals = stable_intervals(question.inclusion, T / 1000, 20 * T) if is_linear(question.inclusion) else []
    if not intervals:
        return []
    listed = ", ".join(f"[{interval.low}, {interval.high}]" for interval in intervals[:12])
    which = "every shortest period" if question.law.has_sensors else "every constant period"
    statement = f"The error converges at {which} in {listed}."
    how = "spectral radius, balls of periods"
    return [
        Claim(
            "period_max.intervals",
            "certificate",
            "proved",
            statement,
            "spectral radius of the sampled error",
            method=how,
        )
    ]


def _envelope(judgement: Judgement) -> dict[str, str]:
    """factor and rate of |e(t)| <= factor |e(0)| exp(-rate t), from the certificates that cover the law; the fastest
    that has one."""
    met = [(item.method.factor(judgement.question), item.proof.rate) for item in judgement.covering]
    known = [(factor, rate) for factor, rate in met if factor is not None]
    best = max(known, key=lambda one: (float(one[1].lower()), -one[0]), default=None)
    return {} if best is None else {"factor": upper_text(arb(best[0]), 6), "rate": lower_text(best[1], 9)}


def _covering(card: Card, plant: Plant, design: Design) -> tuple[Question, list[Judged]]:
    question = card.question(replace(plant, sampling=design.sampling), design.gain, 0)
    items = judged(card, plant, design, question, lambda method: method.reach == "convergence")
    return question, Judgement(card, design, question, tuple(items)).covering


def levels(card: Card, plant: Plant, design: Design) -> list[Level]:
    """Level sets of the error, of the certificates that cover the design's law."""
    question, covering = _covering(card, plant, design)
    met = [item.method.level(question) for item in covering]
    return [level for level in met if level is not None]


def transients(card: Card, plant: Plant, design: Design) -> list[accuracy.Transient]:
    """How large the error becomes on the way without disturbance and noise."""
    free: list[accuracy.Transient] = [level.bounds for level in levels(card, plant, design)]
    return _at_present(card, plant, design, free, quiet=True)


def noisy_transients(card: Card, plant: Plant, design: Design) -> list[accuracy.Transient]:
    """How large the error becomes on the way under the declared disturbance and noise, where these are bounded."""
    if not plant.has_only_bounded:
        return []
    question, covering = _covering(card, plant, design)
    if design.sampling.is_on_change:  # errors do not add: when messages come hangs on them. These hold under noise
        return [level.bounds for level in levels(card, plant, design)]
    sizing = judged(card, plant, design, question, lambda method: method.reach == "error bound")
    sized = [accuracy.Item(item.method, item.proof) for item in sizing if item.own]
    met = (item.method.level(question) for item in covering)
    free = accuracy.transients(question, sized, [level for level in met if level is not None])
    return _at_present(card, plant, design, free, quiet=False)


def _at_present(
    card: Card, plant: Plant, design: Design, free: list[accuracy.Transient], *, quiet: bool
) -> list[accuracy.Transient]:
    """Transients of an estimate without delays as those of the one at the present."""
    if not plant.delays or not free:
        return free
    from cdobs_cli.certify.late_claims import late_transients

    question = card.question(replace(plant, sampling=design.sampling), design.gain, 0)
    return late_transients(question, card.late_maps, free, quiet=quiet)
