"""Typed dynamics made a Plant, and the way back to the user's states.

    xdot = f(x, u) + d,  y = h(x) + v;   z = T(x):   zdot = A z + phi(z, u) + B u + (dT/dx) d,  y = C z + v

With `coordinates: lie`, T = (h, L_f h, .., L_f^(n-1) h) along the drift f(x, 0): A is a chain of integrators
and C = [1 0 .. 0]. Families see only the Plant.
"""

from __future__ import annotations

from cdobs_cli.coordinates.change import Coordinates, transformed
from cdobs_cli.coordinates.split import split
from cdobs_cli.coordinates.typed import wrong_plant
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.plant import Plant, TypedDynamics


def derive(typed: TypedDynamics) -> tuple[Plant, Coordinates | None]:
    """The Plant behind typed dynamics, and the way back where its coordinates are not the typed states.

    Raises:
        SpecError: no such coordinates are found, an output is not linear in them, an image has no bound.
    """
    try:
        return (split(typed), None) if typed.coordinates is None else transformed(typed, typed.coordinates)
    except (ExpressionError, ZeroDivisionError) as error:
        name = "dynamics" if typed.coordinates is None else "coordinates"
        raise wrong_plant(name, f"the plant has no value: {error}") from None


__all__ = ["Coordinates", "derive"]
