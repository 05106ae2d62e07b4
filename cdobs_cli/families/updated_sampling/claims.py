"""What is proved of a design, what is refuted, and the guaranteed period: from the stored certificate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flint import acb, arb

from cdobs_cli.certificate import CONVERGENCE, Bound, Certificate, Check, Claim, Status, Witness, status_of
from cdobs_cli.certify.ball import (
    determinant,
    eigenvalues,
    has_spectral_radius_below,
    is_hurwitz,
    spectral_radius_lower,
)
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.base import UNREADABLE, read
from cdobs_cli.design import Design
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.families.updated_sampling import constant_period
from cdobs_cli.families.updated_sampling.lipschitz import Rate, largest_is_proved, rate_claim, stored_rate
from cdobs_cli.families.updated_sampling.member import asked, free_member
from cdobs_cli.families.updated_sampling.period import guaranteed_period, lemma_1
from cdobs_cli.families.updated_sampling.synthesis import THEOREMS
from cdobs_cli.families.updated_sampling.theorem import Numbers
from cdobs_cli.families.updated_sampling.theorem_2_prime import Theorem2Prime
from cdobs_cli.families.updated_sampling.theorems import Chain, one_step_map
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

SOURCE = "Andrieu2014, Theorem 2"


def certify(family: UpdatedSampling, plant: Plant, design: Design, effort: int) -> Check:
    """All claims about a design: the premise c, stability of A + K C and of Q(alpha), the conditions of the
    theorem one by one, and the conclusion; the guaranteed period and Lemma 1's beside it.

    Source: Andrieu2014, Theorem 2
    """
    try:
        rate = stored_rate(family, plant, design)
        numbers = None if design.outcome == "none" else Numbers.of(design.gain)
    except UNREADABLE as error:
        return Check((_convergence("undecided", f"the stored design cannot be read: {error}"),))
    if numbers is None or numbers.K.shape != (plant.n, 1):
        return Check((_convergence("undecided", design.reason or "the stored gain does not fit the plant"),))
    premise = rate_claim(plant, rate, family.variant)
    bounded = largest_is_proved(plant, rate, family.variant, premise)
    one_step = _one_step_claim(plant, design, numbers, effort)
    claims = [premise, bounded_claim(rate, bounded), _hurwitz_claim(numbers), one_step]
    own = [certificate for certificate in design.certificates if certificate.method != constant_period.METHOD]
    question, by = asked(family, plant, design.gain, effort), None
    for stored in filter(None, (read(certificate, THEOREMS) for certificate in own)):
        proof = stored.method.prove(question)
        claims += stored.method.claims(question, proof)
        by = by or (stored.method.name if proof.holds else None)
    if not own and one_step.status != "refuted":
        wanted = next(theorem.wanted for theorem in THEOREMS if theorem.name == family.method)
        claims.append(Claim(f"{family.method}.P", "certificate", "undecided", f"{wanted}: none was found.", SOURCE))
    statement = "x_hat - x tends to 0 for every plant of the class with this c, whatever L(0) >= 1"
    if one_step.status == "refuted":
        conclusion = _convergence("refuted", statement, witness=one_step.witness, method="the member f = 0 with L = 1")
    elif by is not None and premise.status == "proved" and bounded:
        conclusion = _convergence("proved", statement, method=by, by=f"{by}.ii" if by == Theorem2Prime.name else by)
    else:
        conclusion = _convergence("undecided", statement)
    bounds = _bounds(rate, numbers, bounded)
    beside = next((certificate for certificate in design.certificates if certificate not in own), None)
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
    except UNREADABLE:
        holds = False
    T = certificate.sampling.T_max
    statement = f"Slopes up to {c} are also served by a constant gain at the constant period {T}."
    source, method = "clock-dependent Lyapunov function", "exact Bernstein coefficients"
    return Claim("constant_period", "certificate", status_of(holds), statement, source, method=method)


def _convergence(became: Status, statement: str, **more: Any) -> Claim:
    return Claim(CONVERGENCE, "consequence", became, f"{statement}.", SOURCE, required=True, **more)


def bounded_claim(rate: Rate, bounded: bool, so: str = "L stays bounded and the periods above 0") -> Claim:
    limit = "some bound" if rate.largest is None else str(rate.largest)
    statement = f"c(x_hat, u) <= {limit} over the domain and the input ranges, so {so}."
    return Claim("c_bounded", "premise", status_of(bounded), statement, "Andrieu2014, (4), Lemma 1")


def _hurwitz_claim(numbers: Numbers) -> Claim:
    """A + K C: what (9) needs, and what a given gain is asked first."""
    chain = Chain.exact(numbers.K.shape[0])
    closed = chain.A + numbers.K @ chain.C
    values = eigenvalues(closed)
    statement, method, witness = "A + K C is Hurwitz, so that some P meets (9)", "eigenvalues in balls", None
    if _is_unstable(closed, values):
        became: Status = "refuted"
        if values:
            worst, vector = _unstable_eigenvector(closed, values)
            statement += f": an eigenvalue is {worst}"
            witness = Witness("vector", "class", (), (vector,), worst)
    elif closed.is_rational:
        became, method = status_of(is_hurwitz(closed)), "Routh's array, exact"
    else:
        became = status_of(values is not None and all(value.real.upper() < 0 for value in values))
    return Claim("hurwitz", "certificate", became, f"{statement}.", "Andrieu2014, (9)", method=method, witness=witness)


def _is_unstable(closed: Matrix, values: list[acb] | None) -> bool:
    """Whether some eigenvalue has a real part >= 0: by det(-M) <= 0, trace M >= 0, or the enclosures."""
    by_numbers = arb(determinant(-closed)) <= 0 or arb(closed.trace()) >= 0
    return bool(by_numbers) or any(value.real.lower() >= 0 for value in values or ())


def _unstable_eigenvector(closed: Matrix, values: list[acb]) -> tuple[str, tuple[str, ...]]:
    """The eigenvalue of largest real part as text, and for a real one its eigenvector (v, .., first entry 1).

    From (A + K C) v = s v: v_(i+1) = s v_i - K_i v_1.
    """
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
    what = "The one-step map Q(alpha) = (I + alpha K C) exp(A alpha) of the member f = 0"
    text = f"{what} has its spectrum inside the unit circle"
    became: Status = status_of(has_spectral_radius_below(Q))
    method, witness = "powers in balls" if became == "proved" else None, None
    if became != "proved" and (witness := refute(free_member(plant, design.gain), effort)) is not None:
        became, method = "refuted", "eigenvalues in balls"
        text += f": its spectral radius is at least {lower_text(spectral_radius_lower(Q), 6)}"
    source = "Andrieu2014, (15)"
    return Claim("one_step_map", "certificate", became, f"{text}.", source, method=method, witness=witness)


def _bounds(rate: Rate, numbers: Numbers, bounded: bool) -> dict[str, Bound]:
    """The guaranteed period for c <= largest, and what Lemma 1's own constants give."""
    if rate.largest is None or not bounded or not numbers.is_signed:
        return {}
    c = rate.largest.ball()
    proved, reached = guaranteed_period(numbers.balls, c)
    about = f"every sampling period while c <= {rate.largest}, L(0) = 1"
    ceiling = upper_text(reached, 9) if rate.origin == "constant" else None
    return {
        "guaranteed_period": Bound(lower_text(proved, 9), ceiling, "s", "fixed point of (6)-(7)", about),
        "guaranteed_period.lemma_1": Bound(lower_text(lemma_1(numbers.balls, c), 3), None, "s", "Lemma 1", about),
    }
