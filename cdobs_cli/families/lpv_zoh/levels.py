"""Level sets of the observer's error, from the certificates of a design."""

from __future__ import annotations

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.certify.levels import Level, clock_level, constant_level
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.lpv_zoh import wirtinger
from cdobs_cli.families.lpv_zoh.claims import reprove
from cdobs_cli.families.lpv_zoh.laws import at_period, covers
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.plant import Plant


def levels(plant: Plant, design: Design) -> tuple[Level, ...]:
    """One for each certificate that covers the design's law: V is e'Pe at samples, and never below it (Wirtinger), or
    clock-dependent."""
    plant = at_period(plant, design.sampling.T_max)
    covering = [certificate for certificate in design.certificates if covers(certificate, design.sampling)]
    found = (_level(plant, design.gain["L"], certificate) for certificate in covering)
    return tuple(level for level in found if level is not None)


def _level(plant: Plant, L: ExactMatrix, certificate: Certificate) -> Level | None:
    if certificate.method == clock.METHOD:
        return clock_level(inclusion(plant, {"L": L}), certificate)
    if certificate.method == wirtinger.METHOD and reprove(plant, L, certificate) is not None:
        return constant_level(ExactMatrix(certificate.data["P"]))
    return None
