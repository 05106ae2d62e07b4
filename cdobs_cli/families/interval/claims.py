"""What is claimed of an interval observer, proved again from the typed plant and the printed gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from flint import arb

from cdobs_cli.certificate import Bound, Certificate, Check, Claim, Status, Witness
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, upper_text
from cdobs_cli.families.interval.boundedness import Lmi15, final_width, lmi_15_limit, prove_hurwitz, prove_lmi_15, refute_hurwitz
from cdobs_cli.families.interval.held_loop import closed_loop, held_inclusion, prove_held_loop, refute_held_loop
from cdobs_cli.families.interval.hull import hull_width, prove_hull, refute_hull
from cdobs_cli.families.interval.intersect import intersected_width, measured_rows
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.families.interval.positivity import PositivityLimit, positivity_limit
from cdobs_cli.families.interval.synthesis import declared_widths
from cdobs_cli.families.interval.theorem_2 import Theorem2, gain_limit, observer_loop, prove_theorem_2, refute_theorem_2
from cdobs_cli.families.interval.theorems import (
    Coordinates,
    assumption_3,
    coordinates,
    error_flow,
    error_held,
    theorem_1_positivity,
    width_matrix,
)
from cdobs_cli.plant import Plant, SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

T_ = TypeVar("T_")
SOURCE = "Efimov2016"


@dataclass
class Analysis:
    """One plant with one design: claims and bounds as they are decided.

    Everything is read from the typed plant, the printed gain and the stored certificates.
    """

    family: Interval
    plant: Plant
    design: Design
    effort: int
    claims: list[Claim] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    @property
    def law(self) -> SamplingLaw:
        return self.design.sampling

    @cached_property
    def T(self) -> arb:
        """The largest period of the law."""
        return self.law.T_max.ball()

    @cached_property
    def z(self) -> Coordinates[Matrix]:
        S, L = self.design.gain["S"].balls(), self.design.gain["L"].balls()
        return coordinates(self.plant.A.balls(), self.plant.C.balls(), S, S.inverse(), L)

    @cached_property
    def Mtot(self) -> Matrix:
        return width_matrix(self.z.Q0, self.z.Q1)

    @cached_property
    def limit(self) -> PositivityLimit:
        return positivity_limit(error_flow(self.z.Q0), error_held(self.z.Q1), self.effort)

    @cached_property
    def structure(self) -> tuple[str, ...]:
        return assumption_3(self.z.Q1)

    @property
    def departs(self) -> bool:
        """Whether given S and L are not those of the observer (12): then nothing is claimed in its name. (The
        proofs themselves couple whatever signs Q1 has, and serve found gains as they are.)"""
        return bool(self.structure) and self.design.outcome == "given"

    @property
    def has_feedback(self) -> bool:
        return "K_lower" in self.design.gain

    def certificate(self, method: str, read: Callable[[Certificate], T_]) -> tuple[Certificate, T_] | None:
        """The stored certificate of a method, read; None where there is none or it cannot be read."""
        for stored in self.design.certificates:
            if stored.method == method:
                try:
                    return stored, read(stored)
                except (KeyError, ValueError, TypeError, IndexError, ExpressionError):
                    return None
        return None

    def matrix(self, method: str, name: str) -> tuple[SamplingLaw, Matrix] | None:
        found = self.certificate(method, lambda stored: ExactMatrix(stored.data[name]).balls())
        return None if found is None else (found[0].sampling, found[1])

    def say(
        self, identifier: str, kind: Any, status: Status, statement: str, source: str = SOURCE, *,
        margin: str | None = None, method: str | None = None, witness: Witness | None = None, reason: str | None = None,
    ) -> Status:  # fmt: skip
        """Note a claim; `reason` says in a clause why it is refuted."""
        if reason is not None:
            self.reasons[identifier] = reason
            statement = f"{statement}; {reason}"
        self.claims.append(Claim(identifier, kind, status, statement, source, margin=margin, method=method, witness=witness))
        return status


def certify(family: Interval, plant: Plant, design: Design, effort: int) -> Check:
    """All claims and bounds; the consequence `convergence` is that the bounds contain the state and stay bounded.

    Source: Efimov2016, Theorem 1, Theorem 2
    """
    if design.outcome == "none":
        return Check((_convergence(design, "undecided", f"There is no observer: {design.reason or 'no design'}."),))
    try:
        a = Analysis(family, plant, design, effort)
        a.z  # noqa: B018 - inverts S
    except (ZeroDivisionError, KeyError):
        return Check((_convergence(design, "undecided", "S has no inverse, so the bounds of x do not exist."),))
    parts = {"contraction": _hull(a)} if family.tighten == "hull" else {"positivity": _positivity(a), "boundedness": _boundedness(a)}
    if a.has_feedback:
        parts["separation"] = _separation(a)
        _theorem_2(a)
    _period_max(a, parts)
    _final_width(a, parts)
    return Check((*a.claims, _consequence(a, parts)), a.bounds)


def _convergence(design: Design, status: Status, statement: str, by: str | None = None, witness: Witness | None = None) -> Claim:
    return Claim("convergence", "consequence", status, statement, f"{SOURCE}, Theorem 1", required=True, by=by, witness=witness)


def _consequence(a: Analysis, parts: dict[str, Status]) -> Claim:
    """Enclosure and boundedness from their parts."""
    inside = "x stays between its bounds" if a.family.tighten == "hull" else "z = S x, and with it x, stays between its bounds"
    what = f"{inside} from every box at the start, and the bounds stay bounded, for every sampling with {_periods(a.law)}"
    what += ", with the feedback in the loop" if a.has_feedback else " and every bounded x (Assumption 1)"
    refuted = [name for name, status in parts.items() if status == "refuted"]
    if refuted:
        claim = next(claim for claim in a.claims if claim.id == refuted[0])
        return _convergence(
            a.design, "refuted", f"{what}: refuted, {a.reasons.get(refuted[0], claim.statement)}", refuted[0], claim.witness
        )
    if a.departs and a.family.tighten != "hull":
        reason = "; ".join(a.structure[:3])
        return _convergence(a.design, "undecided", f"{what}: Assumption 3 fails for these S and L, {reason}")
    if all(status == "proved" for status in parts.values()):
        return _convergence(a.design, "proved", what, ", ".join(parts))
    open_parts = ", ".join(name for name, status in parts.items() if status != "proved")
    return _convergence(a.design, "undecided", f"{what}: open, because {open_parts} is")


def _periods(law: SamplingLaw) -> str:
    return f"T_k = {law.T_max}" if law.kind == "periodic" else f"T_k in [{law.T_min}, {law.T_max}]"


def _positivity(a: Analysis) -> Status:
    """Assumption 3, the printed condition, and the exact one."""
    kind = "printed" if a.design.outcome == "given" else "certificate"
    if a.structure:
        a.say("assumption_3", kind, "refuted", f"Assumption 3: {'; '.join(a.structure[:4])}", f"{SOURCE}, Assumption 3")
    else:
        text = "Assumption 3: -S L C S^-1 has the form [Q1bar 0; 0 0], its diagonal negative, the rest of Q1bar not negative"
        a.say("assumption_3", kind, "proved", text, f"{SOURCE}, Assumption 3")
    _printed_positivity(a)
    limit = a.limit
    proved = "inf" if limit.proved is None else lower_text(fraction_ball(limit.proved))
    refuted = None if limit.refuted is None else upper_text(fraction_ball(limit.refuted))
    a.bounds["positivity_period_max"] = Bound(proved, refuted, method="exact condition E(s) >= 0", about="every box of z(0)")
    text = f"E(s) >= 0 for 0 <= s <= {a.law.T_max}: z stays between its bounds from every box of z(0)"
    source, method = f"{SOURCE}, (11), (12)", "bisection in s, ball arithmetic"
    if limit.holds_until(a.T):
        margin = "inf" if limit.proved is None else lower_text(fraction_ball(limit.proved) - a.T)
        return a.say("positivity", "certificate", "proved", text, source, margin=margin, method=method)
    if limit.fails_before(a.T):
        assert limit.column is not None
        entry = limit.column % a.plant.n + 1
        reason = f"entry ({entry}, {entry}) of E is negative a time {refuted} after a sample"
        return a.say("positivity", "certificate", "refuted", text, source, method=method, witness=limit.witness, reason=reason)
    return a.say("positivity", "certificate", "undecided", text, source, method=method)


def _printed_positivity(a: Analysis) -> None:
    """q0 <= e q1 < q0 + 1/Tbar for the design's largest period, and its limit."""
    source = f"{SOURCE}, Theorem 1"
    least, longest = theorem_1_positivity(a.z.Q0, a.z.Q1)
    text = f"The printed condition q0 <= e q1 < q0 + 1/Tbar holds for Tbar = {a.law.T_max}"
    if a.structure or longest is None:
        a.say("theorem_1_positivity", "printed", "undecided", f"{text}: it needs Assumption 3", source)
        return
    a.bounds["positivity_period_max.theorem_1"] = Bound(
        lower_text(longest) if least >= 0 else None, method="printed sufficient condition", about="not attained"
    )
    status: Status = "proved" if least >= 0 and longest > a.T else "refuted" if least < 0 or longest <= a.T else "undecided"
    margin = lower_text(longest - a.T) if status == "proved" else None
    a.say("theorem_1_positivity", "printed", status, text, source, margin=margin)


def _boundedness(a: Analysis) -> Status:
    """Mtot Hurwitz, and the paper's LMI (15)."""
    stored = a.matrix("hurwitz", "w_star")
    rate = None
    if stored is not None and stored[1].shape == (a.plant.n, 1):
        rate = prove_hurwitz(a.Mtot, stored[1])
    text = "Mtot is Hurwitz: while the bounds hold, their width stays bounded for every sampling, and settles"
    witness = None
    if rate is not None:
        status = a.say("boundedness", "certificate", "proved", text, margin=lower_text(rate), method="w* > 0 with Mtot w* < 0")
    else:
        witness = refute_hurwitz(a.Mtot)
        status = "refuted" if witness is not None else "undecided"
        reason = None if witness is None else f"widths of z along ({', '.join(witness.data['width'])}) grow at rate {witness.data['rate']}"
        a.say("boundedness", "certificate", status, text, method="w >= 0 with Mtot w >= rate w", witness=witness, reason=reason)
    _lmi_15(a, status)
    return status


def _lmi_15(a: Analysis, boundedness: Status) -> None:
    source, text = f"{SOURCE}, Theorem 1, (15)", f"LMI (15) has a solution for Tbar = {a.law.T_max}"
    if a.structure:
        a.say("lmi_15", "certificate", "undecided", f"{text}: it needs Assumption 3", source)
        return
    frontier = a.certificate("lmi_15", lambda stored: Lmi15.from_document(stored.data))
    proved: arb | None = None
    if frontier is not None:
        T = frontier[0].sampling.T_max.ball()
        proved = T if prove_lmi_15(a.z, frontier[1], T) else None
    limit = lmi_15_limit(a.z)
    a.bounds["lmi_15_period_max"] = Bound(
        None if proved is None else lower_text(proved), None if limit is None else upper_text(limit),
        method="LMI (15)", about="boundedness only; refuted: (15) has no solution from there on",
    )  # fmt: skip
    if proved is not None and frontier is not None and _at_most(a.law.T_max, frontier[0].sampling.T_max):
        a.say("lmi_15", "certificate", "proved", text, source, margin=lower_text(proved - a.T))
    elif (limit is not None and limit <= a.T) or boundedness == "refuted":
        a.say("lmi_15", "certificate", "refuted", text, source, method="no solution exists; that is no statement about the observer")
    else:
        a.say("lmi_15", "certificate", "undecided", text, source)


def _hull(a: Analysis) -> Status:
    """Positivity and boundedness for comparison, and the contraction that the predictor rests on."""
    # A design searched for the hull alone has no reason to meet the paper's conditions.
    without = (None, None) if a.structure and a.design.outcome == "found" else (_positivity(a), _boundedness(a))
    exact = _matrices(a)
    text = f"|S F(s) S^-1| contracts in one weighted norm for every {_periods(a.law)}"
    stored = a.matrix("hull", "w")
    frontier = a.matrix("hull_frontier", "w")
    if frontier is not None and prove_hull(*exact, frontier[1], frontier[0], a.effort):
        a.bounds["period_max.hull"] = Bound(lower_text(frontier[0].T_max.ball()), method="hull predictor")
    if stored is not None and stored[0] == a.law and prove_hull(*exact, stored[1], a.law, a.effort):
        return a.say("contraction", "certificate", "proved", text, method="weighted norm, ball arithmetic in s")
    if without == ("proved", "proved"):
        text += "; it is never wider than the bounds without it, which are bounded"
        return a.say("contraction", "certificate", "proved", text, method="comparison with positivity and boundedness")
    witness = refute_hull(*exact, a.law)
    reason = None if witness is None else f"with T_k = {witness.times[0]} throughout the radius grows by {witness.multiplier} a sample"
    return a.say("contraction", "certificate", "undecided" if witness is None else "refuted", text, witness=witness, reason=reason)


def _matrices(a: Analysis) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    return a.plant.A.balls(), a.plant.C.balls(), a.z.S, a.z.R, a.design.gain["L"].balls()


def _separation(a: Analysis) -> Status:
    """The held loop xdot = A x + B (K_lower + K_upper) S x(t_k), proved or refuted under the law."""
    source = f"{SOURCE}, (16), (17)"
    text = (
        f"Separation: the errors do not depend on u, and xdot = A x + B (K_lower + K_upper) S x(t_k) is stable for every {_periods(a.law)}"
    )
    A, closed = closed_loop(a.plant, a.design.gain)
    proved_until: Exact | None = None
    frontier = a.matrix("held_loop_frontier", "P")
    if frontier is not None and _same_law(frontier[0], a.law) and prove_held_loop(A, closed, frontier[1], frontier[0], a.effort):
        proved_until = frontier[0].T_max
    stored = a.matrix("held_loop", "P")
    proved = stored is not None and stored[0] == a.law and prove_held_loop(A, closed, stored[1], a.law, a.effort)
    if proved and proved_until is None:
        proved_until = a.law.T_max
    refuted = smallest_refuted(lambda T: held_inclusion(a.plant, a.design.gain, a.law.with_period(T)), proved_until, a.effort)
    a.bounds["held_loop_period_max"] = Bound(
        None if proved_until is None else lower_text(proved_until.ball()), None if refuted is None else str(refuted[0]),
        method="common quadratic function of x(t_k)", about="the plant with the feedback, without disturbance",
    )  # fmt: skip
    if proved:
        return a.say("separation", "certificate", "proved", text, source, method="x' P x decreases from sample to sample")
    witness = refute_held_loop(a.plant, a.design.gain, a.law, a.effort)
    if witness is None:
        return a.say("separation", "certificate", "undecided", text, source)
    reason = (
        f"with T_k = {witness.times[0]} throughout the held loop has the multiplier {_multiplier(witness)}: x diverges within its bounds"
    )
    method = "eigenvalue of the sampled loop"
    return a.say("separation", "certificate", "refuted", text, source, method=method, witness=witness, reason=reason)


def _at_most(one: Exact, other: Exact) -> bool:
    """Whether one <= other is certain."""
    return one == other or (other - one).sign() in (0, 1)


def _multiplier(witness: Witness) -> str:
    """The eigenvalue where it is known, else its modulus."""
    if "eigenvalue" not in witness.data:
        return f"{witness.multiplier} in modulus"
    real, imaginary = witness.data["eigenvalue"]
    return str(real) if float(imaginary) == 0 else f"{real} +- {imaginary.lstrip('-')} i"


def _same_law(one: SamplingLaw, other: SamplingLaw) -> bool:
    return one == other.with_period(one.T_max)


def _theorem_2(a: Analysis) -> None:
    """Theorem 2's own condition for the given gains: gamma against 1/(|C| mu)."""
    assert a.plant.B is not None
    source = f"{SOURCE}, Theorem 2"
    text = f"The conditions of Theorem 2 hold for Tbar = {a.law.T_max}"
    if a.structure:
        a.say("theorem_2", "printed", "undecided", f"{text}: they need Assumption 3", source)
        return
    K = a.design.gain["K_lower"].balls(), a.design.gain["K_upper"].balls()
    loop = observer_loop(a.z, a.z.S @ a.plant.B.balls(), *K)
    limit = gain_limit(a.z, a.plant.C.balls())
    text += f": gamma < 1/(|C| mu) = {lower_text(limit, 6)}"
    proved = _theorem_2_at(a, loop, "theorem_2")
    if proved is not None:
        text += f", proved gamma = {proved[1].gamma}"
    frontier = _theorem_2_at(a, loop, "theorem_2_frontier")
    if frontier is not None and frontier[1].gamma.ball() < limit:
        a.bounds["theorem_2_period_max"] = Bound(lower_text(frontier[0].ball()), method="Theorem 2", about="the held loop, by a small gain")
    printed = next(claim for claim in a.claims if claim.id == "theorem_1_positivity")
    if proved is not None and proved[1].gamma.ball() < limit and _at_most(a.law.T_max, proved[0]) and printed.status == "proved":
        a.say("theorem_2", "printed", "proved", text, source, margin=lower_text(limit - proved[1].gamma.ball()))
        return
    witness = refute_theorem_2(loop, limit)
    if witness is not None:
        text += f"; a constant y alone has gain {witness.data['static_gain']}, so no solution exists"
        a.say("theorem_2", "printed", "refuted", text, source, method="static gain of the observer loop", witness=witness)
        return
    separation = next(claim for claim in a.claims if claim.id == "separation")
    if separation.status == "refuted":
        text += "; no solution exists, since the state diverges under this law"
        a.say("theorem_2", "printed", "refuted", text, source, method="its conclusion is refuted", witness=separation.witness)
    elif printed.status == "refuted":
        text += "; its condition on the injection fails"
        a.say("theorem_2", "printed", "refuted", text, source, method="printed condition evaluated")
    else:
        a.say("theorem_2", "printed", "undecided", text, source)


def _theorem_2_at(a: Analysis, loop: Any, method: str) -> tuple[Exact, Theorem2] | None:
    found = a.certificate(method, lambda stored: Theorem2.from_document(stored.data))
    if found is None:
        return None
    T = found[0].sampling.T_max
    return (T, found[1]) if prove_theorem_2(loop, found[1], T.ball()) else None


def _period_max(a: Analysis, parts: dict[str, Status]) -> None:
    """The bracket of the largest period for this gain: enclosure, boundedness and the held loop together."""
    if "contraction" in parts:
        hull = a.bounds.pop("period_max.hull", None)
        lowest = [hull.proved if hull is not None else None]
        if lowest == [None] and parts["contraction"] == "proved":
            lowest = [lower_text(a.T)]
        highest: list[str | None] = []
    else:
        if parts["boundedness"] != "proved" or a.departs:
            a.bounds["period_max"] = Bound(method="positivity and boundedness")
            return
        positivity = a.bounds["positivity_period_max"]
        lowest, highest = [positivity.proved], [positivity.refuted]
        if a.family.tighten == "intersect":
            highest = []  # a unit error in a measured row may be cut by the next measurement
    if "separation" in parts:
        held = a.bounds["held_loop_period_max"]
        lowest.append(held.proved)
        highest.append(held.refuted)
    known = [text for text in lowest if text is not None]
    proved = min(known, key=_size) if len(known) == len(lowest) else None
    refuted = min((text for text in highest if text is not None), key=_size, default=None)
    a.bounds["period_max"] = Bound(proved, refuted, method=" and ".join(parts))


def _size(text: str) -> float:
    return float(text)


def _final_width(a: Analysis, parts: dict[str, Status]) -> None:
    """Where the widths of x settle under the declared disturbance and noise: in all, and for each state."""
    disturbance, noise = declared_widths(a.plant)
    exact = parts.get("boundedness") == "proved"
    widths: Matrix | None = None
    method = "closed form"
    if "contraction" in parts:
        exact, method = False, "hull predictor, at any time"
        stored = a.matrix("hull", "w")
        if stored is not None and parts["contraction"] == "proved" and stored[0] == a.law:
            widths = hull_width(*_matrices(a), stored[1], disturbance, noise, a.law, bounded_width(a, disturbance, noise))
    elif exact:
        if a.family.tighten == "intersect":
            widths, exact, method = intersect_width(a, disturbance, noise), False, "intersection, at any time"
        else:
            widths = final_width(a.z, a.Mtot, disturbance, noise)
    if widths is None:
        return
    values = [arb(widths[i, 0]) for i in range(a.plant.n)]
    rows = {"final_width": sum(values[1:], values[0])} | {
        f"final_width.{name}": value for name, value in zip(a.plant.states, values, strict=True)
    }
    for name, value in rows.items():
        about = "sum over the states" if name == "final_width" else None
        a.bounds[name] = Bound(upper_text(value), lower_text(value) if exact else None, unit="", method=method, about=about)


def bounded_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix | None:
    """The final width of z by positivity and boundedness, where both are proved for the law."""
    statuses = {claim.id: claim.status for claim in a.claims}
    if statuses.get("positivity") != "proved" or statuses.get("boundedness") != "proved":
        return None
    return (-a.Mtot).solve(absolute(a.z.S) @ disturbance + absolute(a.z.SL) @ noise)


def intersect_width(a: Analysis, disturbance: Matrix, noise: Matrix) -> Matrix:
    """|S^-1| times the final width of z with measured rows cut at samples."""
    from cdobs_cli.families.interval.held_loop import law_ends

    c = absolute(a.z.S) @ disturbance + absolute(a.z.SL) @ noise
    w = (-a.Mtot).solve(c)
    rows = measured_rows(a.plant.C.balls(), a.z.S)
    return absolute(a.z.R) @ intersected_width(a.z, rows, w, c, noise, law_ends(a.law)[1])


def comparison(family: Interval, plant: Plant, design: Design) -> dict[str, Matrix]:
    """Proved final widths of x for each way to tighten the bounds of one design, where they are proved."""
    disturbance, noise = declared_widths(plant)
    a = Analysis(family, plant, design, 0)
    found: dict[str, Matrix] = {}
    if (_positivity(a), _boundedness(a)) == ("proved", "proved") and not a.departs:
        found["none"] = final_width(a.z, a.Mtot, disturbance, noise)
        found["intersect"] = intersect_width(a, disturbance, noise)
    stored = a.matrix("hull", "w")
    if stored is not None and stored[0] == a.law and prove_hull(*_matrices(a), stored[1], a.law):
        widths = hull_width(*_matrices(a), stored[1], disturbance, noise, a.law, bounded_width(a, disturbance, noise))
        if widths is not None:
            found["hull"] = widths
    return found
