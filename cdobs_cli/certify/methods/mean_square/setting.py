"""The error system as the searches read it: floats, unit time, states in units in which P is about 1."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import basis
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# Margins asked of the solver, relative to P about 1: the first that a proof bears.
EPSILONS = (1e-9, 1e-8, 1e-7, 1e-6)
_DOUBLINGS = 5
_FEW = 6
ALL_AT_ONCE = 4
_SCHEDULE = ((3, 4, 2), (4, 5, 2), (4, 5, 4), (5, 6, 6), (6, 7, 10))  # (d, D, pieces), coarse to fine
_LARGEST = 1200  # unknowns
_FEW_STATES = 2  # of which fine functions cost little, and coarse ones are far off from T_min = 0


@dataclass(frozen=True)
class Setting:
    """flows (V, N, N): the corners of the flow over unit time; jumps (W, N, N); kick (N, p), drive (N, n): of noise and
    disturbance; states: e = diag(states) z; T: T_max; shortest: T_min / T_max."""

    flows: Array
    jumps: Array
    kick: Array
    drive: Array
    states: Array
    T: float
    shortest: float

    @staticmethod
    def of(question: Question, Z: Array) -> Setting | None:
        """The error system of the question's gain, in units for errors weighted by Z (N, N); None where a number of it
        is not finite."""
        plain = Setting.in_units(question, units(question.inclusion))
        if not plain.is_finite:
            return None
        return Setting.in_units(question, plain.natural(Z))

    @staticmethod
    def in_units(question: Question, states: Array) -> Setting:
        inclusion, law = question.inclusion, question.law
        maps, noise, T = inclusion.floats, inclusion.noise_floats, float(law.T_max)
        ratio = states / states[:, None]
        corners = [maps.flow(v) for v in product(*zip(maps.lower, maps.upper, strict=True))]
        return Setting(
            np.array(corners) * ratio * T, np.array(list(maps.jumps())) * ratio, noise.kick / states[:, None],
            noise.drive / states[:, None] * T, states, T, float(law.T_min) / T,
        )  # fmt: skip

    @property
    def N(self) -> int:
        return int(self.states.shape[0])

    @property
    def is_finite(self) -> bool:
        return all(bool(np.all(np.isfinite(part))) for part in (self.flows, self.jumps, self.kick, self.drive))

    @property
    def all_at_once(self) -> bool:
        """Whether the corners of the flow are so few that a search reads them all from the start."""
        return len(self.flows) <= ALL_AT_ONCE

    def weight(self, Z: Array) -> Array:
        """A form of e as one of z over unit time: int e'Z e dt = int z'(..)z ds."""
        value: Array = Z * self.states * self.states[:, None] * self.T
        return value

    def natural(self, Z: Array) -> Array:
        """The units in which the first 2^5 terms of sum_k int |e|_Z^2 over interval k, from a unit error, are 1: the
        most over some constant corners. Powers of 2."""
        weight, most = self.weight(Z), np.zeros(self.N)
        for A, J in product(_some(self.flows), _some(self.jumps)):
            with np.errstate(all="ignore"):
                size = np.diag(_first_terms(A, J, weight))
            if np.all(np.isfinite(size)):
                most = np.maximum(most, size)
        # A state that adds next to nothing keeps its plain unit.
        known = most > 1e-12 * most.max(initial=0.0)
        factor = [2.0 ** -round(math.log2(value) / 2) if one else 1.0 for value, one in zip(most, known, strict=True)]
        scaled: Array = self.states * np.array(factor)
        return scaled


def _first_terms(A: Array, J: Array, weight: Array) -> Array:
    """sum_(k < 2^5) M'^k (int_0^1 exp(A's) weight exp(A s) ds) M^k, M = J exp(A)."""
    N = len(A)
    F = exponentials(np.block([[-A.T, weight], [np.zeros((N, N)), A]])[None])[0]
    Phi = F[N:, N:]
    P: Array = Phi.T @ F[:N, N:]
    M: Array = J @ Phi
    for _ in range(_DOUBLINGS):
        P, M = P + M.T @ P @ M, M @ M
    return P


def _some(matrices: Array) -> Array:
    """A few corners that differ much."""
    count = len(matrices)
    return matrices if count <= _FEW else matrices[[round(k * (count - 1) / (_FEW - 1)) for k in range(_FEW)]]


def units(inclusion: HybridInclusion) -> Array:
    """The units of the clock certificate, shape (N,)."""
    return np.array([float(row[i]) for i, row in enumerate(basis(inclusion))])


def padded(Z: Array, N: int) -> Array:
    """diag(Z, 0), shape (N, N)."""
    whole = np.zeros((N, N))
    whole[: len(Z), : len(Z)] = Z
    return whole


def errors_only(inclusion: HybridInclusion, weights: Array) -> Array:
    """diag(weights, 0), shape (N, N): weights of the n errors, none of what else the error system holds."""
    return padded(np.diag(weights), inclusion.floats.base.shape[0])


def shape(question: Question, setting: Setting, functions: int = 1, *, for_search: bool = False) -> Shape:
    """Degrees and pieces of so many functions, by effort: of one alone finer ones, but for a search that only compares
    gains of more than two states; T_min is a break point."""
    law, N = question.law, setting.N
    finer = 0 if for_search and question.plant.n > _FEW_STATES else 1
    step = question.level + finer if functions == 1 else max(0, question.level - (0 if setting.all_at_once else 1))
    while step and functions * (_SCHEDULE[step][0] * _SCHEDULE[step][2] + 1) * N * (N + 1) // 2 > _LARGEST:
        step -= 1
    d, D, pieces = _SCHEDULE[step]
    if law.is_periodic:
        return Shape(d, D, pieces, 0)
    if law.from_zero:
        return Shape(d, D, 0, pieces)
    before = max(1, min(pieces - 1, round(pieces * float(law.T_min) / float(law.T_max))))
    return Shape(d, D, before, pieces - before)
