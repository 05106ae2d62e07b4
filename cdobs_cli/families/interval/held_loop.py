"""Feedback from the bounds: the separation principle, and its proof for the held loop.

    u = K_lower z_lower + K_upper z_upper at samples = (K_lower + K_upper) z - K_lower e_lower + K_upper e_upper

The error e does not depend on u, so the bounds hold and stay bounded with feedback exactly when they do
without it, and the state stays bounded for all bounded data exactly if the held loop does:

    xdot = A x + B K x(t_k),    K = (K_lower + K_upper) S,    x(t_k + s) = F(s) x(t_k),  F(s) = I + s Phi(s)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Certificate, Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.ball import eigenvalues
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.lmi import Program, full
from cdobs_cli.certify.lmi import symmetric as symmetric_unknown
from cdobs_cli.certify.methods.base import Proof, Question, Reach
from cdobs_cli.certify.words import refutes
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix, block, symmetric
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval.errors import error_maps
from cdobs_cli.families.interval.held import flows, growth, growth_and_slope, holds_under, tried_periods
from cdobs_cli.families.interval.method import DIGITS, Gain, Part, between, largest_margin
from cdobs_cli.families.interval.parts import identity_like, symmetrised, zeros_like
from cdobs_cli.families.interval.system import System
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_WIDTH = Fraction(1, 5000)
_PERIODS = 8


@dataclass(frozen=True)
class HeldLoop(Part):
    """P > 0, shape (n, n): x' P x decreases from sample to sample, in proportion to the time between."""

    P: ExactMatrix

    name = "held_loop"
    rung = "separation"
    how = "x' P x decreases from sample to sample"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return "K_lower" in question.inclusion.gain

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        A, closed = (M.floats for M in System.of(question).held_loop)
        P = _decreasing(A, closed, question.law)
        return None if P is None else cls(question.law, P).proved(question)

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """Between the law's own period, where that is proved, and the first refuted one."""
        own = cls.propose(question)
        return cls._between(question, own, HeldLoopLost.above(question, own))

    @classmethod
    def stored(cls, question: Question) -> Sequence[Part]:
        """With the first refuted period."""
        own = cls.propose(question)
        lost = HeldLoopLost.above(question, own)
        proved = [one for one in (own, cls._between(question, own, lost)) if one is not None]
        return [*{one.law: one for one in proved}.values(), *([lost] if lost is not None else [])]

    @classmethod
    def _between(cls, question: Question, own: Self | None, lost: HeldLoopLost | None) -> Self | None:
        high = search.short(20 * float(question.law.T_max), 6) if lost is None else lost.law.T_max
        low = search.short(float(high) / 100, 6) if own is None else own.law.T_max
        return between(lambda T: cls.propose(question.at(T)), low, high, _WIDTH)

    def _prove(self, question: Question) -> Proof:
        """P > 0 and P - F(s)' P F(s) > 0 for every s of the law (in the limit of its rate at s = 0).

        Source: Efimov2016, Section V
        Deviates: separation in place of Theorem 2's small gain: the errors do not depend on u, so the plant and its
            held feedback are all that is left to prove.
        """
        A, closed = System.of(question).held_loop
        P = symmetrised(self.P.balls())
        if P.shape != A.shape or not has_positive_pivots(P):
            return Proof.of(False)
        return Proof.of(holds_under(self.law, lambda s: has_positive_pivots(decrease_over(P, A, closed, s)[1])))


@dataclass(frozen=True)
class HeldLoopLost(Part):
    """A word of periods under which the held loop does not decay, as `words` writes it."""

    witness: dict[str, Any]

    name = "held_loop_lost"
    rung = "separation"
    how = "eigenvalue of the sampled loop"
    reach: ClassVar[Reach] = "no convergence"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return HeldLoop.applies(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        met = refute(held_inclusion(question), question.effort)
        return None if met is None else cls(question.law, met.document())

    @classmethod
    def above(cls, question: Question, own: HeldLoop | None) -> Self | None:
        """Of the first period refuted above what is proved."""
        start = None if own is None else own.law.T_max
        met = smallest_refuted(lambda T: held_inclusion(question.at(T)), start, question.effort)
        return None if met is None else cls(question.law.with_period(met[0]), met[1].document())

    @classmethod
    def stored(cls, question: Question) -> Sequence[Part]:
        return []  # with the certificates of `HeldLoop`

    def certificate(self, gain: Gain | None = None) -> Certificate:
        return Certificate(self.name, self.law, {"witness": self.witness})

    def _prove(self, question: Question) -> Proof:
        return Proof.of(refutes(held_inclusion(question), Witness.from_document(self.witness)))


def decrease_over(P: Matrix, A: Matrix, closed: Matrix, s: arb) -> tuple[Matrix, Matrix]:
    """V and V' D V for every s of a ball, D the `decrease`: by its value in the middle, and its slope on all of it.
    V makes the middle nearly diagonal, where balls are sharpest."""
    middle = arb(s.mid())
    Phi, slope = growth_and_slope(A, closed, s)
    value = decrease(P, growth(A, closed, middle), middle)
    fall = -(symmetric(P @ slope + Phi.T @ P @ slope * s) + Phi.T @ P @ Phi)
    V = Matrix.from_floats(np.linalg.eigh(value.floats)[1])
    return V, V.T @ value @ V + V.T @ fall @ V * arb(0, s.rad())


def decrease(P: Any, Phi: Any, s: Any) -> Any:
    """(P - F' P F)/s = -(P Phi + Phi' P + s Phi' P Phi), which has to be positive definite."""
    return -(symmetric(P @ Phi) + (Phi.T @ P @ Phi) * s)


def _decreasing(A: Array, closed: Array, law: SamplingLaw) -> ExactMatrix | None:
    """P from the solver: the decrease at some periods of the law, largest margin."""
    n = len(A)
    periods = tried_periods(law, _PERIODS)
    parts = flows(A, periods)
    growths = None if parts is None else parts[1] @ closed
    if growths is None or not np.all(np.isfinite(growths)):
        return None
    program = Program({"P": symmetric_unknown(n), "t": full(1, 1)})
    identity = np.eye(n)

    def margin(x: Mapping[str, Array], s: float, Phi: Array) -> Array:
        falls: Array = decrease(x["P"], Phi, s) / max(float(np.linalg.norm(Phi)), 1e-12) - identity * x["t"]
        return falls

    for s, Phi in zip(periods, growths, strict=True):
        program.require(partial(margin, s=s, Phi=Phi))
    program.require(lambda x: x["P"] - identity * x["t"])
    program.equate(lambda x: np.trace(x["P"]) - n)
    values = largest_margin(program)
    return None if values is None else ExactMatrix.from_floats(values["P"], DIGITS)


def held_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """The held loop as a hybrid system of (x, K x(t_k)): flow [A B; 0 0], jump [I 0; K 0].

    Source: Efimov2016, (16)
    """
    A, B, K = view.A, view.gain["B"], (view.gain["K_lower"] + view.gain["K_upper"]) @ view.gain["S"]
    n, m = B.shape
    below = [zeros_like(A, m, n), zeros_like(A, m, m)]
    jump = block([[identity_like(A, n), zeros_like(A, n, m)], [K, below[1]]])
    return ErrorMaps(base=block([[A, B], below]), parts=(), lower=(), upper=(), jump=jump)


def closed_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """Plant, feedback and errors of the bounds as one system of (x, u, e, e(t_k)): the held loop driven by

        u+ = (K_lower + K_upper) S x - K_lower (z - z_lower) + K_upper (z_upper - z)

    Block triangular, so its multipliers are those of the held loop and of the errors.

    Source: Efimov2016, (16), (17)
    """
    held, errors = held_maps(view), error_maps(view)
    (n, m), size, count = view.gain["B"].shape, held.base.shape[0], errors.base.shape[0]
    above, below = zeros_like(view.A, size, count), zeros_like(view.A, count, size)
    fed = block([[view.gain["K_lower"] * -1, view.gain["K_upper"], zeros_like(view.A, m, count - 2 * n)]])
    drive = block([[zeros_like(view.A, n, count)], [fed]])
    base, jump = block([[held.base, above], [below, errors.base]]), block([[held.jump, drive], [below, errors.jump]])
    return ErrorMaps(base=base, parts=(), lower=(), upper=(), jump=jump)


def held_inclusion(question: Question) -> HybridInclusion:
    """The held loop of a question; the plant has B."""
    gain = {**question.inclusion.gain, "B": question.plant.B}
    return HybridInclusion(held_maps, question.plant, gain, question.law, ())


def refute_held_loop(question: Question) -> Witness | None:
    """A constant period of the law at which the held loop has a multiplier of modulus at least 1, proved."""
    witness = refute(held_inclusion(question), question.effort)
    if witness is None:
        return None
    T = Exact(witness.times[0]).rational
    if T is None:
        return witness
    A, closed = System.of(question).held_loop
    roots = eigenvalues(Matrix.identity(A.shape[0]) + growth(A, closed, fraction_ball(T)) * T) or []
    largest = max(roots, key=lambda root: float(abs(root).mid()), default=None)
    if largest is None:
        return witness
    eigenvalue = [f"{float(part.mid()):.10g}" for part in (largest.real, largest.imag)]
    return replace(witness, data={**witness.data, "eigenvalue": eigenvalue})
