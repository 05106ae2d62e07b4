"""How large an error can become on the way: level sets of a clock-dependent function.

V = e'P(tau)e never rises, so  e_j(t)^2 <= (P(tau)^-1)_jj V  for all t after the first sample, with V what it is there.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from itertools import product

from flint import arb

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

MAX_VERTICES = 2**12


@dataclass(frozen=True)
class Level:
    """V just after the first sample is at most the largest e_0'M e_0 for an error e_0 before it; afterwards
    e_j^2 <= reach[j] V.

    forms: M at each corner of the jump, shapes (n, n). reach: n upper ends.
    """

    forms: tuple[Matrix, ...]
    reach: tuple[arb, ...]

    def largest(self, start: Box) -> arb:
        """The largest V over a box of e_0: a convex function, at a vertex. Infinite where there are too many."""
        ends = [(low.ball(), high.ball()) for low, high in zip(start.lower, start.upper, strict=True)]
        if 2 ** len(ends) > MAX_VERTICES:
            return arb.pos_inf()
        vertices = (Matrix.from_rows([[value] for value in vertex]) for vertex in product(*ends))
        return _largest(arb((e.T @ M @ e)[0, 0]) for e in vertices for M in self.forms)

    def bounds(self, start: Box) -> tuple[arb, ...]:
        """Upper ends of |e_j(t)|, for all t after the first sample, from any error of the box before it."""
        V = self.largest(start)
        return tuple((reach * V).sqrt().upper() if V.is_finite() else arb.pos_inf() for reach in self.reach)


def constant_level(P: ExactMatrix) -> Level:
    """The level sets of a function that is e'Pe at samples and never below it: P > 0, shape (n, n)."""
    exact = P.balls()
    inverse = exact.inverse()
    return Level((exact,), tuple(arb(inverse[j, j]).upper() for j in range(exact.shape[0])))


def _largest(values: Iterator[arb]) -> arb:
    return reduce(lambda a, b: a.max(b), values).upper()
