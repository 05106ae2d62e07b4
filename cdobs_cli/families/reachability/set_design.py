"""Gains and certificates by the set: for one period, and for the largest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import ROUND_CEILING, Context, Decimal
from fractions import Fraction
from math import inf
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from cdobs_cli.certify import search
from cdobs_cli.certify.gains import Candidate, GainSearch
from cdobs_cli.certify.kernel import Kernel, kernel
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix, plain_decimal
from cdobs_cli.families.reachability.certificate import MAX_STATES_OF_CONSTANTS, ReachableSet
from cdobs_cli.families.reachability.search import Guess, Members, contraction, design, fastest, lyapunov, members
from cdobs_cli.families.reachability.sets import matrix_set, set_limit
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

T_ = TypeVar("T_")

DIGITS = (5, 7, 9, 12)
Q_DIGITS = 13
_WIDTH = Fraction(1, 2000)
_HALVINGS = 12


class SetGain(GainSearch):
    """K by the convex form of (13): of the largest margin, of the longest period, of about the fastest decay."""

    def at(self, question: Question) -> Candidate | None:
        return Candidate.of(gain_at(question), 1.0)

    def longest(self, question: Question) -> Candidate | None:
        return Candidate.of(longest_any(question))

    def fastest(self, question: Question) -> Candidate | None:
        met = gain_at(question, fast=True)
        if met is None:
            return None
        rho_squared = float(met[1].rho_squared)
        rate = -np.log(rho_squared) / (2 * float(question.law.T_max)) if rho_squared > 0 else inf
        return Candidate.of(met, float(rate))


Gain = tuple[ExactMatrix, ReachableSet]


def gain_at(question: Question, *, fast: bool = False) -> Gain | None:
    """A gain for the question's period: of the largest margin, or about that of the fastest proved decay. The gain of
    the question is not read."""
    space = kernel(question.plant.C)
    if space.dimension == 0:
        return _reset(question, space)
    data = _members(question, space)
    guess = None if data is None else design(_grown(data, question), question.memory)
    if data is None or guess is None or guess.margin <= 0:
        return None
    if fast:
        guess = _fastest_gain(data, guess, question)
    Z = data.Z(guess.Z)
    for digits in DIGITS:
        K = space.gain(ExactMatrix.from_floats(Z, digits), digits + 2)
        Q = guess.Q if space.is_kept(K) else None
        certificate = certificate_at(question.with_gain({"K": K}), rounds=3 if fast else 0, Q=Q)
        if certificate is not None and certificate.prove(question.with_gain({"K": K})).rate >= fraction_ball(
            question.rate
        ):
            return K, certificate
    return None


def _grown(data: Members, question: Question) -> Members:
    """The members with their error grown by exp(sigma T), sigma the question's rate."""
    return replace(data, M=data.M * float(np.exp(float(question.rate) * float(question.law.T_max))))


def certificate_at(question: Question, *, rounds: int = 4, Q: Array | None = None) -> ReachableSet | None:
    """A proved certificate for the question's gain and period, or None. `Q` (scaled) is tried instead of a search."""
    space, K = kernel(question.plant.C), question.gain("K")
    if not space.is_kept(K):
        return _full_certificate(question)
    if space.dimension == 0:
        return _reset_by(question)
    data = _members(question, space)
    if data is None:
        return None
    F = error_maps(data, space, K)
    if Q is None or rounds:
        rho, best = fastest(F, question.memory, rounds)
        Q = best if Q is None or rho < contraction(Q, F) else Q
    if contraction(Q, F) >= 1:
        return None
    printed = ExactMatrix.from_floats(_symmetric(data.Q(Q)), Q_DIGITS)
    rho_squared = _above(contraction(_unscale(data, printed.floats), F) ** 2)
    s = _shift(question, space, printed.floats)
    return _proved(question, ReachableSet(question.law, "reduced", rho_squared, Q=printed.texts(), s=s))


def longest_any(question: Question) -> Gain | None:
    """A gain for the largest period found at the question's rate, at least the question's own."""
    space = kernel(question.plant.C)
    if space.dimension == 0:
        return _reset(question, space)
    end = _any_end(question)
    return None if end is None else _last_proved(lambda T: gain_at(question.at(T)), question.law.T_max, end)


def end_of_any(question: Question) -> float | None:
    """Up to which period the set gives a gain, in floats; looks below the question's own too."""
    for _ in range(_HALVINGS):
        end = _any_end(question)
        if end is not None:
            return float(end)
        question = question.at(_half(question.law.T_max))
    return None


def longest_for(question: Question) -> ReachableSet | None:
    """The certificate of the question's gain for the largest period found; below its own where it fails there."""
    space, K = kernel(question.plant.C), question.gain("K")
    if space.dimension == 0 and space.is_kept(K):
        return None
    low, high = question.law.T_max, set_high(question.plant)
    for _ in range(_HALVINGS):
        if float(low) <= high and _margin(question.at(low)) > 0:
            break
        low = _half(low)
    else:
        return None
    end = largest(lambda T: _margin(question.at(T)), low, high)
    return None if end is None else _last_proved(lambda T: certificate_at(question.at(T), rounds=0), low, end)


def _half(T: Exact) -> Exact:
    return search.rounded_down(Fraction(float(T)) / 2, 6)


def _any_end(question: Question) -> Fraction | None:
    def margin(T: Exact) -> float:
        data = _members(question.at(T), kernel(question.plant.C))
        return design(_grown(data, question.at(T)), question.memory).margin if data else -1.0

    return largest(margin, question.law.T_max, set_high(question.plant))


def _margin(question: Question) -> float:
    """The margin of the best Lyapunov matrix for the question's gain, in floats; -1 where the set is not known."""
    space, K = kernel(question.plant.C), question.gain("K")
    if space.is_kept(K):
        data = _members(question, space)
        return lyapunov(error_maps(data, space, K), question.memory)[0] if data else -1.0
    maps = _full_maps(question)
    return lyapunov(maps[1], question.memory)[0] if maps else -1.0


def _last_proved(prove: Callable[[Exact], T_ | None], start: Exact, end: Fraction) -> T_ | None:
    """The proof at the largest short period up to `end` that has one: the proofs decide, not the margins."""
    high = search.rounded_down(end, 6)
    if not float(high) > float(start):
        return prove(start)
    met = search.between(prove, start, high, _WIDTH)
    return None if met is None else met[1]


def _members(question: Question, space: Kernel) -> Members | None:
    """The members that matter at the period, as floats; None where the set could not be enclosed."""
    boxes = matrix_set(question.card, question.plant, question.law.T_max)
    if boxes is None:
        return None
    data = members(boxes, space)
    return data if all(np.all(np.isfinite(part)) for part in (data.M, data.A, data.b)) else None


def _full_maps(question: Question) -> tuple[Members, Array] | None:
    """(I - K C) M at every member of the whole space, scaled."""
    plant = question.plant
    boxes = matrix_set(question.card, plant, question.law.T_max)
    if boxes is None:
        return None
    data = members(boxes, kernel(ExactMatrix([[0] * plant.n])))
    J = np.eye(plant.n) - question.gain("K").floats @ plant.C.floats
    N_M = (data.s[:, None] * J / data.s) @ data.M
    return (data, N_M) if np.all(np.isfinite(N_M)) else None


def _full_certificate(question: Question) -> ReachableSet | None:
    maps = _full_maps(question)
    if maps is None:
        return None
    data, N_M = maps
    rho, P = fastest(N_M, question.memory, 3)
    if rho >= 1:
        return None
    printed = ExactMatrix.from_floats(_symmetric(data.Q(P)), Q_DIGITS)
    rho_squared = _above(contraction(_unscale(data, printed.floats), N_M) ** 2)
    return _proved(question, ReachableSet(question.law, "full", rho_squared, P=printed.texts()))


def _proved(question: Question, certificate: ReachableSet) -> ReachableSet | None:
    return certificate if certificate.prove(question).holds else None


def _reset(question: Question, space: Kernel) -> Gain | None:
    """n = rank C: K with C K = I, where that ends as decimals."""
    K = space.gain(None, 12)
    certificate = _reset_by(question.with_gain({"K": K}))
    return None if certificate is None else (K, certificate)


def _reset_by(question: Question) -> ReachableSet | None:
    return _proved(question, ReachableSet(question.law, "reduced", "0", Q=[]))


def _fastest_gain(data: Members, guess: Guess, question: Question) -> Guess:
    """Bisection on rho: the inequality for the members divided by rho."""
    F = data.A - guess.Z @ data.b
    high, low, best = contraction(guess.Q, F), 0.0, guess
    for _ in range(8 + 2 * question.effort):
        middle = max((low + high) / 2, 0.7 * high)
        trial = design(replace(data, M=data.M / middle), question.memory)
        if trial.margin > 0:
            high, best = min(high, contraction(trial.Q, data.A - trial.Z @ data.b)), trial
        else:
            low = middle
        if high - low < 2e-3 * high:
            break
    return best


def _shift(question: Question, space: Kernel, Q: Array) -> str | None:
    """s of `recovered_P` for which the paper's kappa is about largest; None where none was found."""
    plant, K = question.plant, question.gain("K")
    boxes = matrix_set(question.card, plant, plant.sampling.T_max)
    if boxes is None or plant.n > MAX_STATES_OF_CONSTANTS:
        return None
    everything = list(range(plant.n))
    M = np.concatenate([box.members(list(box.signs(everything))) for box in boxes])
    C, R = space.C_r.floats, space.R.floats
    J = np.eye(plant.n) - K.floats @ plant.C.floats
    base, image = (R @ J).T @ Q @ (R @ J), R @ J @ M
    drop = base - np.swapaxes(image, 1, 2) @ Q @ image
    unit = float(np.trace(Q)) / (float(np.trace(C.T @ C)) or 1.0)
    best: tuple[float, float] = (0.0, 0.0)
    for power in np.arange(-3.0, 9.0, 0.5):
        s = unit * 10.0**power
        top = float(np.linalg.eigvalsh(base + s * C.T @ C)[-1])
        kappa = float(np.min(np.linalg.eigvalsh(drop + s * C.T @ C)[:, 0])) / top
        best = max(best, (kappa, s))
    return _up(Fraction(best[1]), 4) if best[0] > 0 else None


def error_maps(data: Members, kernel: Kernel, K: ExactMatrix) -> Array:
    """F = R (I - K C) M N at every member, scaled; shape (V, r, r)."""
    K_r = K.floats[:, list(kernel.rows)]
    Z = (data.s[:, None] * K_r) / data.s_output
    F: Array = data.A - (data.R @ Z) @ data.b
    return F


def _symmetric(matrix: Array) -> Array:
    """Its symmetric part."""
    value: Array = (matrix + matrix.T) / 2
    return value


def _unscale(data: Members, Q: Array) -> Array:
    s = data.s[list(data.others)]
    value: Array = _symmetric(Q / s[:, None] / s)
    return value


def _above(value: float) -> str:
    """A decimal a little above a float's value: room for its rounding errors."""
    return _up(Fraction(value) * (1 + Fraction(1, 10**9)) + Fraction(1, 10**14), 12)


def largest(margin: Callable[[Exact], float], low: Exact, high: float) -> Fraction | None:
    """Where the margin crosses zero above `low`: false position between a period that holds and
    one that does not, then halving, to seven digits. Returns the largest period tried with a positive margin."""
    start = float(low)
    a, f_a = start, margin(low)
    if not f_a > 0:
        return None
    b = min(2 * start, high)
    f_b = margin(Exact(Fraction(b)))
    while f_b > 0:
        if b >= high or b > 1e9 * start:
            return Fraction(b)
        a, f_a, b = b, f_b, min(2 * b, high)
        f_b = margin(Exact(Fraction(b)))
    if not np.isfinite(f_b):
        f_b = -1.0
    side = 0
    for count in range(40):
        if b - a <= 1e-7 * b:
            break
        share = min(max(f_a / (f_a - f_b), 0.02), 0.98) if f_b < 0 and count < 12 else 0.5
        middle = a + share * (b - a)
        value = margin(Exact(Fraction(middle)))
        value = value if np.isfinite(value) else -1.0
        if value > 0:
            a, f_a = middle, value
            f_b, side = (f_b / 2 if side == 1 else f_b), 1
        else:
            b, f_b = middle, value
            f_a, side = (f_a / 2 if side == -1 else f_a), -1
    return Fraction(a)


def _up(value: Fraction, digits: int) -> str:
    up = Context(prec=digits, rounding=ROUND_CEILING).divide(Decimal(value.numerator), Decimal(value.denominator))
    return plain_decimal(up)


def set_high(plant: Plant) -> float:
    """Up to which delta the set can be used, as a float a little below the proved limit."""
    limit = set_limit(plant)
    return float(limit.lower()) if limit.is_finite() else float("inf")
