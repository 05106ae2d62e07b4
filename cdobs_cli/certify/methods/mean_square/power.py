"""The power of the error under bounded disturbance and noise, and its L2 gains.

    edot in Co{A_v} e + B d,    e+ = J e + G v_k.    If on [0, T_max], all corners v,

    [[-(Pdot + P A_v + A_v'P + Z), -P B], [., diag g]] > 0,

and on [T_min, T_max], all corners of J,

    [[P(tau) - J'P(0)J, -J'P(0)G], [., diag nu - G'P(0)G]] > 0,    P(0) > 0,

then int e'Z e <= V(0) + sum_j g_j int d_j^2 + sum_j nu_j sum_k v_jk^2: sqrt(g_j), sqrt(nu_j) are L2 gains, and for any
|d_j| <= d0_j, |v_jk| <= v0_j the time average of e'Z e stays below sum_j g_j d0_j^2 + sum_j nu_j v0_j^2 / T_min. Where
one of them is white instead it adds to E e'P e what it adds to the average form: the average of E e'Z e stays below

    sum_j g_j d0_j^2 + (sum_j nu_j v0_j^2 + tr(R G'P(0)G) + int_0^tau tr(P B Q B')) / tau,    tau in [T_min, T_max].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.driven import Driven
from cdobs_cli.certify.methods.mean_square.polynomial import (
    DIGITS,
    Proved,
    Texts,
    matrices,
    positive,
    shape_of,
    shape_texts,
    texts,
    unit_texts,
)
from cdobs_cli.certify.methods.mean_square.setting import Setting, errors_only
from cdobs_cli.certify.methods.mean_square.signals import (
    identity_on,
    takes,
)
from cdobs_cli.certify.methods.mean_square.subject import MeanSquareOfAll
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


@dataclass(frozen=True)
class PowerGain(MeanSquareOfAll):
    """shape, units, P: as of the average; g, nu: prices of the disturbances and noises that are not 0. Z is the
    identity on the errors."""

    shape: list[str]
    units: list[str]
    P: Texts
    g: list[str]
    nu: list[str]

    name: ClassVar[str] = "power_gain"
    rung: ClassVar[str] = "power_gain"
    source: ClassVar[str] = "clock-dependent quadratic function, L2 gains"
    statement: ClassVar[str] = "e'P(tau)e pays for |e|^2 with the power of disturbance and noise"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.plant.has_bounded and takes(question)

    @classmethod
    def _guess(cls, question: Question, setting: Setting, form: Shape, epsilon: float) -> Self | None:
        Z = errors_only(question.inclusion, np.ones(question.plant.n))
        met = PowerSearch(question, setting, form, Z, epsilon).solve()
        if met is None:
            return None
        P, g, nu = met
        return cls(
            question.law, shape_texts(form), unit_texts(setting.states), texts(P),
            [decimal_text(float(value), DIGITS) for value in g], [decimal_text(float(value), DIGITS) for value in nu],
        )  # fmt: skip

    def _prove(self, question: Question) -> Proof:
        plant = question.plant
        if not self.applies(question):
            return NOTHING
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        (B, G), P = proved.driven, matrices(self.P, proved.shape, proved.N)
        g, nu = proved.prices(self.g, B.shape[1]), proved.prices(self.nu, G.shape[1])
        Z, pieces = proved.weight(identity_on(plant.n, proved.N)), proved.shape.pieces
        if not (positive(P[0]) and proved.falls(P[0], P, G=G, nu=nu) and proved.flows(P, Z, B=B, mu=[g] * pieces)):
            return NOTHING
        total = proved.power(g) + proved.average(P, proved.kicked(nu))
        return Proof(True, error=total.upper().sqrt().upper()) if total.is_finite() else NOTHING


@dataclass
class PowerSearch:
    """minimise sum g d0^2 + sum nu v0^2 / T_min over P, g, nu, in floats and unit time, with signals of size 1."""

    question: Question
    setting: Setting
    form: Shape
    Z: Array
    epsilon: float

    def solve(self) -> tuple[Array, Array, Array] | None:
        """(coefficients of P, g, nu) in the user's units of time and signals: a guess."""
        setting, driven = self.setting, Driven.of(self.setting, self.question.plant)
        r, q = len(driven.d_0), len(driven.v_0)
        curves = Curves(
            self.form, setting.shortest, setting.flows, setting.weight(self.Z)[None], r + q + 1, self.epsilon,
            drive=driven.B if r else None,
        )  # fmt: skip
        g, nu, gamma = curves.last + np.arange(r), curves.last + r + np.arange(q), curves.size - 1
        curves.prices = np.broadcast_to(g, (1, self.form.pieces, r))
        key = ("power", self.form)
        curves.cuts = set(self.question.memory.get(key, ()))
        program, cost = curves.program(), np.zeros(curves.size)
        curves.require_kicks(program, setting.jumps, driven.G, nu, 0, 0)
        curves.require_above(program, 0, [0], self.epsilon * np.eye(curves.N))
        rows = -curves.sum_rows(0, driven.drift)[curves.sampled] - curves.start_row(0, driven.spread)
        rows[:, nu] -= 1.0
        rows[:, gamma] += curves.times[curves.sampled]
        program.at_least(rows, np.zeros(len(rows)))
        cost[[*g, gamma]] = 1.0
        x = curves.minimise(cost, program)
        self.question.memory[key] = curves.cuts
        if x is None:
            return None
        return curves.coefficients(x)[0], driven.flow_prices(x[g]), driven.kick_prices(x[nu])
