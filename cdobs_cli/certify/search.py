"""The one search over periods, rates and other numbers: walk to a first proof, then bisect.

Only proofs move an end. Nothing is assumed monotone: a proof at T speaks for T (or for the law up to T), and what
lies between two tested numbers stays open.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from typing import TypeVar

from cdobs_cli.exact.numbers import Exact, decimal_text, plain_decimal
from cdobs_cli.progress import TimeIsUp

T_ = TypeVar("T_")

FACTOR = 1.6
STEPS = 24
SPAN = 1e3
_CREEP = 0.1  # of what is left between two ends: a step that is shorter closes nothing in
# Relative width at which a search ends, by effort: where each proof costs a search of its own, and where it is quick.
_DEAR = (Fraction(1, 100), Fraction(1, 500), Fraction(1, 2000), Fraction(1, 10000))
_QUICK = (Fraction(1, 20000), Fraction(1, 20000), Fraction(1, 20000), Fraction(1, 100000))
_DIGITS = 9


def tolerance(effort: int, *, quick: bool = False) -> Fraction:
    """How close a search goes to where its proofs end."""
    return (_QUICK if quick else _DEAR)[max(0, min(effort, 3))]


def short(value: float, digits: int = _DIGITS) -> Exact:
    """A number as a short decimal."""
    return Exact(decimal_text(value, digits))


def rounded_down(value: Fraction, digits: int) -> Exact:
    """The largest decimal of so many digits that is not above the value."""
    down = Context(prec=digits, rounding=ROUND_FLOOR).divide(Decimal(value.numerator), Decimal(value.denominator))
    return Exact(plain_decimal(down))


def longest(
    prove: Callable[[Exact], T_ | None],
    start: Exact,
    width: Fraction,
    *,
    glance: Callable[[Exact], T_ | None] | None = None,
    floor: float = 0.0,
    digits: int = _DIGITS,
) -> T_ | None:
    """The proof at the largest number found, as `largest`."""
    met = largest(prove, start, width, glance=glance, floor=floor, digits=digits)
    return None if met is None else met[1]


def largest(
    prove: Callable[[Exact], T_ | None],
    start: Exact,
    width: Fraction,
    *,
    glance: Callable[[Exact], T_ | None] | None = None,
    floor: float = 0.0,
    digits: int = _DIGITS,
) -> tuple[Exact, T_] | None:
    """The largest number found with a proof, and the proof; None where nothing down to start / 1.6^24 has one.

    Walks down from `start` (towards `floor`) to a first proof, or up from it to a first failure, then bisects to the
    relative width. When the time for searches is over it is the best so far.

    Args:
        glance: a quicker, weaker proof for the walk.
    """
    if not 0 < float(start) < 1e12:
        return None
    known: dict[str, T_ | None] = {}

    def full(value: Exact) -> T_ | None:
        if str(value) not in known:
            known[str(value)] = prove(value)
        return known[str(value)]

    try:
        return _largest(full, start, width, full if glance is None else glance, floor, digits)
    except TimeIsUp:
        proved = [(Exact(text), proof) for text, proof in known.items() if proof is not None]
        if not proved:
            raise
        return max(proved, key=lambda pair: float(pair[0]))


def _largest(
    full: Callable[[Exact], T_ | None], start: Exact, width: Fraction, walk: Callable[[Exact], T_ | None],
    floor: float, digits: int,
) -> tuple[Exact, T_] | None:  # fmt: skip
    low, steps = start, 0
    while walk(low) is None:
        if steps == STEPS:
            at_start = None if walk is full else full(start)
            return None if at_start is None else (start, at_start)
        low, steps = short(floor + (float(low) - floor) / FACTOR, digits), steps + 1
    high = short(float(low) * FACTOR if floor == 0 or steps == 0 else floor + (float(low) - floor) * FACTOR, digits)
    while (
        (steps == 0 or walk is not full)
        and float(high) < SPAN * float(start)
        and (walk(high) or full(high)) is not None
    ):
        low, high = high, short(float(high) * FACTOR, digits)
    return between(full, low, high, width, digits)


def between(
    prove: Callable[[Exact], T_ | None], low: Exact, high: Exact, width: Fraction, digits: int = _DIGITS
) -> tuple[Exact, T_] | None:
    """The largest number found in [low, high] with a proof, and the proof; None where `low` has none.

    Bisects on proofs to the relative width; points are short decimals (ends are kept as given).
    """
    at_high = prove(high)
    if at_high is not None:
        return high, at_high
    at_low = prove(low)
    if at_low is None:
        return None
    best = (low, at_low)
    below, above = float(low), float(high)
    while above - below > float(width) * above:
        middle = (below * above) ** 0.5 if below > 0 and above > 4 * below else (below + above) / 2
        T = short(middle, digits)
        proof = prove(T)
        if proof is None:
            above = middle
        else:
            below, best = middle, (T, proof)
    return best


def smallest(
    refute: Callable[[Exact], T_ | None], start: float, growth: float, width: float, *, span: float = 1e4,
    nearer: Callable[[T_, float], float] | None = None,
) -> tuple[Exact, T_] | None:  # fmt: skip
    """The smallest number found above `start` with a refutation, and the refutation.

    Walks up by the factor `growth`, at most to `span` times the start, then closes in between the last number that
    survived and the first that did not, to the relative width.

    Args:
        nearer: where a refutation at a number about ends to be one; a guess, tried before the middle.
    """
    if not 0 < start < 1e12:
        return None
    low, high, refutation = start, start, None
    while refutation is None:
        low, high = high, high * growth
        if high > start * span:
            return None
        T = short(high)
        refutation = refute(T)
    best, step, crept = (T, refutation), 0.0, False
    while high - low > width * high:
        tried = (low + high) / 2
        if step:  # the guess was a little too low
            tried = min(low + step, tried)
        elif nearer is not None and not crept:
            guess = min(nearer(best[1], high), high - 0.9 * width * high)
            tried = guess if guess > low else min(low + width * high, tried)
        T = short(tried)
        refutation = refute(T) if float(T) > start else None
        crept = refutation is not None and high - tried < _CREEP * (high - low)  # more is left than the guess said
        if refutation is None:
            low, step = tried, max(4 * step, width * high) if nearer is not None else 0.0
        else:
            high, best, step = tried, (T, refutation), 0.0
    return best
