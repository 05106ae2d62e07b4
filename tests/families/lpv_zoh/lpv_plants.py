"""Plants that the tests of this family share."""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

PRINTED_L = ExactMatrix([["8.7188"], ["7.0571"]])
PRINTED_P = ExactMatrix([["0.42729", "-0.45686"], ["-0.45686", "0.5924"]])
PRINTED_Y = ExactMatrix([["0.50133"], ["0.19737"]])
PRINTED_VERTICES = tuple(ExactMatrix([[0, 1], [a, b]]) for b in ("-0.3", "0.3") for a in ("-0.3", "0.3"))


def up_to(T: str) -> SamplingLaw:
    """Any T_k <= T."""
    return SamplingLaw("aperiodic", Exact(0), Exact(T))


def family(**options: object) -> LpvZeroOrderHold:
    """The card."""
    return LpvZeroOrderHold.model_validate({"family": "lpv_zoh", **options})


def linear_class(
    A: Sequence[Sequence[str]],
    C: Sequence[Sequence[str]],
    slopes: dict[tuple[int, int], tuple[str, str]],
    law: SamplingLaw,
) -> Plant:
    """A plant by its matrices and slopes; its own phi is the member with the upper slopes."""
    n = len(A)
    names = tuple(f"x{i + 1}" for i in range(n))
    rows = [
        " + ".join(f"({high})*{names[j]}" for (row, j), (_, high) in slopes.items() if row == i) or "0"
        for i in range(n)
    ]
    ends = [[[slopes.get((i, j), ("0", "0"))[k] for j in range(n)] for i in range(n)] for k in (0, 1)]
    phi = tuple(parse(row, frozenset(names)) for row in rows)
    return Plant(
        names, (), ExactMatrix(A), phi, None, ExactMatrix(C), Slopes(ExactMatrix(ends[0]), ExactMatrix(ends[1])), law
    )


def sine(law: SamplingLaw | None = None) -> Plant:
    """The example of Boukal2020: a double integrator with 0.3 sin x1."""
    return linear_class([["0", "1"], ["0", "0"]], [["1", "0"]], {(1, 0): ("-0.3", "0.3")}, law or up_to("0.1"))


def scalar(tau: str) -> Plant:
    """xdot = 0, y = x: with L = 1 the error is edot = -e(t_k)."""
    return linear_class([["0"]], [["1"]], {}, up_to(tau))


def two_outputs(law: SamplingLaw | None = None) -> Plant:
    """Two coupled oscillators, both positions measured."""
    A = [["0", "1", "0", "0"], ["-1", "0", "1/2", "0"], ["0", "0", "0", "1"], ["1/2", "0", "-1", "0"]]
    return linear_class(
        A,
        [["1", "0", "0", "0"], ["0", "0", "1", "0"]],
        {(1, 0): ("-0.2", "0.2"), (3, 2): ("-0.2", "0.2")},
        law or up_to("0.4"),
    )
