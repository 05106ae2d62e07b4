"""What `check` says: stored certificates proved again, printed data put to the test, counterexamples, bounds."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Bound, Certificate, Check, Claim, Status, Witness
from cdobs_cli.certify import clock
from cdobs_cli.certify.ball import spectral_radius_lower
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.unseen import Unseen, unseen
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, text_below, upper_text
from cdobs_cli.families.lpv_zoh import any_gain, printed, printed_search, repaired, wirtinger
from cdobs_cli.families.lpv_zoh.laws import DOWN_TO_ZERO, at_period, covers
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.families.lpv_zoh.theorems import vertices_25
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold

CONVERGENCE = "convergence"
METHODS = ("wirtinger", "clock", "repaired")
_SOURCES = {
    "wirtinger": "LiuFridman2012, Wirtinger's inequality for the held error, with a slope box and a rate",
    "clock": "clock-dependent quadratic function",
    "spectral_radius": "spectral radius of the sampled error",
    "common_quadratic": "form of the sampled error that falls at every sample",
    "polygon": "polygon of sampled errors that every sample maps into itself",
    "dead_beat": "nilpotent map of the sampled error",
    "repaired": "Boukal2020, Theorem 1, with its proof repaired",
}


@dataclass(frozen=True)
class Proved:
    """A stored certificate that was proved again: the rate it gives |e|, and its margin where one is known."""

    certificate: Certificate
    rate: arb
    margin: Fraction | None

    @property
    def family(self) -> str:
        """Its rung of the ladder of methods."""
        return "clock" if self.certificate.method in clock.METHODS else self.certificate.method

    @property
    def T(self) -> Exact:
        return self.certificate.sampling.T_max


def reprove(plant: Plant, L: ExactMatrix, certificate: Certificate) -> Proved | None:
    """The certificate for this plant and gain, proved from its stored decimals; None where that fails."""
    try:
        if certificate.method == wirtinger.METHOD:
            result = wirtinger.prove(plant, L, certificate)
            rate = Exact(certificate.data["sigma"]).ball()
        elif certificate.method == repaired.METHOD:
            result = repaired.prove(plant, L, certificate)
            rate = repaired.rate(certificate)
        elif certificate.method in clock.METHODS:
            result = clock.prove(inclusion(plant, {"L": L}), certificate)
            rate = clock.decay(certificate)
        else:
            return None
    except (KeyError, ValueError, TypeError, IndexError, ZeroDivisionError, ExpressionError):
        return None
    return Proved(certificate, rate, result.margin) if result.proved else None


def certify(family: LpvZeroOrderHold, plant: Plant, design: Design, effort: int) -> Check:
    """All claims and bounds of the design, under the law it is for."""
    law = design.sampling
    plant = at_period(plant, law.T_max)
    nobody = [c for c in design.certificates if c.method == any_gain.METHOD and _no_gain(plant, c)]
    any_bound = _any_gain_bound([c for c in nobody if law.with_period(c.sampling.T_max).contains(c.sampling)])
    hidden = unseen(plant)
    if design.outcome == "none":
        defeated = next((c for c in nobody if law.contains(c.sampling)), None)
        status: Status = "refuted" if defeated is not None or hidden is not None else "undecided"
        reason = "no gain survives this sampling law" if defeated is not None else design.reason or "no gain was found"
        witness = Witness("vector", "class", data=dict(defeated.data)) if defeated is not None else None
        if hidden is not None:
            reason, witness = hidden.sentence(plant), hidden.witness(plant)
            T = _above(hidden.period or law.T_max)
            if any_bound is None or any_bound.refuted is None or float(T) < float(any_bound.refuted):
                any_bound = Bound(None, T, method="unseen direction", about=witness.about)
        claim = Claim(CONVERGENCE, "consequence", status, f"The error converges: {reason}.", family.source, required=True, witness=witness)
        return Check((claim,), {"period_max_any_gain": any_bound} if any_bound else {})
    L = design.gain["L"]
    claims: list[Claim] = []
    proofs: list[Proved] = []
    others: list[Proved] = []  # about gains met on the way
    for certificate in design.certificates:
        if "L" in certificate.data:
            proof = _of_another_gain(plant, L, certificate)
            others += [proof] if proof is not None else []
        elif certificate.method not in (any_gain.METHOD, printed_search.METHOD):
            proof = reprove(plant, L, certificate)
            claims.append(_certificate_claim(certificate, proof, claims))
            proofs += [proof] if proof is not None else []
    convergence = _convergence(plant, L, proofs, effort, hidden)
    if hidden is not None:
        statement = f"Every gain fails: {hidden.sentence(plant)}"
        claims.append(Claim("every_gain", "certificate", "proved", statement, "exact rational arithmetic", method="unseen direction"))
    bounds = _bounds(plant, L, proofs, effort)
    claims += [_other_claim(proof) for proof in others]
    some = max((proof for proof in (*proofs, *others) if _usable(proof, plant)), key=lambda proof: float(proof.T), default=None)
    if any_bound is not None or some is not None or "period_max" in bounds:
        best = text_below(some.T) if some is not None else None
        refuted, about = (any_bound.refuted, any_bound.about) if any_bound is not None else (None, "class")
        bounds["period_max_any_gain"] = Bound(best, refuted, method=any_gain.METHOD if refuted else None, about=about)
    printed_claims, printed_bounds = _printed(family, plant, design, L)
    return Check((convergence, *claims, *printed_claims), bounds | printed_bounds)


def _of_another_gain(plant: Plant, L: ExactMatrix, certificate: Certificate) -> Proved | None:
    try:
        other = ExactMatrix(certificate.data["L"])
    except (TypeError, ValueError, ExpressionError):
        return None
    return reprove(plant, other, certificate) if other.shape == L.shape else None


def _other_claim(proof: Proved) -> Claim:
    statement = f"Some gain converges for {_periods(proof.certificate)}"
    method = proof.certificate.method
    return Claim(f"period_max_any_gain.{proof.family}", "certificate", "proved", statement, _SOURCES.get(method, method), method=method)


def _usable(proof: Proved, plant: Plant) -> bool:
    """A proof for the plant's law at some period."""
    return covers(proof.certificate, plant.sampling.with_period(proof.T))


def _periods(certificate: Certificate) -> str:
    method, law = certificate.method, certificate.sampling
    if method in DOWN_TO_ZERO or law.from_zero:
        return f"every T_k <= {law.T_max}"
    return law.symbols


def _no_gain(plant: Plant, certificate: Certificate) -> bool:
    try:
        return any_gain.prove(plant, certificate)
    except (KeyError, ValueError, TypeError, ExpressionError):
        return False


def _any_gain_bound(nobody: list[Certificate]) -> Bound | None:
    if not nobody:
        return None
    least = min((certificate.sampling.T_max for certificate in nobody), key=float)
    return Bound(None, _above(least), method=any_gain.METHOD, about="class")


def _certificate_claim(certificate: Certificate, proof: Proved | None, before: list[Claim]) -> Claim:
    method, periods = certificate.method, _periods(certificate)
    rate = f" at rate {lower_text(proof.rate, 6)}" if proof is not None and proof.rate > 0 else ""
    number = sum(claim.id.split(".")[0] == method for claim in before)
    return Claim(
        f"{method}.{number + 1}", "certificate", "proved" if proof is not None else "undecided",
        f"For {periods} the error of the whole slope class converges{rate}", _SOURCES.get(method, method),
        margin=lower_text(Exact(proof.margin).ball(), 6) if proof is not None and proof.margin is not None else None, method=method,
    )  # fmt: skip


def _convergence(plant: Plant, L: ExactMatrix, proofs: list[Proved], effort: int, hidden: Unseen | None) -> Claim:
    """The one required claim: proved by a certificate that covers the law, else refuted by a counterexample."""
    law = plant.sampling
    statement = f"The error converges to 0 for {law.symbols} and every plant of the slope class"
    source = "Boukal2020, (24)"
    covering = [proof for proof in proofs if covers(proof.certificate, law)]
    if covering:
        best = max(covering, key=lambda proof: float(proof.rate.mid()))
        margin = lower_text(best.rate, 9)
        return Claim(CONVERGENCE, "consequence", "proved", statement, source, True, margin, best.certificate.method, best.family)
    witness = hidden.witness(plant) if hidden is not None else refute(inclusion(plant, {"L": L}), effort)
    status: Status = "refuted" if witness is not None else "undecided"
    return Claim(CONVERGENCE, "consequence", status, statement, source, True, witness=witness)


def _bounds(plant: Plant, L: ExactMatrix, proofs: list[Proved], effort: int) -> dict[str, Bound]:
    """The bracket of the period with its ladder of methods, and the rate under the law designed for."""

    def longest(group: list[Proved]) -> Proved | None:
        return max(group, key=lambda proof: float(proof.T), default=None)

    best = longest([proof for proof in proofs if _usable(proof, plant)])
    refuted = smallest_refuted(lambda T: inclusion(at_period(plant, T), {"L": L}), best.T if best else None, effort)
    upper = _above(refuted[0]) if refuted else None
    bounds: dict[str, Bound] = {}
    if best is not None or upper is not None:
        bounds["period_max"] = Bound(text_below(best.T) if best else None, upper, method=best.family if best else None, about="class")
    for method in METHODS:
        rung = longest([proof for proof in proofs if proof.family == method and _usable(proof, plant)])
        if rung is not None:
            bounds[f"period_max.{method}"] = Bound(text_below(rung.T), upper, method=method, about="class")
    covering = [proof for proof in proofs if covers(proof.certificate, plant.sampling)]
    fastest = max(covering, key=lambda proof: float(proof.rate.mid()), default=None)
    slowest = slowest_constant_slope(plant, L)
    if fastest is not None or slowest is not None:
        bounds["decay_rate"] = Bound(
            lower_text(fastest.rate, 9) if fastest is not None else None,
            upper_text(slowest, 9) if slowest is not None else None,
            unit="1/s", method=fastest.family if fastest is not None else None, about="class",
        )  # fmt: skip
    return bounds


def _above(T: Exact) -> str:
    """A decimal not below T: T itself where it is one."""
    return upper_text(T.ball()) if T.rational is None or "/" in str(T) else str(T)


def slowest_constant_slope(plant: Plant, L: ExactMatrix) -> arb | None:
    """A rate that the error certainly does not exceed: -ln(rho) / T of the sampled error at the worst corner
    of the slope box, at the largest period; None where no corner gives one (or the loop is unstable)."""
    from cdobs_cli.certify.falsify import candidate_corners, exponentials, spectral_radii

    system = inclusion(plant, {"L": L})
    T, ends = plant.sampling.T_max, plant.slopes
    maps, exact = system.floats, system.balls
    corners = [
        tuple((ends.upper if up else ends.lower)[entry] for up, entry in zip(corner, system.entries, strict=True))
        for corner in candidate_corners(system)
    ]
    import numpy as np

    flows = np.array([maps.flow(tuple(float(v) for v in corner)) for corner in corners])
    if not np.all(np.isfinite(flows)):
        return None
    worst = int(np.argmax(spectral_radii(maps.jump @ exponentials(flows * float(T)))))
    Phi = exact.flow(tuple(printed.scalar(v) for v in corners[worst])).exp(printed.scalar(T))
    rho = spectral_radius_lower(exact.jump @ Phi)
    if not 0 < rho < 1:
        return None
    return -rho.log() / T.ball()


def printed_data(family: LpvZeroOrderHold, plant: Plant, design: Design) -> list[tuple[str, str, printed.Printed]]:
    """(prefix of the claims, where, data) for the printed (P, Y), or for those that method theorem_1 found: at the
    corners of the slope class, and at the printed vertices where there are some."""
    found = next((c for c in design.certificates if c.method == printed_search.METHOD), None)
    if family.printed is not None:
        P, Y = family.printed.P, family.printed.Y
    elif found is not None:
        P, Y = (ExactMatrix(found.data[name]) for name in ("P", "Y"))
    else:
        return []
    L = design.gain["L"]
    view = PlantView.balls(plant, {"L": L})
    # (P, Y) printed without a gain stand for L = P^-1 Y, not for the gain that was found.
    given = L if family.gain is not None or family.printed is None else None
    places = [("theorem_1", "at the corners of the slope class", tuple(vertices_25(view)))]
    if family.printed is not None and family.printed.vertices is not None:
        typed = tuple(vertex.balls() for vertex in family.printed.vertices)
        places.append(("theorem_1.printed_vertices", "at the printed vertices", typed))
    made = [(prefix, where, printed.Printed.of(P, Y, given, view.C, vertices)) for prefix, where, vertices in places]
    return [(prefix, where, data) for prefix, where, data in made if data is not None]


def _printed(family: LpvZeroOrderHold, plant: Plant, design: Design, L: ExactMatrix) -> tuple[list[Claim], dict[str, Bound]]:
    """Each printed condition, and where the conditions end."""
    claims: list[Claim] = []
    bounds: dict[str, Bound] = {}
    for prefix, where, data in printed_data(family, plant, design):
        claims += printed.claims(data, plant.sampling.T_max, prefix, where)
        bounds["tau_max" + prefix.removeprefix("theorem_1")] = printed.tau_max_bound(data)
    if family.printed is not None and family.gain is not None:
        claims.append(_gain_claim(family.printed.P, family.printed.Y, L))
    if family.printed is not None and family.printed.vertices is not None:
        claims.append(_vertices_claim(plant, family.printed.vertices))
    return claims, bounds


def _gain_claim(P: ExactMatrix, Y: ExactMatrix, L: ExactMatrix) -> Claim:
    """Is L = P^-1 Y for some P, Y that round to those typed?

    Row i of P L = Y asks for |(P L - Y)_i| <= sum_j h_ij |L_j| + h_i with h half units of last digits. Changing
    P_ii and Y_i alone is enough; no change of all entries makes up for more than the sum.
    """
    n = L.shape[0]
    residual = (P.balls() @ L.balls() - Y.balls()).balls()
    rows = []
    for i in range(n):
        r = abs(arb(residual[i, 0]))
        own = _half_unit(P[i, i]) * abs(L[i, 0].ball()) + _half_unit(Y[i, 0])
        most = sum((_half_unit(P[i, j]) * abs(L[j, 0].ball()) for j in range(n)), _half_unit(Y[i, 0]))
        rows.append((r, own, most))
    status: Status = "undecided"
    if all(r <= own for r, own, _ in rows):
        status = "proved"
    elif any(r > most for r, _, most in rows):
        status = "refuted"
    worst = max((r for r, _, _ in rows), key=lambda r: float(r.mid()))
    residuals = [upper_text(r, 6) for r, _, _ in rows]
    return Claim(
        "theorem_1.gain", "printed", status, "L = P^-1 Y for some P, Y that round to those printed", printed.SOURCE,
        margin=upper_text(worst, 6), method="theorem_1",
        witness=Witness("vector", "class", data={"|P L - Y|": residuals}) if status == "refuted" else None,
    )  # fmt: skip


def _half_unit(number: Exact) -> arb:
    """Half the unit of the last digit of a decimal."""
    digits = str(number).partition(".")[2]
    return Exact(Fraction(1, 2 * 10 ** len(digits))).ball()


def _vertices_claim(plant: Plant, vertices: tuple[ExactMatrix, ...]) -> Claim:
    """Is each printed vertex A + V with V in the declared slope box?"""
    outside: list[dict[str, Any]] = []
    inside = True
    for k, vertex in enumerate(vertices):
        for i in range(plant.n):
            for j in range(plant.n):
                value = vertex[i, j] - plant.A[i, j]
                signs = (value - plant.slopes.lower[i, j]).sign(), (plant.slopes.upper[i, j] - value).sign()
                inside = inside and None not in signs
                if -1 in signs:
                    outside.append({"vertex": k + 1, "entry": [i + 1, j + 1], "slope": str(value)})
    return Claim(
        "theorem_1.vertices", "printed", "refuted" if outside else "proved" if inside else "undecided",
        "The printed vertices are A + V with V in the declared slopes", "Boukal2020, (25), (43)", method="theorem_1",
        witness=Witness("vector", "class", data={"outside": outside}) if outside else None,
    )  # fmt: skip
