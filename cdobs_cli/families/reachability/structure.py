"""Which constructions of the set M a plant's structure admits, and what `validate` says about it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability.given_gain import gain_problems
from cdobs_cli.families.reachability.on_change import on_change_problems
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability


def is_chain(plant: Plant) -> bool:
    """A is a chain of integrators above any last row, and slopes occur in the last row only.

    Source: Dinh2014, Assumption 3 (which has a last row of zeros; C does not matter for the set)
    """
    n = plant.n
    return all(plant.A[i, j] == Exact(1 if j == i + 1 else 0) for i in range(n - 1) for j in range(n)) and all(
        i == n - 1 for i, _ in plant.slopes.entries
    )


def has_clarke_set(plant: Plant) -> bool:
    """Whether `set: clarke` can be built: chains (Theorem III.2) and feedforward systems (Theorem III.1)."""
    return is_chain(plant) or plant.is_feedforward


def problems(family: Reachability, plant: Plant) -> list[Problem]:
    """Mistakes that show without linear algebra."""
    found: list[Problem] = []
    n = plant.n
    observer = ("observer",)
    if plant.sampling.is_updated:
        found.append(
            Problem(("measurement", "sampling", "updated"), "this observer does not choose its sampling instants",
                    allowed="{period: ..} or {min_period: .., max_period: ..}", hint="family updated_sampling does")
        )  # fmt: skip
    if plant.sampling.is_on_change:
        found += on_change_problems(family, plant)
    if family.gain is not None:
        found += gain_problems(family.gain.K, plant)
    if family.set != "clarke":
        if family.method == "clock":
            found.append(
                Problem((*observer, "set"), "method clock uses no set of matrices", allowed="method: best or "
                "method: set")
            )  # fmt: skip
        for k, matrix in enumerate(family.set.matrices):
            if len(matrix) != n or any(len(row) != n for row in matrix):
                lengths = ", ".join(str(len(row)) for row in matrix)
                found.append(
                    Problem((*observer, "set", "matrices", k), "a matrix of the set has one row and one column "
                    "per state",
                            got=f"rows of {lengths or 'nothing'}", allowed=f"{n} x {n}")
                )  # fmt: skip
            for i, row in enumerate(matrix):
                found.extend(
                    Problem((*observer, "set", "matrices", k, i, j), "an entry lists at least one value", got="[]")
                    for j, entry in enumerate(row)
                    if entry == ()
                )
        if not family.set.matrices:
            found.append(Problem((*observer, "set", "matrices"), "the set holds at least one matrix", got="[]"))
    if family.method == "set":
        if plant.output_quantities:
            what, got = "the set of matrices is built for outputs that are linear in the states", "method set"
            found.append(Problem((*observer, "method"), what, got, hint="method best or clock takes any output"))
        if plant.sampling.has_sensors:
            what, hint = "the set of matrices is built for outputs that are read together", "method best or clock"
            found.append(Problem((*observer, "method"), what, "method set", hint=hint))
        elif not (plant.sampling.is_periodic or plant.sampling.is_updated or plant.sampling.is_on_change):
            found.append(
                Problem(
                    ("measurement", "sampling"),
                    "the set of matrices is built for one period",
                    got="a range of periods",
                    allowed="{period: ..}",
                    hint="method best or clock takes a range",
                )
            )
        if not has_clarke_set(plant):
            found.append(
                Problem((*observer, "method"), "the set is known for chains of integrators with slopes in the "
                "last row, and for "
                        "upper triangular A and slopes", got="a plant of another structure", hint="method best "
                        "or clock takes any plant")
            )  # fmt: skip
    return found
