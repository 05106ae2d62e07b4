"""What needs a search: S and L for an objective, and the feedback."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.sylvester import is_observable
from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, decimal_text, lower_text, upper_text
from cdobs_cli.families.interval.cone import Cone
from cdobs_cli.families.interval.design import Search, Shape, printed, residuals
from cdobs_cli.families.interval.feedback_design import feedback_design
from cdobs_cli.families.interval.held_loop import HeldLoop
from cdobs_cli.families.interval.hull import Hull
from cdobs_cli.families.interval.hull_design import hull_design
from cdobs_cli.families.interval.hurwitz import Hurwitz, final_width
from cdobs_cli.families.interval.lmi_15 import Lmi15
from cdobs_cli.families.interval.method import Gain, between
from cdobs_cli.families.interval.observer import inclusion
from cdobs_cli.families.interval.parts import entries
from cdobs_cli.families.interval.system import System, singular
from cdobs_cli.families.interval.theorem_2 import Theorem2
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

METHODS = (Hurwitz, Lmi15, Hull, Cone, HeldLoop, Theorem2)

_CURVE_STATES = 4  # beyond these the curve is left to higher efforts
_CURVE = (0.25, 0.5, 0.7, 0.85, 0.95, 1.0)  # shares of the longest period on the trade-off curve
_INJECTED = (1.0, 0.999, 0.99, 0.95)  # shares of the injection, where the grid of the search was too coarse
_HELD_WIDTH = Fraction(1, 1000)


def synthesize(family: Interval, plant: Plant, effort: int) -> Design:
    """The given S and L or a found pair, the feedback asked for, and certificates for the law designed for.

    Source: Efimov2016, Theorem 1, Theorem 2
    """
    card = Question(inclusion(plant, {}), effort=effort, card=family)
    law, details = plant.sampling, dict[str, Any]()
    if family.gain is not None:
        outcome: Outcome = "given"
        gain: Gain = {"S": family.gain.S, "L": family.gain.L}
        reason = singular(family.gain.S)
        if reason is not None:
            return Design("interval", "none", law, gain, reason=reason)
        if family.objective == "max_period":
            law = _longest_law(card.with_gain(gain))
    else:
        outcome = "found"
        made = _designed(card)
        if isinstance(made, str):
            return Design("interval", "none", law, {}, reason=made)
        gain, law, details = made
    if family.feedback == "design":
        K = feedback_design(card.with_gain(gain).under(law))
        if K is None:
            reason = f"no feedback was found that is proved to stabilise the held loop for periods up to {law.T_max}"
            return Design("interval", "none", law, gain, reason=reason, details=details)
        gain = {**gain, **K}
    elif family.feedback != "none":
        gain = {**gain, "K_lower": family.feedback.K_lower, "K_upper": family.feedback.K_upper}
        if family.objective == "max_period":
            law = _held_law(card.with_gain(gain).under(law), plant.sampling)
    question = card.with_gain(gain).under(law)
    stored = [part.certificate() for kind in METHODS if kind.applies(question) for part in kind.stored(question)]
    return Design("interval", outcome, law, gain, tuple(stored), details=details)


def _designed(card: Question) -> tuple[Gain, SamplingLaw, dict[str, Any]] | str:
    """S, L and the law for the objective, proved; or why there is none."""
    family, plant, effort = card.card, card.plant, card.effort
    law, T = plant.sampling, plant.sampling.T_max
    if is_observable(plant.A.balls(), plant.C.balls()) is False:
        return "the pair (A, C) is not observable: no S = [C; T] from the Sylvester equation is invertible"
    if np.linalg.matrix_rank(plant.C.floats) < plant.p:
        return "the rows of C depend on one another: leave out the outputs that say nothing new"
    if not np.all(np.isfinite(plant.A.floats)):
        return "the entries of A are too large for a search in floats"
    searched = Search.of(plant)
    ordered = None if family.objective == "max_period" else _ordered_design(card, searched)
    if ordered is None and family.tighten == "hull":
        return hull_design(card, searched)
    if family.objective == "max_period":
        pair = searched.longest_design(effort)
        if pair is None:
            return "no S and L of this form were found that keep the bounds in order and bounded"
        gain: Gain = printed(plant, *pair)
        shape = pair[0]
        law = _ordered_law(card.with_gain(gain))
        if float(law.T_max) < float(T):
            return f"the longest period found is {law.T_max}, shorter than the {T} asked for"
    elif ordered is None:
        longest = searched.longest_design(0)
        T_reached = decimal_text(searched.longest(longest[0]), 3) if longest else None
        reached = f"; the longest period reached is about {T_reached}" if longest else ""
        return f"no S and L of this form were found for periods up to {T}{reached}"
    else:
        gain, shape = ordered
    details: dict[str, Any] = {"sylvester": _sylvester(plant, gain, shape)}
    if effort > 0 and (plant.n <= _CURVE_STATES or effort > 1):
        details["trade_off"] = _trade_off(card, searched, law)
    return gain, law, details


def _ordered_design(card: Question, searched: Search) -> tuple[Gain, Shape] | None:
    """A design at the plant's own law that keeps the bounds in order: least width, or fastest decay of it."""
    at = searched.width_design if card.card.objective == "min_width" else searched.decay_design
    return _proved_at(card, at(float(card.law.T_max), card.effort))


def _proved_at(card: Question, pair: tuple[Shape, Array] | None) -> tuple[Gain, Shape] | None:
    """The printed gain with positivity and boundedness proved at the law's T_max, with a little less injection
    where the grid of the search was too coarse."""
    for share in _INJECTED if pair is not None else ():
        assert pair is not None
        gain = printed(card.plant, pair[0], pair[1] * share)
        question = card.with_gain(gain)
        if singular(gain["S"]) is not None or not System.of(question).limit.holds_until(card.law.T_max.ball()):
            continue
        if Hurwitz.propose(question) is not None:
            return gain, pair[0]
    return None


def _sylvester(plant: Plant, gain: Gain, shape: Shape) -> dict[str, Any]:
    """How well the printed T solves T A - Lambda T = G C, and the printed L its equation."""
    solved, structure = residuals(System(plant, gain), shape.rates, shape.directions)
    return {
        "rates": [decimal_text(float(rate), 8) for rate in shape.rates],
        "directions": [[decimal_text(float(value), 8) for value in row] for row in shape.directions],
        "residual": decimal_text(solved, 3), "residual_structure": decimal_text(structure, 3),
    }  # fmt: skip


def _trade_off(card: Question, searched: Search, law: SamplingLaw) -> list[dict[str, str]]:
    """Least proved width sum for some largest periods: each point is a design of its own, proved."""
    longest = searched.longest_design(0)
    if longest is None:
        return []
    T_longest = max(searched.longest(longest[0]), float(law.T_max))
    widths = [Matrix.from_floats(box.tolist()) for box in (searched.disturbance, searched.noise)]
    points = []
    for T in sorted({*(share * T_longest for share in _CURVE), float(law.T_max)}):
        period = search.short(T, 5)
        at = card.under(SamplingLaw("aperiodic", T_max=period))
        proved = _proved_at(at, searched.width_design(float(period), 0))
        if proved is not None:
            system = System(card.plant, proved[0])
            values = entries(final_width(system.z, system.Mtot, *widths))
            points.append({"period": str(period), "width_sum": upper_text(sum(values[1:], values[0]), 6)})
    return points


def _ordered_law(question: Question) -> SamplingLaw:
    """The law with the longest period for which E(s) >= 0 is proved; the law itself where that is none or any, or the
    width need not stay bounded."""
    limit = System.of(question).limit.proved
    if not limit or Hurwitz.propose(question) is None:
        return question.law
    return question.law.with_period(Exact(lower_text(fraction_ball(limit), 6)))


def _longest_law(question: Question) -> SamplingLaw:
    """The law with the longest period proved for given S and L: by positivity, by a cone of errors, or by the hull's
    contraction. The period in the spec is the least acceptable: a shorter one is no answer, whatever is proved
    there."""
    laws, start = [question.law], Cone.above(question)
    if question.card.tighten == "hull":
        hull = Hull.longest(question)
        laws += [] if hull is None else [hull.law]
    else:
        laws.append(_ordered_law(question))
        cone = Cone.longest(question.at(start)) if start is not None and Cone.applies(question) else None
        laws += [cone.law] if cone is not None and cone.shrinks(System.of(question).errors) else []
    return max(laws, key=lambda law: float(law.T_max))


def _held_law(question: Question, least: SamplingLaw) -> SamplingLaw:
    """The law with its period cut to what the held loop is proved for, or the least acceptable one."""
    if HeldLoop.propose(question) is not None:
        return question.law
    loop = between(lambda T: HeldLoop.propose(question.at(T)), least.T_max, question.law.T_max, _HELD_WIDTH)
    return least if loop is None else loop.law
