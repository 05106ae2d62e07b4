"""What is claimed of an interval observer, proved again from the typed plant and the printed gain."""

from __future__ import annotations

from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.certificate import Bound, Check, Claim, Status, Witness
from cdobs_cli.design import Design
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.families.interval.analysis import SOURCE, Analysis, at_most, matrices, same_law
from cdobs_cli.families.interval.boundedness import Lmi15, lmi_15_limit, prove_lmi_15, refute_hurwitz
from cdobs_cli.families.interval.enclosure_claims import boundedness, positivity
from cdobs_cli.families.interval.feedback_claims import separation, theorem_2
from cdobs_cli.families.interval.hull import prove_hull, refute_hull
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.theorems import theorem_1_positivity
from cdobs_cli.families.interval.widths import final_widths
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval


def certify(family: Interval, plant: Plant, design: Design, effort: int) -> Check:
    """All claims and bounds; the consequence `convergence` is that the bounds contain the state and stay bounded.

    Source: Efimov2016, Theorem 1, Theorem 2
    """
    if design.outcome == "none":
        return Check((_convergence(design, "undecided", f"There is no observer: {design.reason or 'no design'}."),))
    missing = unlike_spec(family, design)
    if missing is not None:
        return Check((_convergence(design, "undecided", missing),))
    try:
        a = Analysis(family, plant, design, effort)
        a.z  # noqa: B018 - inverts S
    except (ZeroDivisionError, KeyError):
        return Check((_convergence(design, "undecided", "S has no inverse, so the bounds of x do not exist."),))
    parts = {"contraction": _hull(a)} if a.is_hull else _enclosure(a)
    if a.has_feedback:
        parts["separation"] = separation(a)
        theorem_2(a)
    _period_max(a, parts)
    final_widths(a, parts)
    return Check((*a.claims, _consequence(a, parts)), a.bounds)


def unlike_spec(family: Interval, design: Design) -> str | None:
    """Why a design is not one of this spec: given S, L and feedback are those of the design, and feedback is there
    exactly if it is asked for. None where nothing is wrong."""
    wanted = {} if family.gain is None else {"S": family.gain.S, "L": family.gain.L}
    if not isinstance(family.feedback, str):
        wanted |= {"K_lower": family.feedback.K_lower, "K_upper": family.feedback.K_upper}
    held = [name for name in ("K_lower", "K_upper") if name in design.gain]
    if family.feedback != "none" and len(held) < 2:
        return "The spec asks for feedback and the design holds none: nothing is claimed of it. Run synthesize again."
    if family.feedback == "none" and held:
        return "The design holds a feedback that the spec does not ask for: nothing is claimed of it. Run synthesize again."
    changed = [name for name, matrix in wanted.items() if design.gain.get(name) != matrix]
    if changed:
        return f"{' and '.join(changed)} of the design are not those given in the spec: nothing is claimed of it. Run synthesize again."
    return None


def _convergence(design: Design, status: Status, statement: str, by: str | None = None, witness: Witness | None = None) -> Claim:
    return Claim("convergence", "consequence", status, statement, f"{SOURCE}, Theorem 1", required=True, by=by, witness=witness)


def _consequence(a: Analysis, parts: dict[str, Status]) -> Claim:
    """Enclosure and boundedness from their parts."""
    inside = "x stays between its bounds" if a.is_hull else "z = S x, and with it x, stays between its bounds"
    what = f"{inside} from every box at the start, and the bounds stay bounded, for every sampling with {a.law.symbols}"
    what += _driven(a.plant)
    what += ", with the feedback in the loop" if a.has_feedback else " and every bounded x (Assumption 1)"
    failed = {name: next(claim for claim in a.claims if claim.id == name) for name, status in parts.items() if status == "refuted"}
    refuted = [name for name, claim in failed.items() if not _is_cut(a, claim.witness)]
    if refuted:
        claim = failed[refuted[0]]
        return _convergence(
            a.design, "refuted", f"{what}: refuted, {a.reasons.get(refuted[0], claim.statement)}", refuted[0], claim.witness
        )
    if a.departs and not a.is_hull:
        reason = "; ".join(a.structure[:3])
        return _convergence(a.design, "undecided", f"{what}: Assumption 3 fails for these S and L, {reason}")
    if all(status == "proved" for status in parts.values()):
        return _convergence(a.design, "proved", what, ", ".join(parts))
    open_parts = ", ".join(name for name, status in parts.items() if status != "proved")
    return _convergence(a.design, "undecided", f"{what}: open, because {open_parts} is")


def _driven(plant: Plant) -> str:
    """What acts on plant and measurement meanwhile."""
    declared = [name for name, box in (("disturbance", plant.disturbance), ("noise", plant.noise)) if box is not None]
    return f" and every {' and '.join(declared)} within the declared bounds" if declared else " without disturbance and noise"


def _is_cut(a: Analysis, witness: Witness | None) -> bool:
    """Whether a counterexample is a width of z in rows that the intersection with y cuts at every sample: it refutes
    the bounds without the intersection only."""
    if not a.cuts or witness is None:
        return False
    if "width" not in witness.data:
        return False
    rows = {i for i, text in enumerate(witness.data["width"]) if Exact(text).sign() != 0}
    return bool(rows & measured_rows(a.plant.C.balls(), a.z.S).keys())


def _enclosure(a: Analysis) -> dict[str, Status]:
    """Assumption 3, the printed conditions, and the exact ones."""
    kind = "printed" if a.design.outcome == "given" else "certificate"
    if a.structure:
        a.say("assumption_3", kind, "refuted", f"Assumption 3: {'; '.join(a.structure[:4])}", f"{SOURCE}, Assumption 3")
    else:
        text = "Assumption 3: -S L C S^-1 has the form [Q1bar 0; 0 0], its diagonal negative, the rest of Q1bar not negative"
        a.say("assumption_3", kind, "proved", text, f"{SOURCE}, Assumption 3")
    _printed_positivity(a)
    parts = {"positivity": positivity(a), "boundedness": boundedness(a)}
    _lmi_15(a)
    return parts


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


def _lmi_15(a: Analysis) -> None:
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
    if proved is not None and frontier is not None and at_most(a.law.T_max, frontier[0].sampling.T_max):
        a.say("lmi_15", "certificate", "proved", text, source, margin=lower_text(proved - a.T))
    elif (limit is not None and limit <= a.T) or refute_hurwitz(a.Mtot) is not None:
        a.say("lmi_15", "certificate", "refuted", text, source, method="no solution exists; that is no statement about the observer")
    else:
        a.say("lmi_15", "certificate", "undecided", text, source)


def _hull(a: Analysis) -> Status:
    """Positivity and boundedness for comparison, and the contraction that the predictor rests on."""
    # A design searched for the hull alone has no reason to meet the paper's conditions.
    compared = not a.structure or a.design.outcome != "found"
    if compared:
        _enclosure(a)
    exact = matrices(a)
    text = f"|S F(s) S^-1| contracts in one weighted norm for every {a.law.symbols}"
    stored = a.matrix("hull", "w")
    frontier = a.matrix("hull_frontier", "w")
    if frontier is not None and same_law(frontier[0], a.law) and prove_hull(*exact, frontier[1], frontier[0], a.effort):
        a.bounds["period_max.hull"] = Bound(lower_text(frontier[0].T_max.ball()), method="hull predictor")
    if stored is not None and stored[0] == a.law and prove_hull(*exact, stored[1], a.law, a.effort):
        return a.say("contraction", "certificate", "proved", text, method="weighted norm, ball arithmetic in s")
    if compared and a.ordered and a.hurwitz_rate is not None:
        text += "; it is never wider than the bounds without it, which are bounded"
        return a.say("contraction", "certificate", "proved", text, method="comparison with positivity and boundedness")
    witness = refute_hull(*exact, a.law)
    reason = None if witness is None else f"with T_k = {witness.times[0]} throughout the radius grows by {witness.multiplier} a sample"
    return a.say("contraction", "certificate", "undecided" if witness is None else "refuted", text, witness=witness, reason=reason)


def _period_max(a: Analysis, parts: dict[str, Status]) -> None:
    """The bracket of the largest period for this gain: enclosure, boundedness and the held loop together."""
    if "contraction" in parts:
        hull = a.bounds.pop("period_max.hull", None)
        lowest = [hull.proved if hull is not None else None]
        if lowest == [None] and parts["contraction"] == "proved":
            lowest = [lower_text(a.T)]
        highest: list[str | None] = []
    else:
        if a.departs or a.hurwitz_rate is None:
            a.bounds["period_max"] = Bound(method="positivity and boundedness")
            return
        lowest, highest = [_enclosed_and_bounded(a)], [a.bounds["positivity_period_max"].refuted]
    if "separation" in parts:
        held = a.bounds["held_loop_period_max"]
        lowest.append(held.proved)
        highest.append(held.refuted)
    known = [text for text in lowest if text is not None]
    proved = min(known, key=_size) if len(known) == len(lowest) else None
    refuted = min((text for text in highest if text is not None), key=_size, default=None)
    a.bounds["period_max"] = Bound(proved, refuted, method=" and ".join(parts))


def _enclosed_and_bounded(a: Analysis) -> str:
    """The largest period up to which the bounds enclose the state and stay bounded, without feedback; Mtot Hurwitz."""
    if a.limit.proved is None:
        return "inf"
    longest = fraction_ball(a.limit.proved)
    for T in a.enclosed_by_cones(bounded=True):
        longest = arb.max(longest, T.ball())
    return lower_text(longest)


def _size(text: str) -> float:
    return float(text)
