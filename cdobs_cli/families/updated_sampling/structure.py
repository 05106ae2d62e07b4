"""What `validate` sees of this family: the triangular form (1), shapes, a_1 alpha < 1, who chooses the samples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

MAX_STATES = 6


def problems(family: UpdatedSampling, plant: Plant) -> list[Problem]:
    """Mistakes that show without linear algebra."""
    if family.is_carried:
        from cdobs_cli.families.updated_sampling.carried.structure import problems as of_carried

        return of_carried(family, plant)
    n, found = plant.n, list(only_of_carried(family))

    def wrong(what: str, *path: str | int, **more: str) -> None:
        found.append(Problem(path, what, **more))  # type: ignore[arg-type]

    if not plant.sampling.is_updated:
        what, kind = "this observer chooses its sampling instants", plant.sampling.kind
        wrong(what, "measurement", "sampling", got=kind, allowed="{updated: true}")
    if n > MAX_STATES:
        wrong("too many states for this family", "plant", "states", got=str(n), allowed=f"1 to {MAX_STATES}")
    if any(plant.A[i, j] != Exact(int(j == i + 1)) for i in range(n) for j in range(n)):
        what = "a chain of integrators is expected, ones above the diagonal and zeros elsewhere"
        hint = "put the other terms into phi, or use plant.coordinates"
        wrong(what, "plant", "A", got=str(plant.A.texts()), hint=hint)
    if plant.output_quantities:
        what, hint = "this observer takes outputs that are linear in the states", "family reachability takes any output"
        k = plant.output_quantities[0].entry[0]
        wrong(what, "plant", "output", k, got=str((plant.h or ())[k]), allowed="the first state", hint=hint)
    elif plant.p != 1 or any(plant.C[0, j] != Exact(int(j == 0)) for j in range(n)):
        wrong("the first state is measured", "measurement", "C", got=str(plant.C.texts()), allowed="[[1, 0, ..]]")
    for i, j in plant.slopes.entries:
        if family.variant == "last_row" and i != n - 1:
            hint = "variant triangular takes lower triangular ones"
            wrong("variant last_row has slopes in the last row only", "plant", "lipschitz", i, j, hint=hint)
        elif j > i:
            wrong("slopes are lower triangular: phi_i depends on x_1 .. x_i", "plant", "lipschitz", i, j)
    why = "this observer samples when its estimate says so, and means at given instants do not hold at such ones"
    found += family.only_boxes(plant, why)
    gain = family.gain
    if gain is not None and gain.K.shape != (n, 1):
        got = f"{gain.K.shape[0]} x {gain.K.shape[1]}"
        wrong("K has one row per state and one column", "observer", "gain", "K", got=got, allowed=f"{n} x 1")
    if gain is not None and (gain.a1 * gain.alpha - Exact(1)).sign() != -1:
        wrong("a1 alpha < 1 is needed", "observer", "gain", "a1", got=f"a1 {gain.a1}, alpha {gain.alpha}")
    if family.objective == "given_alpha" and family.alpha is None and gain is None:
        wrong("is required with objective given_alpha", "observer", "alpha")
    if family.alpha is not None and (family.objective != "given_alpha" or gain is not None):
        what = "is for objective given_alpha without a given gain"
        wrong(what, "observer", "alpha", hint="a given gain has its own gain.alpha")
    return found


def only_of_carried(family: UpdatedSampling) -> Iterator[Problem]:
    """Options that have no meaning without a certificate that is carried along."""
    for name in ("rule", "budget", "reset", "read", "error_at_most", "law"):
        if getattr(family, name) not in (None, False, "all"):
            yield Problem(("observer", name), "is of method carried", hint="write method: carried, or leave it out")
    if family.objective == "min_error":
        what, hint = "the theorems have no bound of the error under noise", "method: carried does"
        yield Problem(("observer", "objective"), what, family.objective, "max_period, given_alpha", hint=hint)
