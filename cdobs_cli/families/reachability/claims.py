"""What is proved of a design, what is refuted, and the bounds: from the stored certificates, without a solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Bound, Certificate, Check, Claim
from cdobs_cli.certify import clock, common_quadratic, dead_beat, planar, polygon
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.certify.every_gain import period_lost_by_every_gain
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.linear import is_linear, stable_intervals
from cdobs_cli.certify.unseen import Unseen, unseen
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, text_below, upper_text
from cdobs_cli.families.reachability.continuous import REFERENCE, proves_reference
from cdobs_cli.families.reachability.escape import escapes
from cdobs_cli.families.reachability.observer import inclusion
from cdobs_cli.families.reachability.proof import METHOD, Constants, SetProof, constants, prove
from cdobs_cli.families.reachability.sets import box_holds, construction, inclusion_12, matrix_set, reachable_box, set_limit
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

CLOCK = "clock"
PLANAR = planar.METHOD
DEAD_BEAT = dead_beat.METHOD
SOURCES = {
    METHOD: "Dinh2014, Theorem II.2", CLOCK: "clock-dependent Lyapunov function", PLANAR: "extremals of the planar class, exact",
    DEAD_BEAT: "exact rational arithmetic",
}  # fmt: skip
# What each certificate of the rung `clock` shows, and how it was proved.
CLOCK_FORMS = {
    clock.METHOD: ("A clock-dependent e'P(tau)e decreases along flows and does not grow at jumps", "exact Bernstein coefficients"),
    clock.MONODROMY: ("The error of one period has a spectral radius below 1", "powers of the map in balls"),
    common_quadratic.METHOD: (
        "One form of the error just after a sample falls from each sample to the next",
        "Bernstein coefficients in balls",
    ),
    polygon.METHOD: ("Each sample maps a polygon of errors into itself", "Bernstein coefficients in balls"),
}


@dataclass(frozen=True)
class Judged:
    """A stored certificate and whether it is proved; `own` where it is about the design's gain."""

    certificate: Certificate
    method: str
    own: bool
    proved: bool
    set_proof: SetProof | None = None

    @property
    def T(self) -> Exact:
        return self.certificate.sampling.T_max

    @property
    def rate(self) -> arb:
        """A lower bound of the decay rate that the certificate proves."""
        if self.set_proof is not None:
            rho_squared = self.set_proof.rho_squared
            if not rho_squared:
                return arb("inf") if rho_squared == 0 else arb(0)
            return -fraction_ball(rho_squared).log() / (2 * self.T.ball())
        return clock.decay(self.certificate)


def certify(family: Reachability, plant: Plant, design: Design, effort: int) -> Check:
    """All claims about a design: premises and conclusion of Theorem II.2, the clock certificates, and where
    neither is proved a search for a counterexample.

    Source: Dinh2014, Theorem II.2
    """
    bounds: dict[str, Bound] = {}
    limit = set_limit(plant)
    if is_chain(plant) and plant.slopes.uncertain and family.method != CLOCK:
        low = lower_text(limit, 17) if limit.is_finite() else "inf" if limit > 0 else None
        high = upper_text(limit, 17) if limit.is_finite() else None
        bounds["delta_star"] = Bound(low, high, "s", "Dinh2014, Theorem III.2", "how long the box (31) holds")
    K = design.gain.get("K")
    law = design.sampling
    hidden = unseen(plant, law)
    if design.outcome == "none" or K is None or K.shape != (plant.n, plant.p):
        reason = design.reason or "the stored gain does not fit the plant"
        if hidden is None:
            return Check((_convergence("undecided", f"The error converges to 0: {reason}."),), bounds)
        statement = f"The error converges to 0: {hidden.sentence(plant)}."
        claim = _convergence("refuted", statement, method="unseen direction", witness=hidden.witness(plant))
        T = upper_text((hidden.period or law.T_max).ball(), 12)
        bounds["period_max_any_gain"] = Bound(None, T, "s", "unseen direction", "every gain refuted")
        return Check((claim,), bounds)
    judged = [_judge(family, plant, K, certificate) for certificate in design.certificates if certificate.method != REFERENCE]
    here = [item for item in judged if item.own and item.certificate.sampling == law]
    claims: list[Claim] = []
    for item in here:
        claims += _set_claims(family, plant, K, item, limit) if item.set_proof is not None else [_other_claim(item, law)]
    claims += _ladder_claims([item for item in judged if item not in here])
    claims += [_reference_claim(plant, certificate) for certificate in design.certificates if certificate.method == REFERENCE]
    if plant.sampling.is_periodic and not any(item.set_proof for item in here) and family.method != CLOCK:
        claims += [*_typed_inclusion(family, plant, law.T_max), _no_set_claim(law)]
    proofs = [item for item in here if item.proved]
    witness = None if proofs else hidden.witness(plant) if hidden is not None else refute(_closed(plant, K, law), effort)
    claims.insert(0, _conclusion(law, proofs, witness))
    claims += _hidden_claims(plant, hidden)
    bounds |= _bounds(family, plant, K, judged, law, effort)
    claims += _every_gain_claims(plant, K, judged, law, bounds, effort)
    claims += _interval_claims(_closed(plant, K, law))
    return Check(tuple(claims), bounds)


def _judge(family: Reachability, plant: Plant, K: ExactMatrix, certificate: Certificate) -> Judged:
    own = "K" not in certificate.data
    method = certificate.method if certificate.method in (METHOD, PLANAR, DEAD_BEAT) else CLOCK
    try:
        gain = K if own else ExactMatrix(certificate.data["K"])
    except (TypeError, ValueError, ExpressionError):
        return Judged(certificate, method, False, False)
    if gain.shape != K.shape:
        return Judged(certificate, method, False, False)
    if method == METHOD:
        proof = prove(family, plant, gain, certificate)
        return Judged(certificate, method, own, proof.holds, proof)
    prover = planar.prove if method == PLANAR else clock.prove
    return Judged(certificate, method, own, prover(_closed(plant, gain, certificate.sampling), certificate).proved)


def _closed(plant: Plant, K: ExactMatrix, law: SamplingLaw) -> HybridInclusion:
    return inclusion(replace(plant, sampling=law), {"K": K})


def _convergence(status: Any, statement: str, **more: Any) -> Claim:
    return Claim("convergence", "consequence", status, statement, "Dinh2014, Theorem II.2", required=True, **more)


def _conclusion(law: SamplingLaw, proofs: list[Judged], witness: Any) -> Claim:
    statement = f"The error converges to 0 for every slope history in the class, sampling {law.words}."
    if proofs:
        best = max(proofs, key=lambda item: float(item.rate.lower()))
        by = "set.contraction" if best.method == METHOD else best.method
        return _convergence("proved", statement, margin=lower_text(best.rate, 6) if best.rate > 0 else None, method=best.method, by=by)
    if witness is not None:
        method = "unseen direction" if witness.kind == "vector" else f"{witness.kind} slopes"
        return _convergence("refuted", statement, method=method, witness=witness)
    return _convergence("undecided", statement)


def _set_claims(family: Reachability, plant: Plant, K: ExactMatrix, item: Judged, limit: arb) -> list[Claim]:
    """The premises of Theorem II.2 one by one, and the paper's constants."""
    proof = item.set_proof
    assert proof is not None
    delta = proof.delta.ball()
    claims = []
    if plant.slopes.uncertain and limit.is_finite():
        claims.append(
            Claim("set.period", "premise", _status(proof.in_time), f"delta = {proof.delta} is at most delta_star, so the box (31) "
                  "holds every reachable error.", "Dinh2014, Theorem III.2", margin=lower_text(limit - delta, 6) if proof.in_time else None,
                  method="interval evaluation of the first zero")
        )  # fmt: skip
    claims.append(_inclusion_claim(family, plant, proof.delta, proof.inclusion and proof.in_time))
    letter, where = ("Q", "reduced to C e = 0, as C K = I") if proof.form == "reduced" else ("P", "with K fixed")
    claims.append(Claim("set.positive", "premise", _status(proof.positive), f"{letter} is positive definite.", "Dinh2014, Theorem II.2"))
    gap = None if proof.rho_squared is None else lower_text(fraction_ball(1 - proof.rho_squared), 6)
    claims.append(
        Claim("set.contraction", "certificate", _status(proof.holds),
              f"(13), {where}, holds at all {proof.members} matrices of the set that matter: V shrinks by rho^2 < 1 over each period.",
              "Dinh2014, Theorem II.2, (13)", margin=gap, method="pivots of LDL' in balls")
    )  # fmt: skip
    paper = constants(family, plant, K, item.certificate) if proof.holds else None
    if paper is not None:
        claims.append(_constants_claim(paper))
    return claims


def _constants_claim(paper: Constants) -> Claim:
    kappa, eta = lower_text(fraction_ball(paper.kappa), 6), upper_text(fraction_ball(paper.eta), 6)
    return Claim(
        "set.constants", "certificate", "proved",
        f"With P recovered from the certificate: e'Pe shrinks by 1 - kappa over each period, kappa >= {kappa}, and grows at most at the "
        f"rate eta <= {eta} between samples.",
        "Dinh2014, proof of Theorem II.2, (14)", margin=kappa, method="pivots of LDL' in balls",
    )  # fmt: skip


def _inclusion_claim(family: Reachability, plant: Plant, delta: Exact, proved: bool) -> Claim:
    """Proved, refuted by a slope history that leaves a typed set, or open."""
    why = f"{construction(plant)}."
    witness = None
    if family.set != "clarke":
        why = "the set is the typed one."
        boxes = None if proved else matrix_set(family, plant, delta)
        witness = None if boxes is None else escapes(plant, delta, boxes)
    status: Any = "refuted" if witness is not None else _status(proved)
    statement = f"At delta = {delta} every reachable error lies in Conv{{M e, M in the set}}: {why}"
    kind: Any = "premise" if family.set == "clarke" else "printed"
    return Claim("set.inclusion", kind, status, statement, "Dinh2014, Theorem II.2, (12)", witness=witness)


def _typed_inclusion(family: Reachability, plant: Plant, delta: Exact) -> list[Claim]:
    """The inclusion of a typed set for which no certificate is stored."""
    if family.set == "clarke":
        return []
    box, boxes = reachable_box(plant, delta.ball()), matrix_set(family, plant, delta)
    proved = box is not None and boxes is not None and inclusion_12(box, boxes) and box_holds(plant, delta.ball())
    return [_inclusion_claim(family, plant, delta, proved)]


def _no_set_claim(law: SamplingLaw) -> Claim:
    return Claim(
        "set.contraction", "certificate", "undecided", f"(13) holds over the set at {law.T_max}: no certificate was found.",
        "Dinh2014, Theorem II.2, (13)",
    )  # fmt: skip


def _other_claim(item: Judged, law: SamplingLaw) -> Claim:
    if item.method == PLANAR:
        statement = f"No slope history makes |e_2| after a jump as large as after the jump before, sampling {law.words}."
        return Claim(PLANAR, "certificate", _status(item.proved), statement, SOURCES[PLANAR], method="switching times enclosed in balls")
    if item.method == DEAD_BEAT:
        statement = f"Every error is 0 after finitely many samples, sampling {law.words}."
        return Claim(DEAD_BEAT, "certificate", _status(item.proved), statement, SOURCES[DEAD_BEAT], method="exact matrices")
    what, how = CLOCK_FORMS.get(item.certificate.method, CLOCK_FORMS[clock.METHOD])
    return Claim(
        CLOCK, "certificate", _status(item.proved), f"{what}, sampling {law.words}.", SOURCES[CLOCK],
        margin=lower_text(item.rate, 6) if item.proved and item.rate > 0 else None, method=how,
    )  # fmt: skip


def _hidden_claims(plant: Plant, hidden: Unseen | None) -> list[Claim]:
    """That no gain helps, where an error is never seen."""
    if hidden is None:
        return []
    statement = f"Every gain fails: {hidden.sentence(plant)}."
    return [Claim("every_gain", "certificate", "proved", statement, "exact rational arithmetic", method="unseen direction")]


def _ladder_claims(items: list[Judged]) -> list[Claim]:
    """One claim for each method and gain: the longest period, the proved ones first."""
    claims: dict[str, Claim] = {}
    for item in sorted(items, key=lambda item: (not item.proved, -float(item.T))):
        claim = _ladder_claim(item)
        claims.setdefault(claim.id, claim)
    return list(claims.values())


def _ladder_claim(item: Judged) -> Claim:
    whose = "This gain" if item.own else "Some gain"
    name = "period_max" if item.own else "period_max_any_gain"
    return Claim(
        f"{name}.{item.method}", "certificate", _status(item.proved), f"{whose} converges, sampling {item.certificate.sampling.words}.",
        SOURCES[item.method], method=item.method,
    )  # fmt: skip


def _reference_claim(plant: Plant, certificate: Certificate) -> Claim:
    return Claim(
        "continuous", "certificate", _status(proves_reference(plant, certificate)),
        "With y(t) measured all the time, one quadratic function serves every slope, so small periods are within reach (Proposition II.1).",
        "Dinh2014, Theorem II.1, (6)",
    )  # fmt: skip


def _status(proved: bool) -> Any:
    return "proved" if proved else "undecided"


def _bounds(family: Reachability, plant: Plant, K: ExactMatrix, judged: list[Judged], law: SamplingLaw, effort: int) -> dict[str, Bound]:
    bounds = {}
    proved = [item for item in judged if item.proved and item.certificate.sampling == law.with_period(item.T)]
    own = [item for item in proved if item.own]
    about = "this gain" + ("" if law.is_periodic else f", periods from {law.T_min}")
    for method in (METHOD, CLOCK, PLANAR):
        best = _longest([item for item in own if item.method == method])
        tried = {METHOD: law.is_periodic, CLOCK: all(item.method != PLANAR for item in own), PLANAR: False}[method]
        if best is not None or family.method == method or (family.method == "best" and tried):
            bounds[f"period_max.{method}"] = Bound(None if best is None else text_below(best.T), None, "s", method, about)
    best = _longest(own)
    if any(item.method == DEAD_BEAT for item in own) and dead_beat.resets(_closed(plant, K, law)):
        for name in ("period_max", "period_max_any_gain"):
            bounds[name] = Bound("inf", None, "s", DEAD_BEAT, "one sample erases every error, whatever the period")
    else:
        failing = smallest_refuted(lambda T: _closed(plant, K, law.with_period(T)), None if best is None else best.T, effort)
        refuted = None if failing is None else str(failing[0])
        bounds["period_max"] = Bound(None if best is None else text_below(best.T), refuted, "s", best.method if best else None, about)
        any_gain = _longest(proved)
        if any_gain is not None:
            bounds["period_max_any_gain"] = Bound(text_below(any_gain.T), None, "s", any_gain.method, "some gain")
    here = [item for item in own if item.certificate.sampling == law]
    here = [item for item in here if item.rate > 0]
    if here:
        fastest = max(here, key=lambda item: float(item.rate.lower()))
        bounds["decay_rate"] = Bound(lower_text(fastest.rate, 9), None, "1/s", fastest.method, "this gain at its period")
    return bounds


def _every_gain_claims(
    plant: Plant, K: ExactMatrix, judged: list[Judged], law: SamplingLaw, bounds: dict[str, Bound], effort: int
) -> list[Claim]:
    """Where the exact planar bound is proved for some gain: every gain fails just above it. Completes the bracket."""
    best = _longest([item for item in judged if item.proved and item.method == PLANAR])
    bound = bounds.get("period_max_any_gain")
    if best is None or bound is None:
        return []
    found = period_lost_by_every_gain(lambda T: _closed(plant, K, law.with_period(T)), best.T, effort)
    if found is None or float(found[0]) <= float(bound.proved or 0):
        return []
    T, refutation = found
    bounds["period_max_any_gain"] = replace(bound, refuted=str(T), about="some gain proved, every gain refuted")
    statement = (
        f"Every gain K fails at the constant period {T}: on each of {refutation.cells} cells of gains one of {refutation.words} words of "
        f"up to {refutation.longest} periods with extremal slopes has a spectral radius of at least 1."
    )
    return [Claim("period_max_any_gain.refuted", "certificate", "proved", statement, SOURCES[PLANAR], method="cells of gains in balls")]


def _interval_claims(closed: HybridInclusion) -> list[Claim]:
    """For a linear plant: the constant periods that this gain survives, lost and regained as they grow."""
    T = float(closed.sampling.T_max)
    intervals = stable_intervals(closed, T / 1000, 20 * T) if is_linear(closed) else []
    if not intervals:
        return []
    listed = ", ".join(f"[{interval.low}, {interval.high}]" for interval in intervals[:12])
    statement = f"The error converges at every constant period in {listed}."
    return [Claim("period_max.intervals", "certificate", "proved", statement, SOURCES[CLOCK], method="spectral radius, balls of periods")]


def _longest(items: list[Judged]) -> Judged | None:
    return max(items, key=lambda item: float(item.T), default=None)


def envelope(plant: Plant, design: Design, check: Check) -> Mapping[str, Any] | None:
    """|e(t)| <= factor |e(0)| exp(-rate t), from the set certificate: V after k periods is at most rho^(2k) V,
    and between samples |e| grows at most by exp(mu delta), mu the largest logarithmic norm of A + V."""
    import numpy as np

    from cdobs_cli.families.reachability.kernel import kernel
    from cdobs_cli.families.reachability.proof import slope_corners

    contraction = check.claim("set.contraction")
    if contraction is None or contraction.status != "proved" or len(plant.slopes.uncertain) > 10:
        return None
    certificate = next(c for c in design.certificates if c.method == METHOD and c.sampling == design.sampling and "K" not in c.data)
    delta = float(design.sampling.T_max)
    rho_squared = float(Fraction(certificate.data["rho_squared"]))
    if not 1e-12 < rho_squared < 1 or certificate.data["form"] != "reduced":
        return None
    space = kernel(plant.C)
    Q = ExactMatrix(certificate.data["Q"]).floats
    J = np.eye(plant.n) - design.gain["K"].floats @ plant.C.floats
    eigenvalues = np.linalg.eigvalsh(Q)
    mu = max(float(np.linalg.eigvalsh((R + R.T) / 2)[-1]) for R in (corner.floats for corner in slope_corners(plant)))
    rate = -np.log(rho_squared) / (2 * delta)
    grown = np.exp(max(mu, 0.0) * delta)
    kept = np.linalg.norm(space.N.floats, 2) * np.sqrt(eigenvalues[-1] / eigenvalues[0]) * np.linalg.norm(space.R.floats @ J, 2)
    # Twice the growth: the first jump may come a period late; exp(rate delta): the phase within a period.
    factor = max(grown, grown**2 * kept) * np.exp(2 * rate * delta) * (1 + 1e-9)
    return {"factor": float(factor), "rate": float(rate)} if np.isfinite(factor) else None
