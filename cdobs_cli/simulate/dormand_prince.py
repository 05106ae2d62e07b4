"""One step of the Dormand-Prince method of order 8(5,3), over floats and over arrays of runs, and its dense output.

    k_s = f(t + C_s h, y + h sum_j A_sj k_j),    y_new = y + h sum_j B_j k_j

For a single run the twelve stages are written out as straight-line code: an interpreter spends more time
on small arrays than on the arithmetic itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from cdobs_cli.simulate import tableau

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

ORDER = 8
RTOL = 1e-11
ATOL = 1e-12  # of the size a state has reached
# A state that is small beside the others is resolved down to this share of the largest: below it lies rounding.
SMALLEST_SHARE = 1e-2


def scalar_step(flow: Callable[..., tuple[float, ...]], size: int) -> Callable[..., Any]:
    """step(t, h, y, k, held, floor) -> (y_new, k_new, error, slopes) over tuples of floats.

    k is the slope at (t, y), k_new the one at the new state, error the weighted norm (a step is good up to
    1), slopes the thirteen tuples that dense output starts from. Source: HairerNorsettWanner1993, II.10.
    """
    parts = range(size)
    lines = ["def step(t, h, y, k0, held, floor):"]

    def unpack(name: str, value: str) -> None:
        lines.append(f"    {''.join(f'{name}_{i}, ' for i in parts)} = {value}")

    def combination(weights: tuple[float, ...], i: int) -> str:
        return " + ".join(f"{weight!r} * k{j}_{i}" for j, weight in enumerate(weights) if weight)

    unpack("y", "y")
    unpack("k0", "k0")
    unpack("floor", "floor")
    for s in range(1, 13):
        time = "t + h" if s == 12 else f"t + {tableau.C[s]!r} * h"
        for i in parts:
            lines.append(f"    z_{i} = y_{i} + h * ({combination(tableau.A[s], i)})")
        lines.append(f"    k{s} = flow({time}, {''.join(f'z_{i}, ' for i in parts)}*held)")
        unpack(f"k{s}", f"k{s}")
    lines.append("    five = three = 0.0")
    for i in parts:
        lines.append(f"    scale = floor_{i} + {RTOL!r} * max(abs(y_{i}), abs(z_{i}))")
        lines.append(f"    part = ({combination(tableau.E5, i)}) / scale; five += part * part")
        lines.append(f"    part = ({combination(tableau.E3, i)}) / scale; three += part * part")
    lines.append(f"    error = h * five / sqrt((five + 0.01 * three) * {size}) if five else 0.0")
    slopes = "".join(f"k{s}, " for s in range(13))
    lines.append(f"    return ({''.join(f'z_{i}, ' for i in parts)}), k12, error, ({slopes})")
    table: dict[str, Any] = {"flow": flow, "sqrt": math.sqrt}
    exec(compile("\n".join(lines), "<Dormand-Prince step>", "exec"), table)  # noqa: S102 - our own code, from the tableau
    step: Callable[..., Any] = table["step"]
    return step


def array_step(
    slope: Callable[[Array, Array, Array], Array], t: Array, h: Array, y: Array, k: Array, held: Array, floor: Array
) -> tuple[Array, Array, Array, Array]:
    """The same step for many runs at once, each with its own t and h.

    Shapes: t, h (R,); y, k, floor (n, R); held (c, R); returns y_new (n, R), k_new (n, R), error (R,) and
    the slopes (13, n, R). Undefined values make the error nan.
    """
    import numpy as np

    size, runs = y.shape
    slopes = np.empty((13, size, runs))
    slopes[0] = k
    flat = slopes.reshape(13, -1)
    z = y
    for s in range(1, 13):
        z = y + h * (np.array(tableau.A[s]) @ flat[:s]).reshape(size, runs)
        slopes[s] = slope(t + (h if s == 12 else tableau.C[s] * h), z, held)
    scale = floor + RTOL * np.maximum(np.abs(y), np.abs(z))
    five = (((np.array(tableau.E5) @ flat).reshape(size, runs) / scale) ** 2).sum(axis=0)
    three = (((np.array(tableau.E3) @ flat).reshape(size, runs) / scale) ** 2).sum(axis=0)
    error = np.where(five == 0, 0.0, h * five / np.sqrt((five + 0.01 * three) * size + 1e-300))
    return z, slopes[12], error, slopes


def dense_output(slope: Callable[[Any, Array], Array], t: Any, h: Any, y: Array, new: Array, slopes: Array) -> Array:
    """The seven coefficients of the polynomial between y and new; three more slopes are evaluated.

    slopes (13, n, ..); returns (7, n, ..), to be read by `interpolate`.
    """
    import numpy as np

    every = np.concatenate([slopes, np.empty((3, *slopes.shape[1:]))])
    flat = every.reshape(16, -1)
    for extra, (c, row) in enumerate(zip(tableau.C_EXTRA, tableau.A_EXTRA, strict=True)):
        s = 13 + extra
        every[s] = slope(t + c * h, y + h * (np.array(row) @ flat[:s]).reshape(y.shape))
    change, first, last = new - y, every[0], every[12]
    high = h * (np.array(tableau.D) @ flat).reshape(4, *y.shape)
    return np.concatenate([np.array([change, h * first - change, 2 * change - h * (last + first)]), high])


def interpolate(coefficients: Array, y: Array, theta: Any) -> Array:
    """The state at t + theta h, 0 <= theta <= 1 (broadcast over the trailing axes)."""
    value: Any = 0.0
    for index, coefficient in enumerate(coefficients[::-1]):
        value = (value + coefficient) * (theta if index % 2 == 0 else 1 - theta)
    return y + value  # type: ignore[no-any-return]


def next_step(error: float) -> float:
    """Factor from one step size to the next: 0.9 error^(-1/8), between 1/5 and 6; nan counts as far too large."""
    if not error < 1e16:
        return 0.2
    return 6.0 if error < 1e-6 else min(6.0, max(0.2, 0.9 * error ** (-1 / ORDER)))
