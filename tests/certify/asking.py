"""Small questions of the tests of `certify`; certificates as design.json holds them."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, read
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.planar.extremals import Planar
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import HybridInclusion

METHODS = (*GENERAL.methods, Planar)
AT_REST = Fraction(0)


def proof(inclusion: HybridInclusion, certificate: Certificate) -> Proof:
    """What is proved of a stored certificate, under its own law."""
    stored = read(certificate, METHODS)
    return NOTHING if stored is None else stored.method.prove(Question(inclusion))


def proves(inclusion: HybridInclusion, certificate: Certificate) -> bool:
    return proof(inclusion, certificate).holds


def analyse_by(
    method: Any, inclusion: HybridInclusion, effort: int = 1, sigma: Fraction = AT_REST
) -> Certificate | None:
    """The proved certificate that a method, or a rung of them, proposes."""
    return stored(method.propose(Question(inclusion, rate=sigma, effort=effort)))


def analyse(inclusion: HybridInclusion, effort: int, sigma: Fraction = AT_REST) -> Certificate | None:
    """By the certificates that need no structure."""
    return analyse_by(GENERAL, inclusion, effort, sigma)


def longest(at: Callable[[str], HybridInclusion], start: str, effort: int) -> tuple[Exact, Certificate] | None:
    """The longest period found for the inclusion's gain, looked for from `start`, and its certificate."""
    certificate = stored(GENERAL.longest(Question(at(start), effort=effort)))
    return None if certificate is None else (certificate.sampling.T_max, certificate)


def design(open_loop: HybridInclusion, effort: int) -> tuple[ExactMatrix, Certificate] | None:
    """A gain of e+ = (I - K C) e with its clock certificate; the gain of `open_loop` is zero."""
    met = design_impulsive(Question(open_loop, effort=effort))
    return None if met is None else (met[0], met[1].certificate())


def stored(method: Method | None) -> Certificate | None:
    return None if method is None else method.certificate()
