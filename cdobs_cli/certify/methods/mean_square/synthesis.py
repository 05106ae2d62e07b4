"""The gain of a correction at samples that leaves the least mean square error: one convex program.

    minimise gamma over P, W, X:
    Pdot + P A_v + A_v'P + 2 sigma P + Z <= 0          on [0, T_max], all corners v,
    [[P(0), P(0) - W C], [., P(tau)]] >= 0              on [T_min, T_max], all corners of C,
    [[X, W'], [W, P(0)]] >= 0,
    gamma tau >= tr(R X) + int_0^tau tr(P B Q B')       on [T_min, T_max],

with W = P(0) K: the average of `average`, and the same P proves the rate sigma. Without slopes that vary the gain is
that of the periodic Kalman filter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import Shape, jump_block
from cdobs_cli.certify.methods.mean_square.aim import Aim
from cdobs_cli.certify.methods.mean_square.curves import Curves
from cdobs_cli.certify.methods.mean_square.form import spread_block
from cdobs_cli.certify.methods.mean_square.setting import Setting, shape, units
from cdobs_cli.certify.svec import full_basis, symmetric_basis
from cdobs_cli.exact.numbers import ExactMatrix

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_EPSILON = 1e-8
_DIGITS = 12


def best_gain(question: Question, aim: Aim) -> tuple[Array, float] | None:
    """(K, root of the average e'Z e): a guess, K of shape (n, p); the gain of the question is not read.

    In the units of the clock certificate first, then in those that suit the gain met."""
    start = Setting.in_units(question, units(question.inclusion))
    if not start.is_finite:
        return None
    form, best = shape(question, start), None
    setting: Setting | None = start
    for _ in range(2):
        met = None if setting is None else _solve(question, setting, form, aim)
        if met is None:
            break
        best = met if best is None or met[1] <= best[1] else best
        K = ExactMatrix.from_floats(met[0], _DIGITS)
        setting = Setting.of(question.with_gain({"K": K}), aim.Z)
    return best


def _solve(question: Question, setting: Setting, form: Shape, aim: Aim) -> tuple[Array, float] | None:
    corners = [C * setting.states for C in question.inclusion.view_floats.output_corners()]
    outputs = np.max([np.abs(C).max(axis=1) for C in corners], axis=0)
    outputs[outputs == 0] = 1.0
    n, p = setting.N, len(outputs)
    weight, sigma = setting.weight(aim.Z)[None], aim.sigma * setting.T
    x_size = p * (p + 1) // 2
    curves = Curves(form, setting.shortest, setting.flows, weight, 1 + n * p + x_size, _EPSILON, sigma)
    key = ("synthesis", form)
    curves.cuts = set(question.memory.get(key, ()))
    W = curves.last + np.arange(n * p)
    X = curves.last + n * p + np.arange(x_size)
    program = curves.program()
    require_free_jumps(curves, program, [C / outputs[:, None] for C in corners], W)
    R, drift = aim.R / np.outer(outputs, outputs), setting.drive @ aim.Q @ setting.drive.T / setting.T
    size = max(float(np.abs(R).max()), float(np.abs(drift).max())) or 1.0
    gamma, noise = np.zeros(curves.size), np.zeros(curves.size)
    gamma[-1] = 1.0
    if R.any():
        require_spread(curves, program, W, X)
        noise[X] = np.einsum("tij,ji->t", symmetric_basis(p), R / size)
    else:
        curves.require_above(program, 0, [0], _EPSILON * np.eye(n))
    rows = curves.times[curves.sampled, None] * gamma - curves.sum_rows(0, drift / size)[curves.sampled] - noise
    program.at_least(rows, np.zeros(len(rows)))
    x = curves.minimise(gamma, program)
    question.memory[key] = curves.cuts
    if x is None:
        return None
    K = gain_of(curves.coefficients(x)[0, 0], x[W].reshape(n, p))
    if K is None:
        return None
    return setting.states[:, None] * K / outputs, float(np.sqrt(max(x[-1], 0.0) * size / setting.T))


def gain_of(P_0: Array, W: Array) -> Array | None:
    """P(0)^-1 W; None where that is no number."""
    try:
        K = np.asarray(np.linalg.solve(P_0, W), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return K if np.all(np.isfinite(K)) else None


def require_free_jumps(curves: Curves, program: BlockProgram, corners: list[Array], W: Any, share: float = 1) -> None:
    """[[P(0), P(0) - W C], [., share P(tau)]] >= 0 on [T_min, T_max], at each corner of C; W: its columns."""
    n = curves.N
    zero = np.zeros((n, n))
    for C in corners:
        none = np.zeros((n, len(C)))
        old = np.array([jump_block(P, none, C, zero) for P in curves.basis])
        new = np.array([jump_block(zero, none, C, P * share) for P in curves.basis])
        free = np.array([jump_block(zero, unit, C, zero) for unit in full_basis(n, len(C))])
        terms = np.concatenate([old, new, free])
        numbers = range(curves.shape.jump_from, curves.shape.count)
        columns = np.array([[*curves.columns(0, 0), *curves.columns(0, number), *W] for number in numbers])
        program.require(columns, np.broadcast_to(terms, (len(columns), *terms.shape)), -_EPSILON * np.eye(2 * n))


def require_spread(curves: Curves, program: BlockProgram, W: Any, X: Any) -> None:
    """[[X, W'], [W, P(0)]] >= 0; W, X: their columns."""
    n, zero = curves.N, np.zeros((curves.N, curves.N))
    p = len(W) // n
    nothing, none = np.zeros((p, p)), np.zeros((n, p))
    terms = [spread_block(unit, none, zero) for unit in symmetric_basis(p)]
    terms += [spread_block(nothing, unit, zero) for unit in full_basis(n, p)]
    terms += [spread_block(nothing, none, P) for P in curves.basis]
    columns = np.array([[*X, *W, *curves.columns(0, 0)]])
    program.require(columns, np.array(terms)[None], np.zeros((p + n, p + n)))
