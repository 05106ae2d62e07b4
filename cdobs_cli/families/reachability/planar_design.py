"""Two states with a measured first one: the exact limit of the period, for one gain and for all gains with K_1 = 1."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TypeVar

from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import planar
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.reachability.set_design import rounded_down
from cdobs_cli.hybrid import HybridInclusion

Closed = Callable[[ExactMatrix, Exact], HybridInclusion]
T_ = TypeVar("T_")

# Limits are looked for from a thousandth of these multiples of the asked period: from half of it, else far below.
REACH = (500, 5)
DIGITS = (5, 7, 9, 11)


class PlanarSearch:
    """The exact planar bound for one plant; `closed(K, T)` is its error system.

    Applies where the plant has two states, y = x_1 times a number, x_1' = b x_2 and slopes in the last row.
    """

    def __init__(self, closed: Closed, T: Exact, C: ExactMatrix) -> None:
        self.closed, self.T, self.C = closed, T, C
        self.applies = C.shape == (1, 2) and C[0, 0].sign() not in (0, None) and C[0, 1].sign() == 0 and C[0, 0].rational is not None
        self.known = planar.planar_class(closed(self._gain(Fraction(0), 5), T)) if self.applies else None
        self.applies = self.known is not None

    def covers(self, K: ExactMatrix | None) -> bool:
        """Whether the exact limit is known for this gain; for the gains with K_1 = 1 where none is given."""
        return self.known is not None and (K is None or planar.cleared_gain(self.closed(K, self.T)) is not None)

    def _gain(self, K_2: Fraction, digits: int) -> ExactMatrix:
        c = self.C[0, 0].rational
        assert c is not None
        return ExactMatrix([[1 / c], [Exact(decimal_text(K_2 / c, digits))]])

    def gain_at(self, T: Exact) -> tuple[ExactMatrix, Certificate] | None:
        """The gain in the middle of those that no extremal defeats at T, with its certificate."""
        if not self.applies:
            return None
        K_2 = planar.best_gain(self.closed(self._gain(Fraction(0), 5), T))
        for digits in DIGITS if K_2 is not None else ():
            assert K_2 is not None
            K = self._gain(K_2, digits)
            certificate = planar.analyse(self.closed(K, T))
            if certificate is not None:
                return K, certificate
        return None

    def largest_any(self) -> tuple[ExactMatrix, Certificate] | None:
        """The largest period at which some gain is proved, and that gain."""
        if self.known is None:
            return None
        family = self.known[0]
        return self._last(lambda below: planar.limit_any_gain(family, below), self.gain_at)

    def largest_for(self, K: ExactMatrix) -> Certificate | None:
        """The certificate of a given gain at the largest period at which it is proved."""
        if self.known is None:
            return None
        K_2 = planar.cleared_gain(self.closed(K, self.T))
        if K_2 is None:
            return None
        family, b = self.known
        scaled = float(arb(K_2 * b).mid())
        return self._last(lambda below: planar.limit_of_gain(family, scaled, below), lambda T: planar.analyse(self.closed(K, T)))

    def _last(self, limit_below: Callable[[float], float], prove: Callable[[Exact], T_ | None]) -> T_ | None:
        """The proof at the limit rounded down, a little below it where balls cannot tell."""
        limit = next((value for value in (limit_below(reach * float(self.T)) for reach in REACH) if value > 0), 0.0)
        for backed_off in (Fraction(0), Fraction(1, 10**5), Fraction(1, 10**4)):
            T = rounded_down(Fraction(limit) * (1 - backed_off), 6)
            found = prove(T) if T.sign() == 1 else None
            if found is not None:
                return found
        return None
