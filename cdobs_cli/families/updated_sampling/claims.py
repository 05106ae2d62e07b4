"""What is proved of a design, what is refuted, and the guaranteed period: from the stored certificate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flint import acb, arb

from cdobs_cli.certificate import Bound, Certificate, Check, Claim, Status, Witness
from cdobs_cli.certify.ball import (
    determinant,
    eigenvalues,
    has_spectral_radius_below,
    is_hurwitz,
    spectral_radius_lower,
)
from cdobs_cli.certify.falsify import refute
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, upper_text
from cdobs_cli.families.updated_sampling import constant_period
from cdobs_cli.families.updated_sampling.domination import largest_growth
from cdobs_cli.families.updated_sampling.lipschitz import Rate, largest_is_proved, rate_claim
from cdobs_cli.families.updated_sampling.member import free_member
from cdobs_cli.families.updated_sampling.period import guaranteed_period, lemma_1
from cdobs_cli.families.updated_sampling.proof import Numbers, PaperProof, PrimeProof, prove_prime, prove_theorem_2
from cdobs_cli.families.updated_sampling.synthesis import PRIME, stored_rate, weight
from cdobs_cli.families.updated_sampling.theorems import Chain, one_step_map
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

SOURCE = "Andrieu2014, Theorem 2"
_UNREADABLE = (KeyError, TypeError, ValueError, IndexError, ExpressionError)


def certify(family: UpdatedSampling, plant: Plant, design: Design, effort: int) -> Check:
    """All claims about a design: the premise c, stability of A + K C and of Q(alpha), the conditions of the
    theorem one by one, and the conclusion; the guaranteed period and Lemma 1's beside it.

    Source: Andrieu2014, Theorem 2
    """
    try:
        rate = stored_rate(family, plant, design)
        numbers = None if design.outcome == "none" else Numbers.of(design.gain)
    except _UNREADABLE as error:
        return Check((_convergence("undecided", f"the stored design cannot be read: {error}"),))
    if numbers is None or numbers.K.shape != (plant.n, 1):
        return Check((_convergence("undecided", design.reason or "the stored gain does not fit the plant"),))
    premise = rate_claim(plant, rate, family.variant)
    bounded = largest_is_proved(plant, rate, family.variant, premise)
    claims = [premise, _bounded_claim(rate, bounded), _hurwitz_claim(numbers), _one_step_claim(plant, design, numbers, effort)]
    proved, by = False, None
    own = [certificate for certificate in design.certificates if certificate.method != constant_period.METHOD]
    beside = next((certificate for certificate in design.certificates if certificate.method == constant_period.METHOD), None)
    for certificate in own:
        try:
            holds, made = _judge(family, plant, numbers, certificate)
        except (*_UNREADABLE, ZeroDivisionError):
            holds, made = False, []
        claims += made
        if holds and not proved:
            proved, by = True, certificate.method
    if not own and claims[3].status != "refuted":
        claims.append(Claim(f"{family.method}.P", "certificate", "undecided", f"{_wanted(family.method)}: none was found.", SOURCE))
    statement = "x_hat - x tends to 0 for every plant of the class with this c, whatever L(0) >= 1"
    if claims[3].status == "refuted":
        conclusion = _convergence("refuted", statement, witness=claims[3].witness, method="the member f = 0 with L = 1")
    elif proved and premise.status == "proved" and bounded:
        conclusion = _convergence("proved", statement, method=by, by=f"{by}.ii" if by == PRIME else by)
    else:
        conclusion = _convergence("undecided", statement)
    bounds = _bounds(rate, numbers, bounded)
    if beside is not None and rate.largest is not None:
        claim = _constant_claim(family, plant, rate.largest, beside)
        claims.append(claim)
        if claim.status == "proved":
            about = f"a constant period with a gain of its own, slopes up to {rate.largest}"
            bounds["guaranteed_period.constant"] = Bound(str(beside.sampling.T_max), None, "s", "clock", about)
    return Check((conclusion, *claims), bounds)


def _constant_claim(family: UpdatedSampling, plant: Plant, c: Exact, certificate: Certificate) -> Claim:
    """The clock-dependent certificate at a constant period, where c is known in advance."""
    try:
        holds = constant_period.holds(plant, family.variant, c, certificate)
    except (*_UNREADABLE, ZeroDivisionError):
        holds = False
    statement = f"Slopes up to {c} are also served by a constant gain at the constant period {certificate.sampling.T_max}."
    return Claim(
        "constant_period",
        "certificate",
        _status(holds),
        statement,
        "clock-dependent Lyapunov function",
        method="exact Bernstein coefficients",
    )


def _wanted(method: str) -> str:
    if method == PRIME:
        return "Some P meets (i) with this K, alpha and a_1, and P D + D P > 0"
    return "Some P meets (8)-(9) with this K"


def _convergence(status: Status, statement: str, **more: Any) -> Claim:
    return Claim("convergence", "consequence", status, f"{statement}.", SOURCE, required=True, **more)


def _status(holds: bool) -> Status:
    return "proved" if holds else "undecided"


def _bounded_claim(rate: Rate, bounded: bool) -> Claim:
    limit = "some bound" if rate.largest is None else str(rate.largest)
    statement = f"c(x_hat, u) <= {limit} over the domain and the input ranges, so L stays bounded and the periods above 0."
    return Claim("c_bounded", "premise", _status(bounded), statement, "Andrieu2014, (4), Lemma 1")


def _hurwitz_claim(numbers: Numbers) -> Claim:
    """A + K C: what (9) needs, and what a given gain is asked first."""
    n = numbers.K.shape[0]
    chain = Chain.exact(n)
    closed = chain.A + numbers.K @ chain.C
    statement = "A + K C is Hurwitz, so that some P meets (9)"
    if _is_unstable(closed):
        worst = _unstable_eigenvector(closed)
        witness = Witness("vector", "class", (), (worst[1],), worst[0]) if worst else None
        shown = f": an eigenvalue is {worst[0]}" if worst else ""
        text = f"{statement}{shown}."
        return Claim("hurwitz", "certificate", "refuted", text, "Andrieu2014, (9)", method="eigenvalues in balls", witness=witness)
    if closed.is_rational:
        status, method = _status(is_hurwitz(closed)), "Routh's array, exact"
    else:
        found = eigenvalues(closed)
        status, method = _status(found is not None and all(value.real.upper() < 0 for value in found)), "eigenvalues in balls"
    return Claim("hurwitz", "certificate", status, f"{statement}.", "Andrieu2014, (9)", method=method)


def _is_unstable(closed: Matrix) -> bool:
    """Whether some eigenvalue has a real part >= 0: by det(-M) <= 0, trace M >= 0, or the enclosures."""
    if arb(determinant(-closed)) <= 0 or arb(closed.trace()) >= 0:
        return True
    return any(value.real.lower() >= 0 for value in eigenvalues(closed) or ())


def _unstable_eigenvector(closed: Matrix) -> tuple[str, tuple[str, ...]] | None:
    """The eigenvalue of largest real part as text, and for a real one its eigenvector (v, .., first entry 1).

    From (A + K C) v = s v: v_(i+1) = s v_i - K_i v_1.
    """
    values = eigenvalues(closed)
    if not values:
        return None
    worst = max(values, key=lambda value: float(value.real.mid()))
    if not worst.imag.contains(0):
        return f"{_short(worst.real)} + {_short(abs(worst.imag))} i", ()
    vector = [acb(1)]
    for i in range(closed.shape[0] - 1):
        vector.append(worst * vector[i] - acb(arb(closed[i, 0])))
    return lower_text(worst.real, 6), tuple(_short(entry.real) for entry in vector)


def _short(value: arb) -> str:
    return lower_text(value.mid(), 8)


def _one_step_claim(plant: Plant, design: Design, numbers: Numbers, effort: int) -> Claim:
    """Q(alpha): with f = 0 and c = 0, L stays 1 and e_(k+1) = Q(alpha) e_k."""
    Q = one_step_map(Chain.exact(plant.n), numbers.K, numbers.alpha)
    statement = "The one-step map Q(alpha) = (I + alpha K C) exp(A alpha) of the member f = 0 has its spectrum inside the unit circle"
    source = "Andrieu2014, (15)"
    if has_spectral_radius_below(Q):
        return Claim("one_step_map", "certificate", "proved", f"{statement}.", source, method="powers in balls")
    witness = refute(free_member(plant, design.gain), effort)
    if witness is None:
        return Claim("one_step_map", "certificate", "undecided", f"{statement}.", source)
    radius = lower_text(spectral_radius_lower(Q), 6)
    text = f"{statement}: its spectral radius is at least {radius}."
    return Claim("one_step_map", "certificate", "refuted", text, source, method="eigenvalues in balls", witness=witness)


def _judge(family: UpdatedSampling, plant: Plant, numbers: Numbers, certificate: Certificate) -> tuple[bool, list[Claim]]:
    if certificate.method == PRIME:
        proof = prove_prime(numbers, certificate, family.variant)
        return proof.holds, _prime_claims(numbers, certificate, proof, family.variant)
    paper = prove_theorem_2(numbers, certificate, weight(family, plant.n))
    return (paper is not None and paper.holds), [] if paper is None else _paper_claims(certificate, paper, weight(family, plant.n))


def _prime_claims(numbers: Numbers, certificate: Certificate, proof: PrimeProof, variant: str) -> list[Claim]:
    p_3 = certificate.data["p_3"]
    source = "Andrieu2014, Theorem 2 with (17) and (3)"
    if not (proof.positive and proof.dilation):
        return [Claim(f"{PRIME}.P", "certificate", "undecided", f"P > 0 and P D + D P >= p_3 P > 0 with p_3 = {p_3}.", source)]
    slopes = "lower triangular G with |G_ij| <= 1" if variant == "triangular" else "|Delta| <= c |e| in the last row"
    shrink = "" if proof.epsilon is None else f": V = E'PE falls by a factor 1 - {float(proof.epsilon):g} at each sample at least"
    margin = None if proof.epsilon is None else lower_text(fraction_ball(proof.epsilon), 6)
    g = lower_text(arb(numbers.a_2) * arb(p_3), 6)
    need = (
        ""
        if proof.domination
        else f"; with this P, a_2 = {upper_text(arb(_least_a_2(numbers, certificate, variant)), 4)} or more is needed"
    )
    return [
        Claim(f"{PRIME}.P", "certificate", "proved",
              f"P > 0 and P D + D P >= p_3 P with p_3 = {p_3}.", source),
        Claim(f"{PRIME}.i", "certificate", _status(proof.epsilon is not None), f"(i) of Theorem 2' holds{shrink}.", source, margin=margin,
              method="pivots of LDL' in balls"),
        Claim(f"{PRIME}.ii", "certificate", _status(proof.domination),
              f"(ii) of Theorem 2' holds: between samples V grows at most at the rate a_2 p_3 c = {g} c, for {slopes}{need}.", source,
              method="Bernstein coefficients over halved pieces of [0, alpha]"),
    ]  # fmt: skip


def _least_a_2(numbers: Numbers, certificate: Certificate, variant: str) -> float:
    """g / p_3 in floats: what to try where (ii) is not proved."""
    P = ExactMatrix(certificate.data["P"]).floats
    return largest_growth(P, float(arb(numbers.alpha).mid()), variant) / float(certificate.data["p_3"])


def _paper_claims(certificate: Certificate, proof: PaperProof, w: int) -> list[Claim]:
    p = {name: certificate.data[name] for name in ("p_1", "p_2", "p_3", "p_4")}
    if proof.alpha_m is None:
        reach = "alpha_m could not be enclosed"
    else:
        low, high = proof.alpha_m
        reach = "it holds up to 1 / a_1"
        if high is not None:
            reach = f"alpha_m is in [{lower_text(fraction_ball(low), 9)}, {upper_text(fraction_ball(high), 9)}]"
    needed, printed = upper_text(proof.a_2_limit, 6), upper_text(proof.a_2_printed, 6)
    sizes = f"N_1 <= {upper_text(proof.N_1, 6)}, N_2 <= {upper_text(proof.N_2, 6)}"

    def claim(name: str, holds: bool, statement: str, source: str) -> Claim:
        return Claim(f"theorem_2.{name}", "certificate", _status(holds), statement, source)

    return [
        claim("8", proof.condition_8, f"p_1 I <= P <= p_2 I with p_1 = {p['p_1']}, p_2 = {p['p_2']}.", "Andrieu2014, (8)"),
        claim("9", proof.condition_9 and proof.dilation,
              f"(A + K C)'P + P (A + K C) <= -I and p_3 P <= P D + D P <= p_4 P with p_3 = {p['p_3']}, p_4 = {p['p_4']}.",
              "Andrieu2014, (9)"),
        claim("a_1", proof.a_1, f"a_1 is at most 1 / (2 p_2 p_4), which is {lower_text(proof.a_1_limit, 8)}.", "Andrieu2014, Theorem 2"),
        claim("alpha_m", proof.lemma_4, f"(17) holds at alpha; {reach}.", "Andrieu2014, Lemma 4, (17)"),
        claim("a_2", proof.a_2, f"a_2 is at least what step 3 of the proof needs, {needed} ({sizes}); the paper takes {printed}.",
              "Andrieu2014, Theorem 2, step 3"),
        claim("a_3", proof.a_3, f"a_3 is at least {2 * w}.", "Andrieu2014, Theorem 2, step 3"),
    ]  # fmt: skip


def _bounds(rate: Rate, numbers: Numbers, bounded: bool) -> dict[str, Bound]:
    """The guaranteed period for c <= largest, and what Lemma 1's own constants give."""
    if rate.largest is None or not bounded or not numbers.are_signed:
        return {}
    c = rate.largest.ball()
    proved, reached = guaranteed_period(numbers.timing, c)
    about = f"every sampling period while c <= {rate.largest}, L(0) = 1"
    ceiling = upper_text(reached, 9) if rate.origin == "constant" else None
    return {
        "guaranteed_period": Bound(lower_text(proved, 9), ceiling, "s", "fixed point of (6)-(7)", about),
        "guaranteed_period.lemma_1": Bound(lower_text(lemma_1(numbers.timing, c), 3), None, "s", "Lemma 1", about),
    }
