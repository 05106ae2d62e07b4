"""A certificate for each statement that needs numbers, found by a solver or in floats and proved at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.bracket import largest_proved, smallest_refuted
from cdobs_cli.certify.sylvester import residual
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.interval.analysis import declared_widths
from cdobs_cli.families.interval.boundedness import Lmi15, find_lmi_15, find_w_star, lmi_15_limit, prove_hurwitz
from cdobs_cli.families.interval.cone import Cone, ErrorSystem
from cdobs_cli.families.interval.cone_search import find_cone, likely_cones
from cdobs_cli.families.interval.held_loop import closed_loop, find_held_loop, held_inclusion, prove_held_loop
from cdobs_cli.families.interval.hull import find_hull, prove_hull
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.positivity import PositivityLimit, positivity_limit
from cdobs_cli.families.interval.theorem_2 import Theorem2, find_theorem_2, gain_limit, observer_loop, refute_theorem_2
from cdobs_cli.families.interval.theorems import (
    Coordinates,
    assumption_3,
    coordinates,
    error_flow,
    error_held,
    width_matrix,
)
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

Array = np.ndarray[Any, np.dtype[np.float64]]
Gain = dict[str, ExactMatrix]

_LMI_STATES, _THEOREM_2_STATES = 8, 3  # beyond these the paper's LMIs take longer than they are worth
_FRONTIER = Fraction(1, 2000)
CONE_STATES, _CONE_FRONTIER = 6, Fraction(1, 50000)
_ABOVE = Fraction(1, 10**6)  # how far above the limit of E(s) >= 0 a cone is first looked for
_LONGER = 4  # how many times beyond it the longest is looked for
_LESS = (Fraction(1, 10**5), Fraction(1, 10**4), Fraction(1, 10**3), Fraction(1, 100), Fraction(1, 10))


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


def sylvester_residuals(plant: Plant, gain: Mapping[str, ExactMatrix], rates: Array, directions: Array) -> tuple[float, float]:
    """How well the printed T solves T A - Lambda T = G C, and the printed L its equation: both relative."""
    p = plant.p
    z = Views.of(plant, gain).floats
    wanted = np.zeros_like(z.Q1)
    wanted[:p, :p] = np.diag(np.diag(z.Q1)[:p])
    largest = float(np.abs(z.Q1).max()) or 1.0
    return (
        residual(plant.A.floats, plant.C.floats, gain["S"].floats[p:], rates, directions),
        float(np.abs(z.Q1 - wanted).max()) / largest,
    )


def proved_w_star(views: Views) -> ExactMatrix | None:
    w_star = find_w_star(width_matrix(views.floats.Q0, views.floats.Q1))
    return w_star if w_star is not None and prove_hurwitz(views.Mtot, w_star.balls()) is not None else None


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


def prove_feedback(plant: Plant, gain: Gain, law: SamplingLaw) -> ExactMatrix | None:
    """P of the held loop for a law, proved; None where none was found."""
    A, closed = closed_loop(plant, gain)
    P = find_held_loop(A.floats, closed.floats, law)
    return P if P is not None and prove_held_loop(A, closed, P.balls(), law) else None


def certificates(plant: Plant, gain: Gain, law: SamplingLaw, family: Interval, effort: int) -> list[Certificate]:
    """One for each statement that needs numbers: w*, LMI (15), the hull's weights, cones, the held loop, Theorem 2."""
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
    if family.tighten != "hull" and plant.n <= CONE_STATES:
        found += cones(plant, gain, law, views, cut=family.tighten == "intersect")
    if "K_lower" in gain:
        found += _held_loop(plant, gain, law, effort)
        if not assumption_3(views.exact.Q1) and plant.n <= _THEOREM_2_STATES:
            found += _theorem_2(plant, gain, views, law, effort)
    return found


def cones(plant: Plant, gain: Gain, law: SamplingLaw, views: Views, *, cut: bool) -> list[Certificate]:
    """A cone of errors at the law, where E(s) >= 0 does not hold there, and one at the longest period found."""
    limit = views.positivity
    if limit.proved is None:
        return []
    errors, found = error_system(plant, gain, views, cut=cut), []
    start: Exact | None = above(limit.proved) if limit.proved > 0 else None
    if not limit.holds_until(law.T_max.ball()):
        at_law = find_cone(errors, law)
        if at_law is not None:
            found.append(Certificate("cone", law, at_law.document()))
            start = law.T_max
    frontier = None if start is None else longest_cone(errors, law, start)
    if frontier is not None:
        found.append(Certificate("cone_frontier", frontier[0], frontier[1].document()))
    return found


def above(limit: Fraction) -> Exact:
    """The period just above the limit of E(s) >= 0 at which a cone is first looked for."""
    return Exact(decimal_text(limit * (1 + _ABOVE), 12))


def error_system(plant: Plant, gain: Gain, views: Views, *, cut: bool) -> ErrorSystem:
    """The errors with what drives them and what is cut of them."""
    rows = measured_rows(plant.C.balls(), gain["S"].balls()) if cut else {}
    return ErrorSystem.of(views.exact, *declared_widths(plant), tuple(rows))


def longest_cone(errors: ErrorSystem, law: SamplingLaw, start: Exact) -> tuple[SamplingLaw, Cone] | None:
    """The law with the largest period found from `start` on with a cone that is proved: the longest that floats find,
    and somewhat less until it is."""

    def likely(T: Exact) -> bool | None:
        return True if next(likely_cones(errors, law.with_period(T)), None) is not None else None

    found = largest_proved(likely, start, Exact(decimal_text(float(start) * _LONGER, 12)), _CONE_FRONTIER)
    if found is None:
        return None
    for less in (0, *_LESS):
        T = Exact(decimal_text((found[0].rational or Fraction(float(found[0]))) * (1 - less), 9)) if less else found[0]
        if float(T) < float(start):
            T = start
        cone = find_cone(errors, law.with_period(T))
        if cone is not None:
            return law.with_period(T), cone
    return None


def _lmi_15(views: Views, law: SamplingLaw) -> list[Certificate]:
    """The largest period with a proved solution of (15): it serves every smaller one."""
    limit = lmi_15_limit(views.exact)
    if limit is None or proved_w_star(views) is None:
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
