"""Claims about feedback: the separation principle and Theorem 2's own condition."""

from __future__ import annotations

from typing import Any

from cdobs_cli.certificate import Bound, Status, Witness
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.exact.numbers import Exact, lower_text
from cdobs_cli.families.interval.analysis import SOURCE, Analysis, at_most, same_law
from cdobs_cli.families.interval.held_loop import closed_loop, held_inclusion, prove_held_loop, refute_held_loop
from cdobs_cli.families.interval.theorem_2 import Theorem2, gain_limit, observer_loop, prove_theorem_2, refute_theorem_2


def separation(a: Analysis) -> Status:
    """The held loop xdot = A x + B (K_lower + K_upper) S x(t_k), proved or refuted under the law."""
    source = f"{SOURCE}, (16), (17)"
    text = "Separation: the errors do not depend on u, and xdot = A x + B (K_lower + K_upper) S x(t_k) is stable"
    text += f" for every {a.law.symbols}"
    A, closed = closed_loop(a.plant, a.design.gain)
    proved_until: Exact | None = None
    frontier = a.matrix("held_loop_frontier", "P")
    if frontier is not None and same_law(frontier[0], a.law) and prove_held_loop(A, closed, frontier[1], frontier[0], a.effort):
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


def _multiplier(witness: Witness) -> str:
    """The eigenvalue where it is known, else its modulus."""
    if "eigenvalue" not in witness.data:
        return f"{witness.multiplier} in modulus"
    real, imaginary = witness.data["eigenvalue"]
    return str(real) if float(imaginary) == 0 else f"{real} +- {imaginary.lstrip('-')} i"


def theorem_2(a: Analysis) -> None:
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
    if proved is not None and proved[1].gamma.ball() < limit and at_most(a.law.T_max, proved[0]) and printed.status == "proved":
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
