"""The observer (5)-(7) as equations."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ONE, Number, Variable, power
from cdobs_cli.families.updated_sampling import SCALARS
from cdobs_cli.families.updated_sampling.lipschitz import HAT, Rate
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

L, M = "gain.L", "gain.M"
LARGEST_L = 10**6
_GROWN = "the gain L grows beyond 1e6: c(x_hat, u) is not bounded along the estimate"


def observer(plant: Plant, design: Design, rate: Rate) -> Observer:
    """x_hat' = A x_hat + phi(sat x_hat, u) + B u,  L' = a_2 L M c(sat x_hat, u),  M' = a_3 M c, and at a sample

        x_hat+ = x_hat + delta_k calL K (C x_hat - y),  L+ = L (1 - a_1 alpha) + a_1 alpha,  M+ = 1.

    The next sample is when (t - t_k) L(t) = alpha. L(0) = 1, no jump at t_0; sat cuts to the box of the domain.
    Source: Andrieu2014, (5)-(7)
    Deviates: the printed jump has delta_k of the period to come, which is not known yet; it is the one that ends.
    """
    K = design.gain["K"]
    alpha, a_1, a_2, a_3 = (design.gain[name][0, 0].expression for name in SCALARS)
    hat = tuple(HAT + name for name in plant.states)
    inside = plant.clipped(HAT)
    cut = replace(plant, phi=tuple(one.substitute(inside) for one in plant.phi))
    elapsed, gain_L, gain_M = Variable("elapsed"), Variable(L), Variable(M)
    innovation = plant.outputs(HAT)[0] - Variable("y.0")
    c = rate.c.substitute(inside)
    high = [elapsed * power(gain_L, Fraction(i + 1)) * K[i, 0].expression for i in range(plant.n)]
    return Observer(
        states=(*hat, L, M),
        start=(*(Variable(f"initial.{name}") for name in plant.states), ONE, ONE),
        flow=(*cut.right_hand_side(HAT), a_2 * gain_L * gain_M * c, a_3 * gain_M * c),
        jump=(
            *(Variable(name) + k * innovation for name, k in zip(hat, high, strict=True)),
            gain_L * (ONE - a_1 * alpha) + a_1 * alpha,
            ONE,
        ),
        estimates={"x_hat": tuple(Variable(name) for name in hat)},
        jump_at_start=False,
        trigger=elapsed * gain_L - alpha,
        internals={"L": gain_L, "c": c},
        stops=((Number(LARGEST_L) - gain_L, _GROWN),),
    )
