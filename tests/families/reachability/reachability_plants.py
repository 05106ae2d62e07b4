"""Plants for the tests: chains, feedforward systems, and any A with a slope box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cdobs_cli.exact.expression import ZERO
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

PRINTED = {
    "matrices": [
        [
            [
                ["cos(delta)", "cosh(delta)"],
                ["sin(delta)", "sinh(delta)", "cosh(delta)*tan(delta)", "tanh(delta)*cos(delta)"],
            ],
            [
                ["-sin(delta)", "sinh(delta)"],
                [
                    "cos(delta)",
                    "cosh(delta)",
                    "(1+sinh(delta)*sin(delta))/cos(delta)",
                    "(1+sin(delta)*sinh(delta))/cosh(delta)",
                ],
            ],
        ]
    ]
}


def plant(A: Any, lower: Any, upper: Any, C: Any, T: Any) -> Plant:
    n = len(A)
    law = T if isinstance(T, SamplingLaw) else SamplingLaw.periodic(Exact(T))
    slopes = Slopes(ExactMatrix(lower), ExactMatrix(upper))
    return Plant(tuple(f"x{i}" for i in range(n)), (), ExactMatrix(A), (ZERO,) * n, None, ExactMatrix(C), slopes, law)


def chain(lo: Sequence[Any], hi: Sequence[Any], T: Any, C: Any = None, last: Sequence[Any] | None = None) -> Plant:
    n = len(hi)
    A = [[int(j == i + 1) for j in range(n)] for i in range(n)]
    A[n - 1] = list(last) if last is not None else A[n - 1]
    zeros = [[0] * n for _ in range(n - 1)]
    return plant(A, [*zeros, list(lo)], [*zeros, list(hi)], C or [[1] + [0] * (n - 1)], T)


def symmetric_chain(c: Sequence[Any], T: Any) -> Plant:
    return chain([f"-{value}" for value in c], c, T)


def feedforward(T: Any) -> Plant:
    """The example whose printed set misses reachable errors."""
    zero = [[0, 0, 0]] * 2
    return plant([[0, 1, "0.3"], [0, 0, -1], [0, 0, 0]], [[-1, 0, 0], *zero], [[1, 0, 0], *zero], [[1, 0, 0]], T)
