"""The gain of a correction at samples that leaves the least error bound under bounded disturbance and noise: convex for
each rho.

    minimise sum_i w_i b_i^2 over P, W, mu, nu:
    [[-(Pdot + P A_v + A_v'P + 2 sigma P), -P B], [., diag mu]] >= 0       on [0, T_max], all corners v,
    [[P(0), P(0) - W C, W], [., rho^2 P(tau), 0], [., ., diag nu]] >= 0    on [T_min, T_max], all corners of C,
    [[P(tau), e_i], [., b_i^2]] >= 0                                       on [0, T_max],
    sum_j d0_j^2 int mu_j + sum_j nu_j v0_j^2 <= 1 - rho^2,

mu constant on each piece, W = P(0) K: then e'P(tau)e <= 1 in the end, and |e_i| <= b_i. A gain proved so has smaller
bounds by chains of intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.setting import Setting, shape, units
from cdobs_cli.certify.methods.mean_square.signals import bounded_floats
from cdobs_cli.certify.methods.mean_square.synthesis import gain_of
from cdobs_cli.certify.methods.peak.signals import acting
from cdobs_cli.certify.svec import full_basis
from cdobs_cli.exact.matrix import block
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_EPSILON = 1e-8
_RHO = (0.4, 0.6, 0.75, 0.87, 0.95)
_FINER = (0, 2, 2, 3)  # steps that halve the distance between the values of rho tried, by effort


def noisy_jump_block(P_0: Any, W: Any, C: Any, V: Any, P: Any, nu: Any) -> Any:
    """[[P(0), P(0) - W C, W V], [., P, 0], [., ., nu]]: definite where e'Pe + v'nu v before a sample pays for e'P(0)e
    after it, e+ = (I - K C) e + K V v, W = P(0) K; P stands for rho^2 P(tau)."""
    old, kick = P_0 - W @ C, W @ V
    none = P @ kick * 0
    return block([[P_0, old, kick], [old.T, P, none], [kick.T, none.T, nu]])


@dataclass(frozen=True)
class Guess:
    """K (n, p), the bounds b (n,), and sum_i w_i b_i^2."""

    K: Array
    b: Array
    size: float


def best_gain(question: Question, weights: Array, sigma: float) -> Guess | None:
    """The guess of the least sum of weighted squares, over rho: in the units of the clock certificate first, then near
    its rho in those of the bounds met."""
    first = _scanned(question, _first_states(question), weights, sigma, _RHO, 0)
    if first is None:
        return None
    rho, guess = first
    states = 2.0 ** np.round(np.log2(np.maximum(guess.b, 1e-12 * guess.b.max())))
    place = _RHO.index(rho)
    near = _RHO[max(place - 1, 0) : place + 2]
    second = _scanned(question, states, weights, sigma, near, _FINER[question.level])
    return guess if second is None or guess.size < second[1].size else second[1]


def _scanned(
    question: Question, states: Array, weights: Array, sigma: float, rhos: Sequence[float], finer: int
) -> tuple[float, Guess] | None:
    """The best guess over rho in (0, 1), where the size has one valley, and its rho."""
    setting = Setting.in_units(question, states)
    if not setting.is_finite:
        return None
    asked = dict.fromkeys(rhos)
    met = {rho: guess for rho in asked if (guess := _solve(question, setting, rho, weights, sigma)) is not None}
    for _ in range(finer if met else 0):
        best = min(met, key=lambda rho: met[rho].size)
        tried = sorted({0.0, *asked, 1.0})
        place = tried.index(best)
        for rho in ((tried[place - 1] + best) / 2, (best + tried[place + 1]) / 2):
            asked[rho] = None
            guess = _solve(question, setting, rho, weights, sigma)
            if guess is not None:
                met[rho] = guess
    return min(met.items(), key=lambda one: one[1].size, default=None)


def _first_states(question: Question) -> Array:
    """The units of the clock certificate, of the size that noise, or disturbance over one period, has in them."""
    setting = Setting.in_units(question, units(question.inclusion))
    v_0, d_0 = bounded_floats(question.plant)
    seen = np.abs(question.inclusion.view_floats.C * setting.states).max(axis=1)
    kicks = max((v / one for v, one in zip(v_0, seen, strict=True) if one > 0), default=0.0)
    size = max(kicks, float(np.abs(setting.drive * d_0).max(initial=0.0)))
    scaled: Array = setting.states * (size or 1.0)
    return scaled


def _solve(question: Question, setting: Setting, rho: float, weights: Array, sigma: float) -> Guess | None:
    plant, n, p = question.plant, setting.N, question.plant.p
    d, v = acting(plant.disturbance), acting(plant.noise)
    v_0, d_0 = bounded_floats(question.plant)
    B, V = setting.drive[:, d] * d_0[d], np.diag(v_0)[:, v]
    form = shape(question, setting)
    r, q, pieces = len(d), len(v), form.pieces
    corners = [C * setting.states for C in question.inclusion.view_floats.output_corners()]
    outputs = np.maximum(np.max([np.abs(C).max(axis=1) for C in corners], axis=0), 1e-300)
    corners, V = [C / outputs[:, None] for C in corners], V / outputs[:, None]
    extra = pieces * r + n * p + q + n
    curves = Curves(
        form, setting.shortest, setting.flows, np.zeros((1, n, n)), extra, _EPSILON, sigma * setting.T,
        drive=B if r else None,
    )  # fmt: skip
    mu = curves.last + np.arange(pieces * r).reshape(1, pieces, r)
    W = curves.last + pieces * r + np.arange(n * p)
    nu, b = W[-1] + 1 + np.arange(q), W[-1] + 1 + q + np.arange(n)
    curves.prices = mu
    key = ("peak synthesis", form)
    curves.cuts = set(question.memory.get(key, ()))
    program = curves.program()
    _require_jumps(curves, program, corners, V, W, nu, rho)
    for i in range(n):
        _require_bound(curves, program, i, b[i])
    spent = np.zeros(curves.size)
    spent[mu] = -np.array(curves.lengths)[:, None]
    spent[nu] = -1.0
    program.at_least(spent[None], [rho**2 - 1])
    program.at_least(np.eye(curves.size)[[*mu.reshape(-1), *nu]], np.zeros(pieces * r + q))
    cost = np.zeros(curves.size)
    cost[b] = weights * setting.states**2
    x = curves.minimise(cost, program)
    question.memory[key] = curves.cuts
    if x is None:
        return None
    K = gain_of(curves.coefficients(x)[0, 0], x[W].reshape(n, p))
    if K is None:
        return None
    bounds = setting.states * np.sqrt(np.maximum(x[b], 0.0))
    return Guess(setting.states[:, None] * K / outputs, bounds, float(cost @ x))


def _require_jumps(
    curves: Curves, program: BlockProgram, corners: list[Array], V: Array, W: Any, nu: Any, rho: float
) -> None:
    n, (p, q) = curves.N, V.shape
    zero, nothing, none = np.zeros((n, n)), np.zeros((q, q)), np.zeros((n, p))
    for C in corners:
        terms = [noisy_jump_block(P, none, C, V, zero, nothing) for P in curves.basis]
        terms += [noisy_jump_block(zero, none, C, V, P * rho**2, nothing) for P in curves.basis]
        terms += [noisy_jump_block(zero, unit, C, V, zero, nothing) for unit in full_basis(n, p)]
        terms += [noisy_jump_block(zero, none, C, V, zero, np.diag(row)) for row in np.eye(q)]
        numbers = range(curves.shape.jump_from, curves.shape.count)
        columns = np.array([[*curves.columns(0, 0), *curves.columns(0, number), *W, *nu] for number in numbers])
        size = 2 * n + q
        stack = np.broadcast_to(np.array(terms), (len(columns), len(terms), size, size))
        program.require(columns, stack, -_EPSILON * np.eye(size))


def _require_bound(curves: Curves, program: BlockProgram, i: int, b: int) -> None:
    """[[P(tau), e_i], [., b_i^2]] >= 0 at every coefficient."""
    n = curves.N
    terms = np.zeros((curves.t + 1, n + 1, n + 1))
    terms[: curves.t, :n, :n] = curves.basis
    terms[-1, n, n] = 1.0
    constant = np.zeros((n + 1, n + 1))
    constant[i, n] = constant[n, i] = 1.0
    columns = np.array([[*curves.columns(0, number), b] for number in range(curves.shape.count)])
    program.require(columns, np.broadcast_to(terms, (len(columns), *terms.shape)), constant)
