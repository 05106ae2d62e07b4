"""Whether the outputs see all states, as far as ranks and the pattern of the entries tell: no solver, no floats."""

from __future__ import annotations

from fractions import Fraction

from cdobs_cli.plant import Plant

Entry = tuple[int, int]
_MOST_STATES = 12  # of which the rank is looked at


def unseen_warning(plant: Plant) -> str | None:
    """A sentence where an output never sees a state, or outputs of constant slopes see too few combinations."""
    missing = _never_seen(plant, _may_differ(plant))
    if missing:
        return f"no output ever sees {_left(missing)}; measure another quantity otherwise"
    missing = _never_seen(plant, _surely_differ(plant))
    if missing:
        return (
            f"where entries are 0, which the bounds of the slopes allow, no output sees {_left(missing)}; measure "
            "another quantity, or give slopes as [lower, upper] on one side of 0, where they are"
        )
    rank = _rank(plant)
    if rank is None or rank == plant.n:
        return None
    return (
        f"the outputs see {rank} of {plant.n} independent combinations of the states (observability rank): "
        "the rest has to decay by itself; measure another quantity otherwise"
    )


def _left(states: list[str]) -> str:
    whose = "their errors are" if len(states) > 1 else "its error is"
    return f"{', '.join(states)}: {whose} left to the plant, which has to decay by itself"


def _linear(plant: Plant) -> set[Entry]:
    return {(i, j) for i in range(plant.n) for j in range(plant.n) if plant.A[i, j].sign() != 0}


def _may_differ(plant: Plant) -> tuple[set[Entry], set[Entry]]:
    """Entries of the flow and of the outputs that may differ from 0."""
    outputs = {(k, j) for k in range(plant.p) for j in range(plant.n) if plant.C[k, j].sign() != 0}
    outputs |= set(plant.H.entries) if plant.H is not None else set()
    return _linear(plant) | set(plant.slopes.entries), outputs


def _surely_differ(plant: Plant) -> tuple[set[Entry], set[Entry]]:
    """The same with entries of the flow at 0 where slopes allow it; as before while these are to be found."""
    flow, outputs = _may_differ(plant)
    A, slopes = plant.A, plant.slopes
    if plant.is_to_be_found or slopes.joint:
        return flow, outputs
    away = {
        at for at in slopes.entries if (A[at] + slopes.lower[at]).sign() == 1 or (A[at] + slopes.upper[at]).sign() == -1
    }
    return flow - (set(slopes.entries) - away), outputs


def _never_seen(plant: Plant, entries: tuple[set[Entry], set[Entry]]) -> list[str]:
    """States from which no path of entries leads to an output."""
    flow, outputs = entries
    seen = {j for _, j in outputs}
    while True:
        more = {j for i, j in flow if i in seen} - seen
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
