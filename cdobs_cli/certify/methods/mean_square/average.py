"""The mean square of the error over time, under white noise and a white disturbance.

    edot in Co{A_v} e + B d,    e+ = J e + G v_k,    E[v_k v_k' | past] <= R,    d white of intensity Q,

V(t) any adapted process of the slope box: it may depend on e. If for P piecewise polynomial and continuous

    Pdot + P A_v + A_v'P + Z < 0 on [0, T_max],    P(tau) - J'P(0)J > 0 on [T_min, T_max],    P(0) > 0,

then U = e'P(tau)e + s(tau), with s = gamma tau - int_0^tau tr(P B Q B'), does not rise at samples in expectation and
grows by gamma - E e'Z e per time at most between them, wherever

    gamma tau >= tr(R G'P(0)G) + int_0^tau tr(P B Q B')    for tau in [T_min, T_max],

so the average of E e'Z e stays below gamma, also where T_k depends on the error. The least such gamma is read off the
Bernstein coefficients. The bound holds for P, never for a covariance Sigma' >= A_v Sigma + Sigma A_v' + B Q B': that is
false where V depends on e.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.aim import Aim
from cdobs_cli.certify.methods.mean_square.curves import Curves, Cut
from cdobs_cli.certify.methods.mean_square.polynomial import (
    Proved,
    Texts,
    matrices,
    positive,
    shape_of,
    shape_texts,
    texts,
    unit_texts,
)
from cdobs_cli.certify.methods.mean_square.setting import EPSILONS, Setting, padded, shape
from cdobs_cli.certify.methods.mean_square.signals import identity_on, noise_floats, takes
from cdobs_cli.certify.methods.mean_square.subject import MeanSquareOfAll
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_DIGITS = 17
_MOVED = 1e-6  # of a gain's largest entry


@dataclass(frozen=True)
class Average(MeanSquareOfAll):
    """shape: degree d of P, elevated degree D, pieces on [0, T_min] and [T_min, T_max]; units: e_i = units_i z_i; P:
    the upper triangles of the Bernstein coefficients of z'P(tau)z. Z is the identity on the errors."""

    shape: list[str]
    units: list[str]
    P: Texts

    name: ClassVar[str] = "mean_square"
    rung: ClassVar[str] = "mean_square"
    source: ClassVar[str] = "clock-dependent quadratic function, adapted slopes"
    statement: ClassVar[str] = (
        "e'P(tau)e pays for |e|^2 with what white noise and disturbance add, whatever slopes and periods depend on"
    )

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.plant.has_only_white and takes(question)

    @classmethod
    def _guess(cls, question: Question, setting: Setting, form: Shape, epsilon: float) -> Self | None:
        aim = Aim(np.eye(question.plant.n), *noise_floats(question.plant), 0.0)
        met = AverageSearch.of(setting, form, aim, epsilon).solve(question.memory)
        return None if met is None else cls(question.law, shape_texts(form), unit_texts(setting.states), texts(met[1]))

    def _prove(self, question: Question) -> Proof:
        if not self.applies(question):
            return NOTHING
        n = question.plant.n
        proved = Proved.of(question, shape_of(self.shape, self.law), self.units)
        P = matrices(self.P, proved.shape, proved.N)
        Z = proved.weight(identity_on(n, proved.N))
        if not (positive(P[0]) and proved.falls(P[0], P) and proved.flows(P, Z)):
            return NOTHING
        gamma = proved.average(P, arb(0))
        return Proof(True, error=gamma.upper().sqrt().upper()) if gamma.is_finite() else NOTHING


@dataclass
class AverageSearch:
    """minimise gamma over P, in floats and unit time; unknowns: P, gamma."""

    curves: Curves
    jumps: Array
    spread: Array
    drift: Array
    T: float

    @staticmethod
    def of(setting: Setting, form: Shape, aim: Aim, epsilon: float) -> AverageSearch:
        Z = setting.weight(padded(aim.Z, setting.N))[None]
        curves = Curves(form, setting.shortest, setting.flows, Z, 1, epsilon, aim.sigma * setting.T)
        spread = setting.kick @ aim.R @ setting.kick.T
        drift = setting.drive @ aim.Q @ setting.drive.T / setting.T
        return AverageSearch(curves, setting.jumps, spread, drift, setting.T)

    def solve(self, memory: dict[Any, Any]) -> tuple[float, Array] | None:
        """(root of gamma, coefficients of P): a guess."""
        met = self.solve_with_multipliers(memory)
        return None if met is None else (self.root(met[0][-1]), self.curves.coefficients(met[0])[0])

    def solve_with_multipliers(self, memory: dict[Any, Any]) -> tuple[Array, Array] | None:
        """The unknowns, gamma / size the last of them, and the multipliers of `posed`."""
        curves, key = self.curves, ("average", self.curves.shape)
        curves.cuts = set(memory.get(key, ()))
        met = curves.minimise_with_multipliers(self._gamma, self._posed(self.size))
        memory[key] = curves.cuts
        return met

    def root(self, gamma: float) -> float:
        """The root of the average, gamma in parts of the size."""
        return float(np.sqrt(max(gamma, 0.0) * self.size / self.T))

    @property
    def size(self) -> float:
        """Of what is added."""
        return max(float(np.abs(self.spread).max()), float(np.abs(self.drift).max())) or 1.0

    @property
    def _gamma(self) -> Array:
        gamma = np.zeros(self.curves.size)
        gamma[-1] = 1.0
        return gamma

    def slack(self, x: Array, size: float, cuts: set[Cut]) -> Array:
        """What is left of every inequality at these unknowns, the flow's at these cuts."""
        self.curves.cuts = cuts
        return self.curves.with_flow(self._posed(size)).slack(x)

    def _posed(self, size: float) -> BlockProgram:
        """All but the flow inequality."""
        curves, program = self.curves, self.curves.program()
        curves.require_jumps(program, self.jumps, 0, 0)
        curves.require_above(program, 0, [0], curves.epsilon * np.eye(curves.N))
        rows = -curves.sum_rows(0, self.drift / size) - curves.start_row(0, self.spread / size)
        rows = rows[curves.sampled] + curves.times[curves.sampled, None] * self._gamma
        program.at_least(rows, np.zeros(len(rows)))
        return program


def amplification(question: Question, aim: Aim) -> float | None:
    """The root of the average of e'Z e of the question's gain, the aim's rate kept: a guess; None where the solver
    finds none."""
    setting = Setting.of(question, padded(aim.Z, question.inclusion.floats.base.shape[0]))
    if setting is None:
        return None
    met = AverageSearch.of(setting, shape(question, setting, for_search=True), aim, EPSILONS[0]).solve(question.memory)
    return None if met is None else met[0]


def amplification_slope(question: Question, aim: Aim, letter: str) -> tuple[float, Array] | None:
    """`amplification`, and its derivative by the entries of the gain, (n, p).

    By the multipliers z of the program: d gamma = -z'd(slack), the slack of its inequalities taken at the same unknowns
    for a gain moved a little."""
    setting = Setting.of(question, padded(aim.Z, question.inclusion.floats.base.shape[0]))
    if setting is None:
        return None
    form = shape(question, setting, for_search=True)
    search = AverageSearch.of(setting, form, aim, EPSILONS[0])
    met = search.solve_with_multipliers(question.memory)
    if met is None:
        return None
    x, z = met
    gain, root, cuts = question.gain(letter).floats, search.root(x[-1]), search.curves.cuts
    here, step = search.slack(x, search.size, cuts), _MOVED * float(np.abs(gain).max() or 1.0)
    slope = np.zeros(gain.shape)
    for i, j in np.ndindex(*gain.shape):
        moved = gain.copy()
        moved[i, j] += step
        about = question.with_gain({letter: ExactMatrix.from_floats(moved, _DIGITS)})
        there = AverageSearch.of(Setting.in_units(about, setting.states), form, aim, EPSILONS[0])
        slope[i, j] = -float(z @ (there.slack(x, search.size, cuts) - here)) / step
    return root, slope * search.size / search.T / (2 * root) if root else slope
