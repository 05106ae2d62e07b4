"""What needs a solver or a search: S and L, the feedback, and a certificate for each thing to be proved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.bracket import largest_proved, smallest_refuted
from cdobs_cli.certify.sylvester import is_observable, residual
from cdobs_cli.design import Design, Outcome
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text
from cdobs_cli.families.interval.boundedness import Lmi15, final_width, find_lmi_15, find_w_star, lmi_15_limit, prove_hurwitz
from cdobs_cli.families.interval.design import Search, Shape, printed
from cdobs_cli.families.interval.held_loop import (
    closed_loop,
    descriptor_design,
    find_held_loop,
    held_inclusion,
    prove_held_loop,
)
from cdobs_cli.families.interval.hull import find_hull, prove_hull
from cdobs_cli.families.interval.positivity import PositivityLimit, positivity_limit
from cdobs_cli.families.interval.theorem_2 import Theorem2, find_theorem_2, gain_limit, observer_loop, refute_theorem_2
from cdobs_cli.families.interval.theorems import Coordinates, assumption_3, coordinates, error_flow, error_held, width_matrix
from cdobs_cli.plant import Plant, SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

Array = np.ndarray[Any, np.dtype[np.float64]]
Gain = dict[str, ExactMatrix]

_LMI_STATES, _THEOREM_2_STATES = 8, 3  # beyond these the paper's LMIs take longer than they are worth
_CURVE = (0.25, 0.5, 0.7, 0.85, 0.95, 1.0)  # shares of the longest period on the trade-off curve
_FRONTIER = Fraction(1, 2000)


@dataclass(frozen=True)
class Views:
    """Plant and gain in z = S x, in balls and in floats."""

    exact: Coordinates[Matrix]
    floats: Coordinates[Array]

    @staticmethod
    def of(plant: Plant, gain: Mapping[str, ExactMatrix]) -> Views:
        """Raises: ZeroDivisionError where S may be singular."""
        S, L = gain["S"], gain["L"]
        exact = coordinates(plant.A.balls(), plant.C.balls(), S.balls(), S.balls().inverse(), L.balls())
        return Views(exact, coordinates(plant.A.floats, plant.C.floats, S.floats, exact.R.floats, L.floats))

    @property
    def positivity(self) -> PositivityLimit:
        return positivity_limit(error_flow(self.exact.Q0), error_held(self.exact.Q1))

    @property
    def Mtot(self) -> Matrix:
        return width_matrix(self.exact.Q0, self.exact.Q1)


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
            law = _longest_law(plant, gain, law, family.tighten == "hull")
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
    return Design("interval", outcome, law, gain, tuple(_certificates(plant, gain, law, family, effort)), details=details)


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
    if effort > 0:
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
    return views.positivity.holds_until(T) and _hurwitz(views) is not None


def _hurwitz(views: Views) -> ExactMatrix | None:
    w_star = find_w_star(width_matrix(views.floats.Q0, views.floats.Q1))
    return w_star if w_star is not None and prove_hurwitz(views.Mtot, w_star.balls()) is not None else None


def _sylvester(plant: Plant, gain: Gain, shape: Shape) -> dict[str, Any]:
    """How well the printed T solves T A - Lambda T = G C, and the printed L its equation."""
    p = plant.p
    T = gain["S"].floats[p:]
    z = Views.of(plant, gain).floats
    wanted = np.zeros_like(z.Q1)
    wanted[:p, :p] = np.diag(np.diag(z.Q1)[:p])
    largest = float(np.abs(z.Q1).max()) or 1.0
    return {
        "rates": [decimal_text(float(rate), 8) for rate in shape.rates],
        "directions": [[decimal_text(float(value), 8) for value in row] for row in shape.directions],
        "residual": decimal_text(residual(plant.A.floats, plant.C.floats, T, shape.rates, shape.directions), 3),
        "residual_structure": decimal_text(float(np.abs(z.Q1 - wanted).max()) / largest, 3),
    }


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
            width = final_width(views.floats, width_matrix(views.floats.Q0, views.floats.Q1), search.disturbance, search.noise)
            points.append({"period": text, "width_sum": decimal_text(float(width.sum()), 6)})
    return points


def _longest_law(plant: Plant, gain: Gain, law: SamplingLaw, hull: bool) -> SamplingLaw:
    """The law with the largest period proved for given S and L: by positivity, or by the hull's contraction."""
    views = Views.of(plant, gain)
    if hull:
        found = largest_hull(plant, gain, law)
        return law if found is None else found[0]
    if _hurwitz(views) is None:
        return law
    proved = views.positivity.proved
    if proved is None or proved == 0:
        return law
    return law.with_period(Exact(lower_text(fraction_ball(proved), 6)))


def largest_hull(plant: Plant, gain: Gain, law: SamplingLaw) -> tuple[SamplingLaw, ExactMatrix] | None:
    """The law with the largest period found for which the hull predictor contracts, and its weights."""
    S, L, A, C = gain["S"], gain["L"], plant.A, plant.C
    exact = (A.balls(), C.balls(), S.balls(), S.balls().inverse(), L.balls())

    def prove(T: Exact) -> ExactMatrix | None:
        at = law.with_period(T)
        w = find_hull(A.floats, C.floats, S.floats, L.floats, at)
        return w if w is not None and prove_hull(*exact, w.balls(), at) else None

    start = law.T_max
    low = start if prove(start) is not None else Exact(decimal_text(float(start) / 100, 6))
    high = low
    for _ in range(12):
        high = Exact(decimal_text(float(high) * 1.6, 6))
        if prove(high) is None:
            break
    found = largest_proved(prove, low, high, Fraction(1, 1000))
    return None if found is None else (law.with_period(found[0]), found[1])


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


def prove_feedback(plant: Plant, gain: Gain, law: SamplingLaw) -> ExactMatrix | None:
    """P of the held loop for a law, proved; None where none was found."""
    A, closed = closed_loop(plant, gain)
    P = find_held_loop(A.floats, closed.floats, law)
    return P if P is not None and prove_held_loop(A, closed, P.balls(), law) else None


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


def _certificates(plant: Plant, gain: Gain, law: SamplingLaw, family: Interval, effort: int) -> list[Certificate]:
    """One for each statement that needs numbers: w*, LMI (15), the hull's weights, the held loop, Theorem 2."""
    views = Views.of(plant, gain)
    found = []
    w_star = find_w_star(width_matrix(views.floats.Q0, views.floats.Q1))
    if w_star is not None:
        found.append(Certificate("hurwitz", law, {"w_star": w_star.texts()}))
    if not assumption_3(views.exact.Q1) and plant.n <= _LMI_STATES:
        found += _lmi_15(views, law)
    w = find_hull(plant.A.floats, plant.C.floats, gain["S"].floats, gain["L"].floats, law)
    if w is not None:
        found.append(Certificate("hull", law, {"w": w.texts()}))
    frontier = largest_hull(plant, gain, law) if family.tighten == "hull" else None
    if frontier is not None:
        found.append(Certificate("hull_frontier", frontier[0], {"w": frontier[1].texts()}))
    if "K_lower" in gain:
        found += _held_loop(plant, gain, law, effort)
        if not assumption_3(views.exact.Q1) and plant.n <= _THEOREM_2_STATES:
            found += _theorem_2(plant, gain, views, law, effort)
    return found


def _lmi_15(views: Views, law: SamplingLaw) -> list[Certificate]:
    """The largest period with a proved solution of (15): it serves every smaller one."""
    limit = lmi_15_limit(views.exact)
    if limit is None or _hurwitz(views) is None:
        return []

    def prove(T: Exact) -> Lmi15 | None:
        return find_lmi_15(views.floats, views.exact, T.rational or Fraction(0))

    low, high = (Exact(decimal_text(float(limit) * share, 8)) for share in (1e-3, 0.9996))
    found = largest_proved(prove, low, high, _FRONTIER)
    if found is None:
        return []
    return [Certificate("lmi_15", SamplingLaw("aperiodic", T_max=found[0]), found[1].document())]


def _held_loop(plant: Plant, gain: Gain, law: SamplingLaw, effort: int) -> list[Certificate]:
    P = prove_feedback(plant, gain, law)
    found = [] if P is None else [Certificate("held_loop", law, {"P": P.texts()})]
    refuted = smallest_refuted(lambda T: held_inclusion(plant, gain, law.with_period(T)), law.T_max if P is not None else None, effort)
    high = refuted[0] if refuted is not None else Exact(decimal_text(20 * float(law.T_max), 6))
    low = law.T_max if P is not None else Exact(decimal_text(float(high) / 100, 6))
    frontier = largest_proved(lambda T: prove_feedback(plant, gain, law.with_period(T)), low, high, Fraction(1, 5000))
    if frontier is not None:
        found.append(Certificate("held_loop_frontier", law.with_period(frontier[0]), {"P": frontier[1].texts()}))
    return found


def _theorem_2(plant: Plant, gain: Gain, views: Views, law: SamplingLaw, effort: int) -> list[Certificate]:
    """At the law's largest period the solution of least gamma; and the largest period where gamma is small enough."""
    assert plant.B is not None
    K = gain["K_lower"], gain["K_upper"]
    exact = observer_loop(views.exact, views.exact.S @ plant.B.balls(), *(k.balls() for k in K))
    floats = observer_loop(views.floats, views.floats.S @ plant.B.floats, *(k.floats for k in K))
    limit = gain_limit(views.exact, plant.C.balls())
    T = Exact(decimal_text(float(law.T_max), 12)) if law.T_max.rational is None else law.T_max
    at_law = find_theorem_2(floats, exact, T.rational or Fraction(0))
    found = [] if at_law is None else [Certificate("theorem_2", SamplingLaw("aperiodic", T_max=T), at_law.document())]
    if refute_theorem_2(exact, limit) is not None or effort == 0:
        return found

    def prove(period: Exact) -> Theorem2 | None:
        solution = find_theorem_2(floats, exact, period.rational or Fraction(0))
        return solution if solution is not None and bool(solution.gamma.ball() < limit) else None

    low = Exact(decimal_text(float(T) / 50, 6))
    frontier = largest_proved(prove, low, Exact(decimal_text(2 * float(T), 8)), Fraction(1, 1000))
    if frontier is not None:
        found.append(Certificate("theorem_2_frontier", SamplingLaw("aperiodic", T_max=frontier[0]), frontier[1].document()))
    return found


def declared_widths(plant: Plant) -> tuple[Matrix, Matrix]:
    """upper - lower of disturbance and noise in balls, zeros where none is declared."""

    def widths(box: Any, size: int) -> Matrix:
        if box is None:
            return Matrix.zeros(size, 1)
        return ExactMatrix([[high - low] for low, high in zip(box.lower, box.upper, strict=True)]).balls()

    return widths(plant.disturbance, plant.n), widths(plant.noise, plant.p)


__all__ = ["Views", "declared_widths", "singular", "synthesize"]
