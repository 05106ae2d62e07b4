"""Claims about feedback: the separation principle and Theorem 2's own condition."""

from __future__ import annotations

from cdobs_cli.certificate import Bound, Status, Witness
from cdobs_cli.exact.numbers import Exact, lower_text
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.held_loop import HeldLoop, HeldLoopLost, refute_held_loop
from cdobs_cli.families.interval.method import SOURCE
from cdobs_cli.families.interval.theorem_2 import Theorem2, gain_limit, refute_theorem_2


def separation(a: Analysis) -> Status:
    """The held loop xdot = A x + B (K_lower + K_upper) S x(t_k), proved or refuted under the law."""
    source = f"{SOURCE}, (16), (17)"
    text = "Separation: the errors do not depend on u, and xdot = A x + B (K_lower + K_upper) S x(t_k) is stable"
    text += f" for every {a.law.symbols}"
    proved_until = max(a.periods(HeldLoop), key=float, default=None)
    above = 0.0 if proved_until is None else float(proved_until)
    refuted = min((T for T in a.periods(HeldLoopLost) if float(T) > above), key=float, default=None)
    a.bounds["held_loop_period_max"] = Bound(
        None if proved_until is None else lower_text(proved_until.ball()), None if refuted is None else str(refuted),
        method="common quadratic function of x(t_k)", about="the plant with the feedback, without disturbance",
    )  # fmt: skip
    if a.own(HeldLoop) is not None:
        return a.say("separation", "certificate", "proved", text, source, method=HeldLoop.how)
    witness = refute_held_loop(a.question)
    if witness is None:
        return a.say("separation", "certificate", "undecided", text, source)
    loses = f"the held loop has the multiplier {_multiplier(witness)}: x diverges within its bounds"
    reason = f"with T_k = {witness.times[0]} throughout {loses}"
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
    source = f"{SOURCE}, Theorem 2"
    text = f"The conditions of Theorem 2 hold for Tbar = {a.law.T_max}"
    if a.system.structure:
        a.say("theorem_2", "printed", "undecided", f"{text}: they need Assumption 3", source)
        return
    limit = gain_limit(a.system)
    text += f": gamma < 1/(|C| mu) = {lower_text(limit, 6)}"
    gammas = {theorem.law.T_max: Exact(theorem.gamma) for theorem, _ in a.proved(Theorem2)}
    own = min((T for T in gammas if a.law.T_max.is_at_most(T)), key=float, default=None)
    if own is not None:
        text += f", proved gamma = {gammas[own]}"
    small = [T for T, gamma in gammas.items() if gamma.ball() < limit]
    if small:
        longest, about = lower_text(max(small, key=float).ball()), "the held loop, by a small gain"
        a.bounds["theorem_2_period_max"] = Bound(longest, method=Theorem2.how, about=about)
    if own in small and a.status("theorem_1_positivity") == "proved":
        a.say("theorem_2", "printed", "proved", text, source, margin=lower_text(limit - gammas[own].ball()))
        return
    witness = refute_theorem_2(a.system.loop, limit)
    if witness is not None:
        text += f"; a constant y alone has gain {witness.data['static_gain']}, so no solution exists"
        method = "static gain of the observer loop"
        a.say("theorem_2", "printed", "refuted", text, source, method=method, witness=witness)
        return
    separated = next(claim for claim in a.claims if claim.id == "separation")
    if separated.status == "refuted":
        text += "; no solution exists, since the state diverges under this law"
        method = "its conclusion is refuted"
        a.say("theorem_2", "printed", "refuted", text, source, method=method, witness=separated.witness)
    elif a.status("theorem_1_positivity") == "refuted":
        text += "; its condition on the injection fails"
        a.say("theorem_2", "printed", "refuted", text, source, method="printed condition evaluated")
    else:
        a.say("theorem_2", "printed", "undecided", text, source)
