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

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.blocks import BlockProgram, symmetric_basis
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.clock.form import Shape, flow_coefficients, lyapunov
from cdobs_cli.certify.methods.mean_square.average import EPSILONS
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.form import gain_block, kick_block
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
from cdobs_cli.certify.methods.mean_square.setting import Setting, diagonal, errors_only, shape
from cdobs_cli.certify.methods.mean_square.signals import (
    acting,
    has_bounded,
    identity_on,
    largest_sizes,
    noise_floats,
    takes,
)
from cdobs_cli.certify.texts import rational
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


@dataclass(frozen=True)
class PowerGain(Method):
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
    how: ClassVar[str] = "exact Bernstein coefficients"
    statement: ClassVar[str] = "e'P(tau)e pays for |e|^2 with the power of disturbance and noise"
    reach: ClassVar[Reach] = "mean square"
    nonlinear_outputs: ClassVar[bool] = True

    def quantity(self, plant: Plant) -> str:
        """Which bound `Proof.error` is: the root of the time average of sum_i e_i^2."""
        return "rms"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return has_bounded(question.plant) and takes(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """For the errors of all states: where the question is about one, there is none."""
        if question.state is not None or not cls.applies(question):
            return None
        Z = errors_only(question.inclusion, np.ones(question.plant.n))
        setting = Setting.of(question, Z)
        if setting is None:
            return None
        form = shape(question, setting)
        for epsilon in EPSILONS:
            met = PowerSearch(question, setting, form, Z, epsilon).solve()
            if met is None:
                continue
            P, g, nu = met
            made = cls(
                question.law, shape_texts(form), unit_texts(setting.states), texts(P),
                [decimal_text(float(value), DIGITS) for value in g],
                [decimal_text(float(value), DIGITS) for value in nu],
            )  # fmt: skip
            if made.prove(question).holds:
                return made
        return None

    def _prove(self, question: Question) -> Proof:
        plant = question.plant
        if not self.applies(question):
            return NOTHING
        d, v = acting(plant.disturbance), acting(plant.noise)
        g, nu = [rational(text) for text in self.g], [rational(text) for text in self.nu]
        if len(g) != len(d) or len(nu) != len(v):
            return NOTHING
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        P = matrices(self.P, proved.shape, proved.N)
        B, G = proved.noise.drive[:, d], proved.noise.kick[:, v]
        Z = proved.weight(identity_on(plant.n, proved.N))
        if not (positive(P[0]) and _flows(proved, P, Z, B, diagonal(g)) and _kicks(proved, P, G, diagonal(nu))):
            return NOTHING
        d_0, v_0 = largest_sizes(plant.disturbance, plant.n), largest_sizes(plant.noise, plant.p)
        power = sum((fraction_ball(price) * d_0[j] ** 2 for price, j in zip(g, d, strict=True)), arb(0))
        kicks = sum((fraction_ball(price) * v_0[j] ** 2 for price, j in zip(nu, v, strict=True)), arb(0))
        total = power + proved.average(P, kicks)
        return Proof(True, error=total.upper().sqrt().upper()) if total.is_finite() else NOTHING


def _flows(proved: Proved, P: list[Matrix], Z: Matrix, B: Matrix, g: Matrix) -> bool:
    lengths = [h for h in proved.lengths for _ in range(proved.shape.D + 1)]
    coefficients = list(zip(flow_coefficients(P, proved.shape, proved.lengths), lengths, strict=True))
    if not B.shape[1]:
        return proved.flows(P, Z)
    return all(
        positive(gain_block(slope, lyapunov(value, A, 0), Z * h, value @ B, g * h))
        for A in proved.corners
        for (slope, value), h in coefficients
    )


def _kicks(proved: Proved, P: list[Matrix], G: Matrix, nu: Matrix) -> bool:
    if not G.shape[1]:
        return proved.falls(P[0], P)
    numbers = range(proved.shape.jump_from, proved.shape.count)
    return all(positive(kick_block(P[0], P[number], J, G, nu)) for number in numbers for J in proved.jumps)


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
        setting, plant = self.setting, self.question.plant
        d, v = acting(plant.disturbance), acting(plant.noise)
        d_0 = np.array([float(size) for size in largest_sizes(plant.disturbance, plant.n)])[d]
        v_0 = np.array([float(size) for size in largest_sizes(plant.noise, plant.p)])[v]
        r, q = len(d), len(v)
        B, G = setting.drive[:, d] * d_0, setting.kick[:, v] * v_0
        R, Q = noise_floats(plant)
        spread, drift = setting.kick @ R @ setting.kick.T, setting.drive @ Q @ setting.drive.T / setting.T
        largest = [*np.sum(B**2, axis=0), *np.sum(G**2, axis=0), np.trace(spread), np.trace(drift)]
        unit = np.sqrt(max(largest)) or 1.0  # so that prices are about 1
        B, G, spread, drift = B / unit, G / unit, spread / unit**2, drift / unit**2
        curves = Curves(
            self.form, setting.shortest, setting.flows, setting.weight(self.Z)[None], r + q + 1, self.epsilon,
            drive=B if r else None,
        )  # fmt: skip
        g, nu, gamma = curves.last + np.arange(r), curves.last + r + np.arange(q), curves.size - 1
        curves.prices = np.broadcast_to(g, (1, self.form.pieces, r))
        key = ("power", self.form)
        curves.cuts = set(self.question.memory.get(key, ()))
        program, cost = curves.program(), np.zeros(curves.size)
        if q:
            require_kicks(curves, program, setting.jumps, G, nu)
        else:
            curves.require_jumps(program, setting.jumps, 0, 0)
        curves.require_above(program, 0, [0], self.epsilon * np.eye(curves.N))
        rows = -curves.sum_rows(0, drift)[curves.sampled] - curves.start_row(0, spread)
        rows[:, nu] -= 1.0
        rows[:, gamma] += curves.times[curves.sampled]
        program.at_least(rows, np.zeros(len(rows)))
        cost[[*g, gamma]] = 1.0
        x = curves.minimise(cost, program)
        self.question.memory[key] = curves.cuts
        if x is None:
            return None
        return curves.coefficients(x)[0], x[g] * unit**2 / d_0**2 / setting.T, x[nu] * unit**2 / v_0**2


def require_kicks(curves: Curves, program: BlockProgram, jumps: Array, G: Array, nu: Any, share: float = 1.0) -> None:
    """[[share P(tau) - J'P(0)J, -J'P(0)G], [., diag nu - G'P(0)G]] >= epsilon I on [T_min, T_max], at each corner of J;
    nu: its columns."""
    n, q = curves.N, len(nu)
    zero, nothing = np.zeros((n, n)), np.zeros((q, q))
    for J in jumps:
        terms = [kick_block(P, zero, J, G, nothing) for P in curves.basis]
        terms += [kick_block(zero, P * share, J, G, nothing) for P in curves.basis]
        terms += [kick_block(zero, zero, J, G, unit) for unit in symmetric_basis(q) if np.count_nonzero(unit) == 1]
        numbers = range(curves.shape.jump_from, curves.shape.count)
        columns = np.array([[*curves.columns(0, 0), *curves.columns(0, number), *nu] for number in numbers])
        stack = np.broadcast_to(np.array(terms), (len(columns), len(terms), n + q, n + q))
        program.require(columns, stack, -curves.epsilon * np.eye(n + q))
