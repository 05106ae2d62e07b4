"""Sampling laws: the plant at another period, which certificate covers which law, and walks over periods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import TypeVar

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.bracket import largest_proved
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, decimal_text
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

T_ = TypeVar("T_")

# Certificates whose proof holds for every T_k <= T_max, whatever the law says of the least period.
DOWN_TO_ZERO = ("wirtinger", "repaired")
_WALK = 1.6
_STEPS = 30


def at_period(plant: Plant, T: Exact) -> Plant:
    """The plant with its period (or largest period) replaced."""
    return replace(plant, sampling=plant.sampling.with_period(T))


def covers(certificate: Certificate, law: SamplingLaw) -> bool:
    """Whether what the certificate shows for its own law includes this law."""
    own = certificate.sampling
    if certificate.method in DOWN_TO_ZERO:
        own = SamplingLaw("aperiodic", EXACT_ZERO, own.T_max)
    return own.contains(law)


def short(value: float) -> Exact:
    """A period of six digits."""
    return Exact(decimal_text(value, 6))


def largest(search: Callable[[Exact], T_ | None], start: Exact, tolerance: Fraction) -> tuple[Exact, T_] | None:
    """The largest value found with a proof, and the proof: a walk from `start`, then bisection.

    None where nothing down to `start` / 1.6^30 is proved.
    """
    known: dict[str, T_ | None] = {}

    def prove(value: Exact) -> T_ | None:
        if str(value) not in known:
            known[str(value)] = search(value)
        return known[str(value)]

    low, found = start, prove(start)
    steps = 0
    while found is None and steps < _STEPS:
        low, steps = short(float(low) / _WALK), steps + 1
        found = prove(low)
    if found is None:
        return None
    high = short(float(low) * _WALK)
    while steps == 0 and (above := prove(high)) is not None and float(high) < 1e3 * float(start):
        low, found, high = high, above, short(float(high) * _WALK)
    return largest_proved(prove, low, high, tolerance)
