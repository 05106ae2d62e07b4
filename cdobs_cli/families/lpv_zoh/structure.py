"""What `validate` sees of this family: shapes, options that contradict one another, the class (16)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold


def is_class_16(plant: Plant) -> bool:
    """A chain of n >= 2 integrators with slopes in the last row, measured at its first state.

    Source: Boukal2020, (16)
    """
    return plant.n >= 2 and plant.is_canonical


def problems(family: LpvZeroOrderHold, plant: Plant) -> list[Problem]:
    """Mistakes that show without linear algebra."""
    found: list[Problem] = []
    n, p = plant.n, plant.p

    def shape(path: tuple[str | int, ...], matrix: ExactMatrix, rows: int, columns: int) -> None:
        if matrix.shape != (rows, columns):
            got = f"{matrix.shape[0]} x {matrix.shape[1]}"
            found.append(
                Problem(
                    ("observer", *path), "a matrix of another shape is expected", got=got, allowed=f"{rows} x {columns}"
                )
            )

    if plant.sampling.is_updated:
        found.append(
            Problem(("measurement", "sampling", "updated"), "this observer does not choose its sampling instants",
                    allowed="{period: ..} or {min_period: .., max_period: ..}", hint="family updated_sampling does")
        )  # fmt: skip
    if family.method not in ("best", "clock") and plant.output_quantities:
        what = f"method {family.method} is for outputs that are linear in the states"
        found.append(Problem(("observer", "method"), what, family.method, "best or clock"))
    if family.gain is not None:
        shape(("gain", "L"), family.gain.L, n, p)
    if family.method in ("repaired", "theorem_1") and not is_class_16(plant):
        found.append(
            Problem(("observer", "method"), "Theorem 1 is for a chain of two or more integrators with slopes in "
            "the last row, "
                    "measured at its first state", got=family.method, hint="method best, clock or wirtinger "
                    "takes any plant")
        )  # fmt: skip
    if family.printed is not None:
        if not is_class_16(plant):
            found.append(
                Problem(("observer", "printed"), "Theorem 1 is for a chain of two or more integrators with "
                "slopes in the last row, "
                        "measured at its first state", hint="leave `printed` out")
            )  # fmt: skip
        shape(("printed", "P"), family.printed.P, n, n)
        shape(("printed", "Y"), family.printed.Y, n, p)
        P = family.printed.P
        if P.shape == (n, n) and any(P[i, j] != P[j, i] for i in range(n) for j in range(i)):
            found.append(Problem(("observer", "printed", "P"), "a symmetric matrix is expected"))
        for k, vertex in enumerate(family.printed.vertices or ()):
            shape(("printed", "vertices", k), vertex, n, n)
    return found
