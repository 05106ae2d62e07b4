"""What `validate` says about a spec of this family, without linear algebra."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.plant import Plant
from cdobs_cli.run import SimulationPlan

if TYPE_CHECKING:
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.families.interval import Interval

MAX_STATES = 12


def problems(family: Interval, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
    """Mistakes that show in names, shapes and signs."""
    found: list[Problem] = []
    n, p, m = plant.n, plant.p, len(plant.inputs)
    if n > MAX_STATES:
        why = "this observer is built for small plants"
        found.append(Problem(("plant", "states"), why, f"{n} states", f"at most {MAX_STATES}"))
    if plant.sampling.is_updated:
        why, hint = "this observer does not choose its sampling instants", "family updated_sampling does"
        allowed = "{period: ..} or {min_period: .., max_period: ..}"
        found.append(Problem(("measurement", "sampling", "updated"), why, allowed=allowed, hint=hint))
    for i, phi in enumerate(plant.phi):
        if phi.variables & set(plant.states):
            why = "this observer is for linear plants: phi may use the inputs only"
            hint = "write linear terms into A, and bound a nonlinear one by plant.disturbance"
            found.append(Problem(("plant", "phi", i), why, str(phi), '"0"', hint))
    for k, one in enumerate(plant.h or ()):
        why, hint = "this observer takes outputs that are linear in the states", "family reachability takes any output"
        found.append(Problem(("plant", "output", k), why, str(one), "a sum of multiples of states", hint))
    found += family.only_boxes(plant, "the bounds of this observer enclose the state in the worst case")
    if family.gain is not None:
        found += _shape(("observer", "gain", "S"), family.gain.S, (n, n), "one row and one column per state")
        found += _shape(("observer", "gain", "L"), family.gain.L, (n, p), "one row per state, one column per output")
    if family.feedback != "none":
        if plant.B is None or m == 0:
            why = "feedback needs plant.inputs and plant.B"
            found.append(Problem(("observer", "feedback"), why, hint="or feedback: none"))
        elif family.feedback != "design":
            for name in ("K_lower", "K_upper"):
                K: ExactMatrix = getattr(family.feedback, name)
                found += _shape(("observer", "feedback", name), K, (m, n), "one row per input, one column per state")
    if simulation is not None and simulation.initial_box is None:
        why, allowed = "this observer starts from a known box of x(0)", "{lower: [..], upper: [..]}"
        found.append(Problem(("simulation", "initial_box"), why, "nothing", allowed))
    return found


def _shape(field: tuple[str, ...], matrix: ExactMatrix, wanted: tuple[int, int], why: str) -> list[Problem]:
    if matrix.shape == wanted:
        return []
    (rows, columns), (height, width) = matrix.shape, wanted
    return [Problem(field, f"{field[-1]} has {why}", f"{rows} x {columns}", f"{height} x {width}")]
