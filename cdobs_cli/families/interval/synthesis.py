"""What needs a search: S and L for an objective, and the feedback."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb

from cdobs_cli.certify.bracket import largest_proved
from cdobs_cli.certify.sylvester import is_observable
from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text
from cdobs_cli.families.interval.boundedness import final_width
from cdobs_cli.families.interval.certificates import (
    CONE_STATES,
    Array,
    Gain,
    Views,
    above,
    certificates,
    error_system,
    largest_hull,
    longest_cone,
    prove_feedback,
    proved_w_star,
    sylvester_residuals,
)
from cdobs_cli.families.interval.design import Search, Shape, printed
from cdobs_cli.families.interval.held_loop import closed_loop, descriptor_design
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

_CURVE_STATES = 4  # beyond these the curve is left to higher efforts
_CURVE = (0.25, 0.5, 0.7, 0.85, 0.95, 1.0)  # shares of the longest period on the trade-off curve


def singular(S: ExactMatrix) -> str | None:
    """Why S has no inverse; None where it has one."""
    determinant = S.balls().data.det()
    if not arb(determinant).contains(0):
        return None
    if S.balls().is_rational:
        return "S is singular (det S = 0), so z = S x does not determine x"
    return f"S may be singular: det S is only known to be within {float(arb(determinant).rad()):.1g} of {float(arb(determinant).mid()):.1g}"


def synthesize(family: Interval, plant: Plant, effort: int) -> Design:
    """The given S and L or a found pair, the feedback asked for, and certificates for the law designed for.

    Source: Efimov2016, Theorem 1, Theorem 2
    """
    law, details = plant.sampling, dict[str, Any]()
    if family.gain is not None:
        outcome: Outcome = "given"
        gain: Gain = {"S": family.gain.S, "L": family.gain.L}
        reason = singular(family.gain.S)
        if reason is not None:
            return Design("interval", "none", law, gain, reason=reason)
        if family.objective == "max_period":
            longest = _longest_law(plant, gain, law, family.tighten == "hull")
            if family.tighten != "hull" and plant.n <= CONE_STATES:
                longest = _longest_cone_law(plant, gain, longest, cut=family.tighten == "intersect")
            # The period in the spec is the least acceptable: a shorter one is no answer, whatever is proved there.
            law = longest if float(longest.T_max) > float(law.T_max) else law
    else:
        outcome = "found"
        made = _designed(family, plant, effort)
        if isinstance(made, str):
            return Design("interval", "none", law, {}, reason=made)
        gain, law, details = made
    if family.feedback == "design":
        K = _feedback(plant, gain, law)
        if K is None:
            reason = f"no feedback was found that is proved to stabilise the held loop for periods up to {law.T_max}"
            return Design("interval", "none", law, gain, reason=reason, details=details)
        gain |= K
    elif family.feedback != "none":
        gain |= {"K_lower": family.feedback.K_lower, "K_upper": family.feedback.K_upper}
        if family.objective == "max_period":
            law = _held_law(plant, gain, law, effort)
    return Design("interval", outcome, law, gain, tuple(certificates(plant, gain, law, family, effort)), details=details)


def _designed(family: Interval, plant: Plant, effort: int) -> tuple[Gain, SamplingLaw, dict[str, Any]] | str:
    """S, L and the law for the objective, proved; or why there is none."""
    observable = is_observable(plant.A.balls(), plant.C.balls())
    if observable is False:
        return "the pair (A, C) is not observable: no S = [C; T] from the Sylvester equation is invertible"
    if np.linalg.matrix_rank(plant.C.floats) < plant.p:
        return "the rows of C depend on one another: leave out the outputs that say nothing new"
    if not np.all(np.isfinite(plant.A.floats)):
        return "the entries of A are too large for a search in floats"
    search = Search.of(plant)
    T = float(plant.sampling.T_max)
    if family.tighten == "hull" and (family.objective == "max_period" or _ordered_design(family, plant, search, effort) is None):
        from cdobs_cli.families.interval.hull_design import hull_design

        return hull_design(family, plant, search, effort)
    law = plant.sampling
    if family.objective == "max_period":
        found = search.longest_design(effort)
        if found is None:
            return "no S and L of this form were found that keep the bounds in order and bounded"
        gain = printed(plant, *found)
        law = _longest_law(plant, gain, law, hull=False)
        if float(law.T_max) < T:
            return f"the longest period found is {law.T_max}, shorter than the {plant.sampling.T_max} asked for"
    else:
        proved = _ordered_design(family, plant, search, effort)
        if proved is None:
            longest = search.longest_design(0)
            reached = f"; the longest period reached is about {decimal_text(search.longest(longest[0]), 3)}" if longest else ""
            return f"no S and L of this form were found for periods up to {plant.sampling.T_max}{reached}"
        gain, found = proved
    details: dict[str, Any] = {"sylvester": _sylvester(plant, gain, found[0])}
    if effort > 0 and (plant.n <= _CURVE_STATES or effort > 1):
        details["trade_off"] = _trade_off(plant, search, law)
    return gain, law, details


def _ordered_design(family: Interval, plant: Plant, search: Search, effort: int) -> tuple[Gain, tuple[Shape, Array]] | None:
    """A design at the plant's own law that keeps the bounds in order: least width, or fastest decay of it."""
    at = search.width_design if family.objective == "min_width" else search.decay_design
    pair = at(float(plant.sampling.T_max), effort)
    return _proved_at(plant, pair) if pair is not None else None


def _proved_at(plant: Plant, pair: tuple[Shape, Array]) -> tuple[Gain, tuple[Shape, Array]] | None:
    """The printed gain with positivity and boundedness proved at the plant's T_max, with a little less injection
    where the grid of the search was too coarse."""
    shape, q = pair
    T = plant.sampling.T_max.ball()
    for share in (1.0, 0.999, 0.99, 0.95):
        gain = printed(plant, shape, q * share)
        if singular(gain["S"]) is None and _holds(plant, gain, T):
            return gain, (shape, q * share)
    return None


def _holds(plant: Plant, gain: Gain, T: arb) -> bool:
    views = Views.of(plant, gain)
    return views.positivity.holds_until(T) and proved_w_star(views) is not None


def _sylvester(plant: Plant, gain: Gain, shape: Shape) -> dict[str, Any]:
    """How well the printed T solves T A - Lambda T = G C, and the printed L its equation."""
    solved, structure = sylvester_residuals(plant, gain, shape.rates, shape.directions)
    return {
        "rates": [decimal_text(float(rate), 8) for rate in shape.rates],
        "directions": [[decimal_text(float(value), 8) for value in row] for row in shape.directions],
        "residual": decimal_text(solved, 3), "residual_structure": decimal_text(structure, 3),
    }  # fmt: skip


def _trade_off(plant: Plant, search: Search, law: SamplingLaw) -> list[dict[str, str]]:
    """Least proved width sum for some largest periods: each point is a design of its own, proved."""
    longest = search.longest_design(0)
    if longest is None:
        return []
    T_longest = max(search.longest(longest[0]), float(law.T_max))
    points = []
    for T in sorted({*(share * T_longest for share in _CURVE), float(law.T_max)}):
        text = decimal_text(T, 5)
        at = replace(plant, sampling=SamplingLaw("aperiodic", T_max=Exact(text)))
        pair = search.width_design(float(Exact(text)), 0)
        proved = _proved_at(at, pair) if pair is not None else None
        if proved is not None:
            views = Views.of(at, proved[0])
            width = final_width(views.exact, views.Mtot, *(Matrix.from_floats(box.tolist()) for box in (search.disturbance, search.noise)))
            points.append({"period": text, "width_sum": upper_text(sum((arb(row[0]) for row in width.tolist()), arb(0)), 6)})
    return points


def _longest_law(plant: Plant, gain: Gain, law: SamplingLaw, hull: bool) -> SamplingLaw:
    """The law with the largest period proved for given S and L: by positivity, or by the hull's contraction."""
    views = Views.of(plant, gain)
    if hull:
        found = largest_hull(plant, gain, law)
        return law if found is None else found[0]
    if proved_w_star(views) is None:
        return law
    proved = views.positivity.proved
    if proved is None or proved == 0:
        return law
    return law.with_period(Exact(lower_text(fraction_ball(proved), 6)))


def _longest_cone_law(plant: Plant, gain: Gain, law: SamplingLaw, *, cut: bool) -> SamplingLaw:
    """The law with the largest period found for which a cone of errors is proved to keep the bounds, and them bounded;
    the law itself where there is none longer."""
    views = Views.of(plant, gain)
    proved = views.positivity.proved
    if proved is None or proved == 0:
        return law
    errors = error_system(plant, gain, views, cut=cut)
    found = longest_cone(errors, law, above(proved))
    if found is None or float(found[0].T_max) <= float(law.T_max):
        return law
    return found[0] if found[1].proves_boundedness(errors, found[0]) else law


def _feedback(plant: Plant, gain: Gain, law: SamplingLaw) -> Gain | None:
    """K_lower = K_upper = K S^-1 / 2 by the descriptor LMI, the fastest of those proved for the law."""
    assert plant.B is not None
    A, B = np.array(plant.A.floats), np.array(plant.B.floats)
    T = float(law.T_max)
    R = Views.of(plant, gain).floats.R
    best: tuple[float, Gain] | None = None
    for epsilon in (0.1, 0.3, 1.0, 3.0):
        for unit in {1.0, max(T, 1e-9)}:
            # epsilon has the unit of time: tried in the plant's and in the sampling period's.
            K = descriptor_design(A, B, T, epsilon * unit)
            if K is None:
                continue
            half = ExactMatrix.from_floats(K @ R / 2, 5)
            candidate = {"K_lower": half, "K_upper": half}
            found = prove_feedback(plant, gain | candidate, law)
            if found is not None:
                rate = _slowest(plant, gain | candidate, law)
                if best is None or rate < best[0]:
                    best = rate, candidate
    return None if best is None else best[1]


def _slowest(plant: Plant, gain: Gain, law: SamplingLaw) -> float:
    """log rho(F(T)) / T at the largest period: the rate of the held loop there."""
    from cdobs_cli.certify.falsify import exponentials

    A, closed = (M.floats for M in closed_loop(plant, gain))
    T, n = float(law.T_max), len(A)
    both = exponentials(np.block([[A, closed - A], [np.zeros((n, 2 * n))]])[None] * T)[0]
    rho = float(np.abs(np.linalg.eigvals(both[:n, :n] + both[:n, n:])).max())
    return float(np.log(max(rho, 1e-12))) / T


def _held_law(plant: Plant, gain: Gain, law: SamplingLaw, effort: int) -> SamplingLaw:
    """The law with its period cut to what the held loop is proved for."""
    if prove_feedback(plant, gain, law) is not None:
        return law
    found = largest_proved(lambda T: prove_feedback(plant, gain, law.with_period(T)), plant.sampling.T_max, law.T_max, Fraction(1, 1000))
    return plant.sampling if found is None else law.with_period(found[0])
