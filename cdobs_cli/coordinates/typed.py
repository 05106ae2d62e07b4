"""Typed dynamics as the plant that claims are about, and mistakes in them."""

from __future__ import annotations

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.plant import Plant, Slopes, TypedDynamics


def typed_plant(typed: TypedDynamics) -> Plant:
    """The typed dynamics as a Plant with A = 0: for claims in the typed states."""
    n = len(typed.states)
    zero = ExactMatrix([[0] * n] * n)
    C = ExactMatrix([[0] * n])
    return Plant(
        typed.states, typed.inputs, zero, typed.dynamics, None, C, Slopes(zero, zero), typed.sampling, typed.domain,
        typed.disturbance,
    )  # fmt: skip


def wrong_plant(name: str, what: str, got: str | None = None, hint: str | None = None) -> SpecError:
    """A mistake at a key of the plant."""
    return SpecError((Problem(("plant", name), what, got, hint=hint),))
