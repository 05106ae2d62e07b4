"""A cover of an interval by pieces on each of which something is proved."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from cdobs_cli.exact.numbers import Exact, arb_fraction
from cdobs_cli.sampling import SamplingLaw

_PIECES = 400
_NARROWEST = Fraction(1, 2**20)  # of the whole interval


def covered(
    holds: Callable[[Fraction, Fraction], bool],
    low: Fraction,
    high: Fraction,
    *,
    pieces: int = _PIECES,
    narrowest: Fraction = _NARROWEST,
) -> bool:
    """Whether a property that can be proved on short intervals [a, b] holds on each of a cover of [low, high]."""
    pending = [(low, high)]
    for _ in range(pieces):
        if not pending:
            return True
        a, b = pending.pop()
        if holds(a, b):
            continue
        if b - a <= (high - low) * narrowest:
            return False
        middle = (a + b) / 2
        pending += [(a, middle), (middle, b)]
    return False


def law_ends(law: SamplingLaw) -> tuple[Fraction, Fraction]:
    """Rational ends of an interval that holds every period of the law; 0 only for T_min = 0 itself."""
    return ends_of(law.T_min)[0], ends_of(law.T_max)[1]


def ends_of(T: Exact) -> tuple[Fraction, Fraction]:
    """Rational ends of an interval that holds T: T itself where it is rational."""
    if T.rational is not None:
        return T.rational, T.rational
    return arb_fraction(T.ball().lower()), arb_fraction(T.ball().upper())
