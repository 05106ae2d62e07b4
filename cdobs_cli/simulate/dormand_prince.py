"""One step of the Dormand-Prince method of order 8(5,3), over floats and over arrays of runs, and its dense output.

    k_s = f(t + C_s h, y + h sum_j A_sj k_j),    y_new = y + h sum_j B_j k_j

For a single run the twelve stages are written out as straight-line code: an interpreter spends more time
on small arrays than on the arithmetic itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from types import CodeType
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.tableau import TABLEAU

ORDER = 8
RTOL = 1e-11
ATOL = 1e-12  # of the size a state has reached
# A state that is small beside the others is resolved down to this share of the largest: below it lies rounding.
SMALLEST_SHARE = 1e-2
AT_AN_END = 1e-12  # of a step: a point so close to one of its ends has the state there
C, A, E5, E3, D = (TABLEAU[name] for name in ("C", "A", "E5", "E3", "D"))
C_EXTRA, A_EXTRA = TABLEAU["C_extra"], TABLEAU["A_extra"]
_A = [np.array(row) for row in A]
_E5, _E3 = np.array(E5), np.array(E3)
# The slopes of a step that dense output reads, the three further ones after them.
READ = [j for j in range(13) if any(row[j] for row in D)]
_WIDE = [*READ, 13, 14, 15]
_A_EXTRA = [np.array(row)[_WIDE[: len(READ) + extra]] for extra, row in enumerate(A_EXTRA)]
_D = [np.array(row)[_WIDE] for row in D]
_TIMES = np.array([*C[1:12], 1.0])[:, None]
# f(t (R,), y (n, R), held (c, R), out (n, R) or None): the slope, in `out` where that is given.
Slope = Callable[..., Array]


def scalar_step(flow: Callable[..., tuple[float, ...]], size: int) -> Callable[..., Any]:
    """step(t, h, y, k, held, floor) -> (y_new, k_new, error, slopes) over tuples of floats.

    k is the slope at (t, y), k_new the one at the new state, error the weighted norm (a step is good up to
    1), slopes the thirteen tuples that dense output starts from. Source: HairerNorsettWanner1993, II.10.
    """
    return _function(_step_code(size), "step", flow)


def scalar_dense_output(flow: Callable[..., tuple[float, ...]], size: int) -> Callable[..., Any]:
    """dense(t, h, y, y_new, slopes, held): the coefficients of `dense_output`, seven tuples of floats."""
    return _function(_dense_code(size), "dense", flow)


@lru_cache(maxsize=32)
def _step_code(size: int) -> CodeType:
    parts = range(size)
    lines = ["def step(t, h, y, k0, held, floor):", *(_unpacked(name, size) for name in ("y", "k0", "floor"))]
    for s in range(1, 13):
        lines += [f"    z_{i} = y_{i} + h * ({_combination(A[s], i)})" for i in parts]
        lines += [_stage(s, "t + h" if s == 12 else f"t + {C[s]!r} * h", size), _unpacked(f"k{s}", size)]
    lines.append("    five = three = 0.0")
    for i in parts:
        lines.append(f"    scale = floor_{i} + {RTOL!r} * max(abs(y_{i}), abs(z_{i}))")
        lines.append(f"    part = ({_combination(E5, i)}) / scale; five += part * part")
        lines.append(f"    part = ({_combination(E3, i)}) / scale; three += part * part")
    lines.append(f"    error = h * five / sqrt((five + 0.01 * three) * {size}) if five else 0.0")
    slopes = "".join(f"k{s}, " for s in range(13))
    lines.append(f"    return ({''.join(f'z_{i}, ' for i in parts)}), k12, error, ({slopes})")
    return _compiled(lines)


@lru_cache(maxsize=32)
def _dense_code(size: int) -> CodeType:
    parts = range(size)
    lines = ["def dense(t, h, y, new, slopes, held):", _unpacked("y", size), _unpacked("new", size)]
    lines += [f"    {''.join(f'k{s}, ' for s in range(13))} = slopes", *(_unpacked(f"k{s}", size) for s in range(13))]
    for extra, (c, row) in enumerate(zip(C_EXTRA, A_EXTRA, strict=True)):
        lines += [f"    z_{i} = y_{i} + h * ({_combination(row, i)})" for i in parts]
        lines += [_stage(13 + extra, f"t + {c!r} * h", size), _unpacked(f"k{13 + extra}", size)]
    lines += [f"    change_{i} = new_{i} - y_{i}" for i in parts]
    results = [
        [f"change_{i}" for i in parts],
        [f"h * k0_{i} - change_{i}" for i in parts],
        [f"2 * change_{i} - h * (k12_{i} + k0_{i})" for i in parts],
        *([f"h * ({_combination(row, i)})" for i in parts] for row in D),
    ]
    lines.append(f"    return ({''.join('(' + ''.join(f'{value}, ' for value in row) + '), ' for row in results)})")
    return _compiled(lines)


def _unpacked(name: str, size: int) -> str:
    return f"    {''.join(f'{name}_{i}, ' for i in range(size))} = {name}"


def _combination(weights: list[float], i: int) -> str:
    return " + ".join(f"{weight!r} * k{j}_{i}" for j, weight in enumerate(weights) if weight)


def _stage(s: int, time: str, size: int) -> str:
    return f"    k{s} = flow({time}, {''.join(f'z_{i}, ' for i in range(size))}*held)"


def _compiled(lines: list[str]) -> CodeType:
    """Our own text, made from the tableau: it depends on the number of states only."""
    return compile("\n".join(lines), "<Dormand-Prince>", "exec")


def _function(code: CodeType, name: str, flow: Callable[..., tuple[float, ...]]) -> Callable[..., Any]:
    table: dict[str, Any] = {"flow": flow, "sqrt": math.sqrt}
    exec(code, table)  # noqa: S102 - see `_compiled`
    function: Callable[..., Any] = table[name]
    return function


def _weighted(weights: Array, rows: Array) -> Array:
    """weights (s,) times rows (s, K): not a product of matrices, which would round by the number of runs."""
    total: Array = np.einsum("s,sk->k", weights, rows)
    return total


def array_step(
    slope: Slope, t: Array, h: Array, y: Array, k: Array, held: Array, floor: Array, room: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """The same step for many runs at once, each with its own t and h.

    Shapes: t, h (R,); y, k, floor (n, R); held (c, R); returns y_new (n, R), k_new (n, R), error (R,) and
    the slopes (13, n, R), which are written into `room` where there is one. Undefined values make the error nan.
    """
    size, runs = y.shape
    slopes = np.empty((13, size, runs)) if room is None else room
    slopes[0] = k
    flat, times = slopes.reshape(13, -1), t + _TIMES * h
    z = y
    for s in range(1, 13):
        z = _weighted(_A[s], flat[:s]).reshape(size, runs)
        z *= h
        z += y
        slope(times[s - 1], z, held, slopes[s])
    scale = np.maximum(np.abs(y), np.abs(z))
    scale *= RTOL
    scale += floor
    five = _squares(_weighted(_E5, flat).reshape(size, runs), scale)
    three = _squares(_weighted(_E3, flat).reshape(size, runs), scale)
    error = np.where(five == 0, 0.0, h * five / np.sqrt((five + 0.01 * three) * size + 1e-300))
    return z, slopes[12], error, slopes


def _squares(parts: Array, scale: Array) -> Array:
    """The sum of (parts / scale)^2 over the states, in the room of parts (n, R)."""
    parts /= scale
    parts *= parts
    total: Array = parts.sum(axis=0)
    return total


def dense_output(slope: Slope, t: Array, h: Array, y: Array, new: Array, slopes: Array, held: Array) -> Array:
    """The seven coefficients of the polynomial between y and new; three more slopes are evaluated.

    Shapes as in `array_step`, slopes (len(READ), n, R); returns (7, n, R), to be read by `interpolate`.
    """
    known = len(READ)
    every, coefficients = np.empty((known + 3, *y.shape)), np.empty((7, *y.shape))
    every[:known] = slopes
    flat = every.reshape(known + 3, -1)
    for s, (c, row) in enumerate(zip(C_EXTRA, _A_EXTRA, strict=True), known):
        slope(t + c * h, y + h * _weighted(row, flat[:s]).reshape(y.shape), held, every[s])
    change, first, last = new - y, every[0], every[READ.index(12)]
    coefficients[:3] = change, h * first - change, 2 * change - h * (last + first)
    for coefficient, row in zip(coefficients[3:], _D, strict=True):
        np.multiply(h, _weighted(row, flat).reshape(y.shape), out=coefficient)
    return coefficients


def interpolate(coefficients: Array, y: Array, theta: Any) -> Array:
    """The state at t + theta h, 0 <= theta <= 1 (broadcast over the trailing axes)."""
    value: Any = 0.0
    for index, coefficient in enumerate(coefficients[::-1]):
        value = (value + coefficient) * (theta if index % 2 == 0 else 1 - theta)
    return y + value  # type: ignore[no-any-return]


def interpolate_one(coefficients: Array, y: Array, theta: Array) -> Array:
    """The same for one run at several theta (m,): coefficients (7, n), y (n,); returns (n, m)."""
    powers = np.empty((7, len(theta)))
    powers[0] = theta
    factors = (1 - theta, theta)
    for index in range(1, 7):
        np.multiply(powers[index - 1], factors[(index - 1) % 2], out=powers[index])
    return y[:, None] + coefficients.T @ powers


def next_step(error: float) -> float:
    """Factor from one step size to the next: 0.9 error^(-1/8), between 1/5 and 6; nan counts as far too large."""
    if not error < 1e16:
        return 0.2
    return 6.0 if error < 1e-6 else min(6.0, max(0.2, 0.9 * error ** (-1 / ORDER)))
