"""What `validate` sees of this family: the triangular form (1), shapes, a_1 alpha < 1, who chooses the samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

MAX_STATES = 6


def problems(family: UpdatedSampling, plant: Plant) -> list[Problem]:
    """Mistakes that show without linear algebra."""
    n, found = plant.n, []
    if not plant.sampling.is_updated:
        found.append(
            Problem(("measurement", "sampling"), "this observer chooses its sampling instants", got=plant.sampling.kind,
                    allowed="{updated: true}")
        )  # fmt: skip
    if n > MAX_STATES:
        found.append(Problem(("plant", "states"), "too many states for this family", got=str(n), allowed=f"1 to {MAX_STATES}"))
    if any(plant.A[i, j] != Exact(int(j == i + 1)) for i in range(n) for j in range(n)):
        found.append(
            Problem(("plant", "A"), "a chain of integrators is expected, ones above the diagonal and zeros elsewhere",
                    got=str(plant.A.texts()), hint="put the other terms into phi, or use plant.coordinates")
        )  # fmt: skip
    if plant.p != 1 or any(plant.C[0, j] != Exact(int(j == 0)) for j in range(n)):
        found.append(Problem(("measurement", "C"), "the first state is measured", got=str(plant.C.texts()), allowed="[[1, 0, ..]]"))
    for i, j in plant.slopes.entries:
        if family.variant == "last_row" and i != n - 1:
            found.append(
                Problem(("plant", "lipschitz", i, j), "variant last_row has slopes in the last row only", hint="variant triangular takes "
                        "lower triangular ones")
            )  # fmt: skip
        elif j > i:
            found.append(Problem(("plant", "lipschitz", i, j), "slopes are lower triangular: phi_i depends on x_1 .. x_i"))
    found.extend(_gain_problems(family, n))
    if family.objective == "given_alpha" and family.alpha is None and family.gain is None:
        found.append(Problem(("observer", "alpha"), "is required with objective given_alpha"))
    if family.alpha is not None and (family.objective != "given_alpha" or family.gain is not None):
        found.append(
            Problem(("observer", "alpha"), "is for objective given_alpha without a given gain", hint="a given gain has its own gain.alpha")
        )  # fmt: skip
    return found


def _gain_problems(family: UpdatedSampling, n: int) -> list[Problem]:
    gain = family.gain
    if gain is None:
        return []
    found = []
    if gain.K.shape != (n, 1):
        got = f"{gain.K.shape[0]} x {gain.K.shape[1]}"
        found.append(Problem(("observer", "gain", "K"), "K has one row per state and one column", got=got, allowed=f"{n} x 1"))
    if (gain.a1 * gain.alpha - Exact(1)).sign() != -1:
        found.append(Problem(("observer", "gain", "a1"), "a1 alpha < 1 is needed", got=f"a1 {gain.a1}, alpha {gain.alpha}"))
    return found
