"""Lie derivatives, and the coordinates that they make."""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.coordinates.typed import wrong_plant
from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.solve import solve
from cdobs_cli.plant import CoordinateMap, TypedDynamics


def lie_derivative(h: Expression, states: Sequence[str], f: Sequence[Expression]) -> Expression:
    """L_f h = sum_j dh/dx_j f_j, cancelled."""
    return simplify(sum((h.derivative(name) * part for name, part in zip(states, f, strict=True)), ZERO))


def lie_coordinates(typed: TypedDynamics) -> CoordinateMap:
    """z = (h, L_f h, .., L_f^(n-1) h) along the drift f(x, 0), and its inverse by elimination."""
    if len(typed.output) != 1:
        raise wrong_plant("coordinates", "lie takes one output", str(len(typed.output)), "type `map` and `inverse`")
    still: dict[str, Expression] = {source.name: ZERO for source in typed.inputs}
    drift = [simplify(one.substitute(still)) for one in typed.dynamics]
    z = [simplify(typed.output[0])]
    for _ in typed.states[1:]:
        z.append(lie_derivative(z[-1], typed.states, drift))
    box = typed.domain.box.items()
    nonnegative = {name for name, ends in box if ends.lower is not None and ends.lower.sign() in (0, 1)}
    equations = [Variable(name) - one for name, one in zip(typed.names, z, strict=True)]
    inverse = solve(equations, typed.states, nonnegative)
    if inverse is None:
        shown = ", ".join(str(one) for one in z)
        what = "the Lie derivatives could not be solved for the states"
        raise wrong_plant("coordinates", what, shown, "type `map` and `inverse`")
    return CoordinateMap(typed.names, tuple(z), tuple(inverse[name] for name in typed.states))
