"""Whether the outputs see all states, as far as ranks and the pattern of the entries tell: no solver, no floats."""

from __future__ import annotations

from fractions import Fraction

from cdobs_cli.plant import Plant

_MOST_STATES = 12  # of which the rank is looked at


def unseen_warning(plant: Plant) -> str | None:
    """A sentence where an output never sees a state, or outputs of constant slopes see too few combinations."""
    missing = _never_seen(plant)
    if missing:
        told = ", ".join(missing)
        many = len(missing) > 1
        return (
            f"no output ever sees {told}: {'their errors are' if many else 'its error is'} left to the plant, which "
            "has to decay by itself; measure another quantity otherwise"
        )
    rank = _rank(plant)
    if rank is None or rank == plant.n:
        return None
    return (
        f"the outputs see {rank} of {plant.n} independent combinations of the states (observability rank): "
        "the rest has to decay by itself; measure another quantity otherwise"
    )


def _never_seen(plant: Plant) -> list[str]:
    """States from which no path of entries that may differ from 0 leads to an output."""
    entries = {(i, j) for i in range(plant.n) for j in range(plant.n) if plant.A[i, j].sign() != 0}
    entries |= set(plant.slopes.entries)
    outputs = {(k, j) for k in range(plant.p) for j in range(plant.n) if plant.C[k, j].sign() != 0}
    outputs |= set(plant.H.entries) if plant.H is not None else set()
    seen = {j for _, j in outputs}
    while True:
        more = {j for i, j in entries if i in seen} - seen
        if not more:
            return [name for j, name in enumerate(plant.states) if j not in seen]
        seen |= more


def _rank(plant: Plant) -> int | None:
    """Of (C; C F; .. C F^(n-1)), F = A and the constant slopes; None where slopes vary or are irrational, and for many
    states."""
    slopes, n = plant.slopes, plant.n
    if n > _MOST_STATES or plant.is_to_be_found or slopes.uncertain or slopes.joint or plant.H is not None:
        return None
    flow = [[(plant.A[i, j] + slopes.lower[i, j]).rational for j in range(n)] for i in range(n)]
    rows = [[plant.C[k, j].rational for j in range(n)] for k in range(plant.p)]
    F = [[value for value in row if value is not None] for row in flow]
    C = [[value for value in row if value is not None] for row in rows]
    if any(len(row) < n for row in (*F, *C)):
        return None
    basis: list[list[Fraction]] = []
    for _ in range(n):
        fresh = [row for row in (_reduced(row, basis) for row in C) if any(row)]
        for row in fresh:
            left = _reduced(row, basis)
            if any(left):
                basis.append(left)
        C = [[sum((row[i] * F[i][j] for i in range(n)), Fraction(0)) for j in range(n)] for row in fresh]
    return len(basis)


def _reduced(row: list[Fraction], basis: list[list[Fraction]]) -> list[Fraction]:
    """The row without its parts along the basis, whose rows begin at places of their own."""
    row = list(row)
    for one in basis:
        lead = next(j for j, value in enumerate(one) if value)
        if row[lead]:
            factor = row[lead] / one[lead]
            row = [a - factor * b for a, b in zip(row, one, strict=True)]
    return row
