"""The verb synthesize: c, then the gain by Theorem 2' or Theorem 2, or a certificate for a given gain."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.updated_sampling import constant_period
from cdobs_cli.families.updated_sampling.lipschitz import rate_of
from cdobs_cli.families.updated_sampling.member import asked
from cdobs_cli.families.updated_sampling.theorem import Theorem
from cdobs_cli.families.updated_sampling.theorem_2 import Theorem2
from cdobs_cli.families.updated_sampling.theorem_2_prime import Theorem2Prime
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

THEOREMS: tuple[type[Theorem], ...] = (Theorem2Prime, Theorem2)
_UNBOUNDED = "c(x_hat, u) = {} has no bound over the domain, so no period can be guaranteed; declare a domain"
_UNPROVED = "the conditions of the theorem were met in floating point, but could not be proved for rounded numbers"


def synthesize(family: UpdatedSampling, plant: Plant, effort: int) -> Design:
    """A gain with a certificate that is proved already, or the given gain with the best that was found,
    proved or not; beside it what a constant period can do for the same slopes."""
    rate = rate_of(family, plant)
    theorem = next(one for one in THEOREMS if one.name == family.method)
    given = {name: matrix for name, matrix in family.given().items() if matrix is not None} if family.gain else {}
    question = asked(family, plant, given, effort)
    details = {"rate": rate.document()}
    if given:
        own = theorem.guess(question) if theorem.applies(question) else None
        certificates = () if own is None else (own.certificate(),)
        made = Design(family.name, "given", plant.sampling, given, certificates, details=details)
    elif rate.largest is None:
        made = Design(family.name, "none", plant.sampling, {}, reason=_UNBOUNDED.format(rate.c), details=details)
    else:
        made = replace(_found(theorem, question, rate.largest), details=details)
    known = None if made.outcome == "none" else rate.largest
    beside = None if known is None else constant_period.longest(plant, family.variant, known)
    return made if beside is None else replace(made, certificates=(*made.certificates, beside))


def _found(theorem: type[Theorem], question: Question, c: Exact) -> Design:
    """The first of the theorem's designs that is proved."""
    reason = theorem.missing
    for gain, certificate in theorem.designs(question, float(c)):
        if certificate.prove(question.with_gain(gain)).holds:
            return Design(question.card.name, "found", question.law, gain, (certificate.certificate(),))
        reason = _UNPROVED
    return Design(question.card.name, "none", question.law, {}, reason=reason)
