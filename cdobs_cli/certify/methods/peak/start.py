"""Where a transient starts: the error just after the first sample, from a known box of errors before it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

from cdobs_cli.certify.methods.peak.signals import Signals
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.plant import Box

MOST_VERTICES = 2**10


def first_vertices(maps: ErrorMaps[Matrix], signals: Signals[Matrix], start: Box) -> list[Matrix] | None:
    """J (e_0; .) + G v at the corners of e_0, v and J, (N, 1) each; None where a further state outlives the sample, or
    there are too many.

    Functions convex in each of e_0, v and J by itself are largest at one of them.
    """
    n, jumps = len(start.lower), list(maps.jumps())
    N = maps.base.shape[0]
    rest = list(range(n, N))
    if not all(value == 0 for J in jumps for row in J[:, rest].tolist() for value in row):
        return None
    ends = [_ends(low, high) for low, high in zip(start.lower, start.upper, strict=True)]
    kicks = list(_kicks(signals))
    count = len(jumps) * len(kicks)
    for values in ends:
        count *= len(values)
    if count > MOST_VERTICES:
        return None
    errors = [Matrix.from_rows([[value] for value in vertex]) for vertex in product(*ends)]
    return [J[:, list(range(n))] @ e + kick for J in jumps for e in errors for kick in kicks]


def _ends(low: Exact, high: Exact) -> tuple[Any, ...]:
    return (low.scalar,) if low == high else (low.scalar, high.scalar)


def _kicks(signals: Signals[Matrix]) -> Iterator[Matrix]:
    """G v at the corners of |v_j| <= v0_j."""
    for signs in product((-1, 1), repeat=len(signals.v0)):
        v = [[size * sign] for size, sign in zip(signals.v0, signs, strict=True)]
        yield signals.G @ Matrix.from_rows(v) if v else Matrix.zeros(signals.G.shape[0], 1)
