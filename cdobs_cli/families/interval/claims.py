"""What is claimed of an interval observer, proved again from the typed plant and the printed gain."""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.certificate import CONVERGENCE, Bound, Check, Claim, Status, Witness
from cdobs_cli.design import Design
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.enclosure_claims import boundedness, positivity
from cdobs_cli.families.interval.feedback_claims import separation, theorem_2
from cdobs_cli.families.interval.hull import Hull, refute_hull
from cdobs_cli.families.interval.hurwitz import refute_hurwitz
from cdobs_cli.families.interval.lmi_15 import Lmi15, lmi_15_limit
from cdobs_cli.families.interval.method import SOURCE
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
        return Check((_convergence("undecided", f"There is no observer: {design.reason or 'no design'}."),))
    missing = unlike_spec(family, design)
    if missing is not None:
        return Check((_convergence("undecided", missing),))
    try:
        a = Analysis(family, plant, design, effort)
        a.system.z  # noqa: B018 - inverts S
    except (ZeroDivisionError, KeyError):
        return Check((_convergence("undecided", "S has no inverse, so the bounds of x do not exist."),))
    parts = {"contraction": _hull(a)} if a.is_hull else _enclosure(a)
    if "K_lower" in design.gain:
        parts["separation"] = separation(a)
        theorem_2(a)
    _period_max(a, parts)
    final_widths(a, parts)
    return Check((*a.claims, _consequence(a, parts)), a.bounds)


def unlike_spec(family: Interval, design: Design) -> str | None:
    """Why a design is not one of this spec: given S, L and feedback are those of the design, and feedback is there
    exactly if it is asked for. None where nothing is wrong."""
    wanted = {name: matrix for name, matrix in family.given().items() if matrix is not None}
    held = [name for name in ("K_lower", "K_upper") if name in design.gain]
    changed = [name for name, matrix in wanted.items() if design.gain.get(name) != matrix]
    if family.feedback != "none" and len(held) < 2:
        why = "The spec asks for feedback and the design holds none"
    elif family.feedback == "none" and held:
        why = "The design holds a feedback that the spec does not ask for"
    elif changed:
        why = f"{' and '.join(changed)} of the design are not those given in the spec"
    else:
        return None
    return f"{why}: nothing is claimed of it. Run synthesize again."


def _convergence(status: Status, statement: str, by: str | None = None, witness: Witness | None = None) -> Claim:
    source = f"{SOURCE}, Theorem 1"
    return Claim(CONVERGENCE, "consequence", status, statement, source, required=True, by=by, witness=witness)


def _consequence(a: Analysis, parts: dict[str, Status]) -> Claim:
    """Enclosure and boundedness from their parts."""
    inside = "x stays between its bounds" if a.is_hull else "z = S x, and with it x, stays between its bounds"
    what = f"{inside} from every box at the start, and the bounds stay bounded, for every sampling with {a.law.symbols}"
    what += _driven(a.plant)
    what += ", with the feedback in the loop" if "separation" in parts else " and every bounded x (Assumption 1)"
    failed = [claim for claim in a.claims if parts.get(claim.id) == "refuted" and not _is_cut(a, claim.witness)]
    if failed:
        return _convergence("refuted", f"{what}; {a.reasons[failed[0].id]}", failed[0].id, failed[0].witness)
    if a.departs and not a.is_hull:
        reason = "; ".join(a.system.structure[:3])
        return _convergence("undecided", f"{what}: Assumption 3 fails for these S and L, {reason}")
    if all(status == "proved" for status in parts.values()):
        return _convergence("proved", what, ", ".join(parts))
    open_parts = ", ".join(name for name, status in parts.items() if status != "proved")
    return _convergence("undecided", f"{what}: open, because {open_parts} is")


def _driven(plant: Plant) -> str:
    """What acts on plant and measurement meanwhile."""
    declared = [name for name, box in (("disturbance", plant.disturbance), ("noise", plant.noise)) if box is not None]
    if not declared:
        return " without disturbance and noise"
    return f" and every {' and '.join(declared)} within the declared bounds"


def _is_cut(a: Analysis, witness: Witness | None) -> bool:
    """Whether a counterexample is a width of z in rows that the intersection with y cuts at every sample: it refutes
    the bounds without the intersection only."""
    if witness is None or "width" not in witness.data:
        return False
    rows = {i for i, text in enumerate(witness.data["width"]) if Exact(text).sign() != 0}
    return bool(rows & a.system.cut_rows.keys())


def _enclosure(a: Analysis) -> dict[str, Status]:
    """Assumption 3, the printed conditions, and the exact ones."""
    kind = "printed" if a.design.outcome == "given" else "certificate"
    status: Status
    if a.system.structure:
        status, text = "refuted", "; ".join(a.system.structure[:4])
    else:
        form = "-S L C S^-1 has the form [Q1bar 0; 0 0]"
        status, text = "proved", f"{form}, its diagonal negative, the rest of Q1bar not negative"
    a.say("assumption_3", kind, status, f"Assumption 3: {text}", f"{SOURCE}, Assumption 3")
    _printed_positivity(a)
    parts = {"positivity": positivity(a), "boundedness": boundedness(a)}
    _lmi_15(a)
    return parts


def _printed_positivity(a: Analysis) -> None:
    """q0 <= e q1 < q0 + 1/Tbar for the design's largest period, and its limit."""
    source = f"{SOURCE}, Theorem 1"
    least, longest = theorem_1_positivity(a.system.z.Q0, a.system.z.Q1)
    text = f"The printed condition q0 <= e q1 < q0 + 1/Tbar holds for Tbar = {a.law.T_max}"
    if a.system.structure or longest is None:
        a.say("theorem_1_positivity", "printed", "undecided", f"{text}: it needs Assumption 3", source)
        return
    a.bounds["positivity_period_max.theorem_1"] = Bound(
        lower_text(longest) if least >= 0 else None, method="printed sufficient condition", about="not attained"
    )
    fails = least < 0 or longest <= a.T
    status: Status = "proved" if least >= 0 and longest > a.T else "refuted" if fails else "undecided"
    margin = lower_text(longest - a.T) if status == "proved" else None
    a.say("theorem_1_positivity", "printed", status, text, source, margin=margin)


def _lmi_15(a: Analysis) -> None:
    source, text = f"{SOURCE}, Theorem 1, (15)", f"LMI (15) has a solution for Tbar = {a.law.T_max}"
    if a.system.structure:
        a.say("lmi_15", "certificate", "undecided", f"{text}: it needs Assumption 3", source)
        return
    longest = max((lmi.law.T_max for lmi, _ in a.proved(Lmi15)), key=float, default=None)
    limit = lmi_15_limit(a.system.z)
    a.bounds["lmi_15_period_max"] = Bound(
        None if longest is None else lower_text(longest.ball()), None if limit is None else upper_text(limit),
        method=Lmi15.how, about="boundedness only; refuted: (15) has no solution from there on",
    )  # fmt: skip
    if longest is not None and a.law.T_max.is_at_most(longest):
        a.say("lmi_15", "certificate", "proved", text, source, margin=lower_text(longest.ball() - a.T))
    elif (limit is not None and limit <= a.T) or refute_hurwitz(a.system.Mtot) is not None:
        method = "no solution exists; that is no statement about the observer"
        a.say("lmi_15", "certificate", "refuted", text, source, method=method)
    else:
        a.say("lmi_15", "certificate", "undecided", text, source)


def _hull(a: Analysis) -> Status:
    """Positivity and boundedness for comparison, and the contraction that the predictor rests on."""
    # A design searched for the hull alone has no reason to meet the paper's conditions.
    compared = not a.system.structure or a.design.outcome != "found"
    if compared:
        _enclosure(a)
    text = f"|S F(s) S^-1| contracts in one weighted norm for every {a.law.symbols}"
    if a.own(Hull) is not None:
        return a.say("contraction", "certificate", "proved", text, method=Hull.how)
    if compared and a.ordered and a.hurwitz_rate is not None:
        text += "; it is never wider than the bounds without it, which are bounded"
        return a.say("contraction", "certificate", "proved", text, method="comparison with positivity and boundedness")
    witness = refute_hull(a.system, a.law)
    if witness is None:
        return a.say("contraction", "certificate", "undecided", text)
    reason = f"with T_k = {witness.times[0]} throughout the radius grows by {witness.multiplier} a sample"
    return a.say("contraction", "certificate", "refuted", text, witness=witness, reason=reason)


def _period_max(a: Analysis, parts: dict[str, Status]) -> None:
    """The bracket of the largest period for this gain: enclosure, boundedness and the held loop together."""
    if "contraction" in parts:
        periods = [T.ball() for T in a.periods(Hull)] + ([a.T] if parts["contraction"] == "proved" else [])
        lowest, highest = [lower_text(max(periods, key=float)) if periods else None], list[str | None]()
    elif a.departs or a.hurwitz_rate is None:
        a.bounds["period_max"] = Bound(method="positivity and boundedness")
        return
    else:
        lowest, highest = [_enclosed_and_bounded(a)], [a.bounds["positivity_period_max"].refuted]
    if "separation" in parts:
        held = a.bounds["held_loop_period_max"]
        lowest.append(held.proved)
        highest.append(held.refuted)
    known = [text for text in lowest if text is not None]
    proved = min(known, key=float) if len(known) == len(lowest) else None
    refuted = min((text for text in highest if text is not None), key=float, default=None)
    a.bounds["period_max"] = Bound(proved, refuted, method=" and ".join(parts))


def _enclosed_and_bounded(a: Analysis) -> str:
    """The largest period up to which the bounds enclose the state and stay bounded, without feedback; Mtot Hurwitz."""
    if a.system.limit.proved is None:
        return "inf"
    periods = (T.ball() for T in a.enclosed_by_cones(bounded=True))
    return lower_text(reduce(arb.max, periods, fraction_ball(a.system.limit.proved)))
