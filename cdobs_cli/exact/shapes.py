"""The shapes that functions of the language have: all that ranges and boxes need to know of one."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import inf

from cdobs_cli.exact.expression import Expression
from cdobs_cli.records import dataclass

Rule = Callable[..., Expression]
End = Fraction | float  # a float only where it is inf or -inf


@dataclass(frozen=True)
class Monotone:
    """Strictly monotone and continuous from an interval onto another, undefined outside.

    Args:
        image: the values, or limits, at the two ends of the domain; a finite end with an infinite value does not
            belong to the domain.
        even: a function of |x|, monotone for x >= 0.
    """

    image: tuple[Expression | float, Expression | float]
    domain: tuple[End, End] = (-inf, inf)
    even: bool = False


@dataclass(frozen=True)
class Periodic:
    """Monotone between turning points: `top` at (peak + k period) pi, `bottom` at (valley + k period) pi.

    Where these are infinite the points are poles.
    """

    peak: Fraction
    valley: Fraction
    period: int = 2
    top: End = Fraction(1)
    bottom: End = Fraction(-1)


@dataclass(frozen=True)
class Cornered:
    """Extreme at the corners of every box on which `inside` > 0; undefined elsewhere. All its values lie in `image`."""

    inside: Rule
    image: tuple[Expression, Expression]


@dataclass(frozen=True)
class Kink:
    """`above` where `condition` >= 0, `below` where it is <= 0; two constants: it jumps."""

    condition: Rule
    above: Rule
    below: Rule
