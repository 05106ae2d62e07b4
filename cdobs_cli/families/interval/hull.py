"""The hull predictor: a centre that copies the model and a radius that bounds its error exactly from sample to
sample. It needs neither positivity nor the structure of Assumption 3.

    c' = A c + B u + d_mid + L (y_k - v_mid - C c(t_k)),    F(s) = exp(A s) - Gamma_A(s) L C
    rho_(k+1) = |S F(T_k) S^-1| rho_k + integral_0^T_k |S exp(A r)| dr d_rad + |S Gamma_A(T_k) L| v_rad
    |x - c| <= |F(s) S^-1| rho_k + integral_0^s |exp(A r)| dr d_rad + |Gamma_A(s) L| v_rad  at t_k + s

It stays bounded where |S F(s) S^-1| contracts in one weighted norm for every period of the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from typing import Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.lmi import Program, diagonal, full
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.held import (
    contraction,
    contracts,
    flow,
    growing_period,
    growth,
    growth_and_slope,
    held_maps,
    interval,
    law_ends,
    tried_periods,
)
from cdobs_cli.families.interval.method import DIGITS, Part, largest_margin
from cdobs_cli.families.interval.parts import absolute, entries, highest, lower_of
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import width_flow
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_WIDTH = Fraction(1, 1000)
_PERIODS = 24
_PIECES, _ROUNDS = 96, 40


@dataclass(frozen=True)
class Hull(Part):
    """Weights w > 0, shape (n, 1), in which |S F(s) S^-1| contracts."""

    w: ExactMatrix

    name = "hull"
    rung = "contraction"
    how = "weighted norm, ball arithmetic in s"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        system = System.of(question)
        w = _weights(system, question.law)
        return None if w is None else cls(question.law, w).proved(question)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        return search.longest(lambda T: cls.propose(question.at(T)), question.law.T_max, _WIDTH)

    @classmethod
    def stored(cls, question: Question) -> Sequence[Part]:
        if question.card.tighten == "hull":
            return super().stored(question)
        hull = cls.propose(question)
        return [] if hull is None else [hull]

    def _prove(self, question: Question) -> Proof:
        """|S F(s) S^-1| w <= (1 - rate s) w, rate > 0, for every period s of the law."""
        system, w = System.of(question), self.w.balls()
        return Proof.of(w.shape == (system.n, 1) and contracts(lambda s: hull_growth(system, s), w, self.law))


def hull_growth(system: System, s: arb) -> tuple[Matrix, Matrix]:
    """Phi(s) and Phi'(s) with S F(s) S^-1 = I + s Phi(s)."""
    Phi, slope = growth_and_slope(*system.predicted, s)
    return system.z.S @ Phi @ system.z.R, system.z.S @ slope @ system.z.R


def _weights(system: System, law: SamplingLaw) -> ExactMatrix | None:
    """w by a linear program over some periods of the law, largest common rate."""
    z, n, (A, closed) = system.floats, system.n, (M.floats for M in system.predicted)
    periods = tried_periods(law, _PERIODS)
    maps = held_maps(A, closed - A, periods)
    if maps is None:
        return None
    at_zero = width_flow(z.S @ closed @ z.R)
    moduli = zip(periods, np.abs(z.S @ maps @ z.R), strict=True)
    return falling_weights([-at_zero if s == 0 else (np.eye(n) - F) / s for s, F in moduli], n)


def falling_weights(falls: list[Array], n: int) -> ExactMatrix | None:
    """w > 0 with fall w > 0 for each row of each matrix, by a linear program: the largest common margin; None where
    there is none."""
    program = Program({"w": diagonal(n), "t": full(1, 1)})
    for fall in falls:
        for row in fall / max(float(np.abs(fall).max()), 1e-12):
            program.require(lambda x, row=row: row @ np.diag(x["w"]) - x["t"])  # type: ignore[misc]
    for i in range(n):
        program.require(lambda x, i=i: x["w"][i, i] - x["t"])  # type: ignore[misc]
    program.equate(lambda x: np.trace(x["w"]) - n)
    values = largest_margin(program)
    return None if values is None else ExactMatrix.from_floats(np.diag(values["w"]).reshape(-1, 1), DIGITS)


@dataclass(frozen=True)
class _Phase:
    """One piece of the phase s since the last sample: Phi(s), what disturbance and noise add per unit of time
    to rho, and the map from rho and data to |x - c|."""

    s: arb
    Phi: Matrix
    rate: Matrix
    to_x: Matrix
    in_x: Matrix
    is_sample: bool

    def after(self, rho: Matrix) -> Matrix:
        """The radius at a sample at this phase."""
        grown: Matrix = absolute(Matrix.identity(rho.shape[0]) + self.Phi * self.s) @ rho + self.rate * self.s
        return grown


def hull_width(system: System, w: Matrix, law: SamplingLaw, known: Matrix | None = None) -> Matrix | None:
    """An upper bound of the final width of x at all times, shape (n, 1): the largest over the phase s of the
    width that a radius rho bounded for ever leads to.

    The bound of rho starts at the multiple of w that no sample raises, and is improved by applying the worst
    sample of the law to it; every step is a valid bound. For one period it tends to the fixed point itself.

    Args:
        known: a final width of z proved without the hull, shape (n, 1): the hull is never wider.
    """
    phases = _phases(system, *law_ends(law))
    samples = [phase for phase in phases if phase.is_sample]
    rates = [rate for phase in samples for rate in entries(phase.rate)]
    falls = [fall for phase in samples for fall in contraction(phase.Phi, w, phase.s)]
    if not all(fall > 0 for fall in falls):
        return None
    rho = w.balls() * reduce(arb.max, [(rate / fall).upper() for rate, fall in zip(rates, falls, strict=True)])
    if known is not None:
        rho = lower_of(rho, known * Fraction(1, 2))
    for _ in range(1 if law_ends(law)[0] == 0 else _ROUNDS):
        rho = lower_of(rho, highest(phase.after(rho) for phase in samples))
    widths = highest((phase.to_x @ rho + phase.in_x) * 2 for phase in phases)
    return widths if known is None else lower_of(widths, absolute(system.z.R) @ known)


def _phases(system: System, low: Fraction, high: Fraction) -> list[_Phase]:
    """Pieces that cover [0, high]; those that cover [low, high] are where a sample may come."""
    (A, closed), S, R, L = system.predicted, system.z.S, system.z.R, system.gain["L"].balls()
    half_d, half_v = (width * Fraction(1, 2) for width in system.widths)
    ends = sorted({high * k / _PIECES for k in range(_PIECES + 1)} | {low})
    identity, in_x, in_z = Matrix.identity(system.n), half_d.balls() * 0, half_d.balls() * 0
    phases = []
    for a, b in [*pairwise(ends), *([(high, high)] if low == high else [])]:
        s, length = interval(a, b), fraction_ball(b - a)
        E = flow(A, s)
        # Integrals up to any point of the piece: up to its end is an upper bound of them.
        next_x, next_z = in_x + absolute(E) @ half_d * length, in_z + absolute(S @ E) @ half_d * length
        gamma = growth(A, identity, s)  # Gamma_A(s)/s
        # in_z(s)/s <= max of |S exp(A r)| d_rad over [0, s]; for pieces away from 0 by division.
        rate = (next_z / s if a > 0 else absolute(S @ E) @ half_d) + absolute(S @ gamma @ L) @ half_v
        to_x = absolute((identity + gamma @ closed * s) @ R)
        noise = absolute(gamma @ L) @ half_v * s
        phases.append(_Phase(s, S @ gamma @ closed @ R, rate, to_x, next_x + noise, a >= low))
        in_x, in_z = next_x, next_z
    return phases


def refute_hull(system: System, law: SamplingLaw) -> Witness | None:
    """A constant period of the law at which the radius grows for ever: rho(|S F(T) S^-1|) > 1, proved."""
    return growing_period(law, lambda s: absolute(Matrix.identity(system.n) + hull_growth(system, s)[0] * s))
