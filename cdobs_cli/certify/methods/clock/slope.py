"""How the largest margin of the clock certificate moves with the gain, the longest period and the rate, by the
multipliers of the program that gave it.

The largest m with F_k(P) >= m I for every inequality k has multipliers Z_k >= 0, sum_k tr Z_k = 1, and at its P

    dm/dtheta = sum_k <Z_k, dF_k/dtheta>.

Of a flow inequality, F = -(g + h (P A_v + A_v'P + 2 sigma P)) with h the length of its piece,

    dF/dL_ij  = -h (P D_ij + D_ij'P),    D_ij = dA_v/dL_ij,
    dF/dT     = -dh/dT (P A_v + A_v'P + 2 sigma P),
    dF/dsigma = -2 h P,

and no other inequality holds L, T_max or sigma: the gain is one of the flow, as a held innovation's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import pose
from cdobs_cli.certify.methods.clock.form import Shape, in_basis, lyapunov
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array


@dataclass(frozen=True)
class Slope:
    """The margin, and its derivatives by the gain (n, p), by T_max and by sigma, in the user's units."""

    margin: float
    by_gain: Array
    by_period: float
    by_rate: float


def slope(question: Question, shape: Shape, letter: str | None = None) -> Slope | None:
    """Of the question's gain under its law at its rate; None where the solver gives nothing. letter: of a gain of the
    flow by which it is differentiated; `by_gain` is 0 without one."""
    posed = pose(question, shape, None)
    if posed is None:
        return None
    search, T, sigma = posed.search, float(question.law.T_max), float(question.rate)
    solution = search.tight(posed.maps, posed.jumps, sigma * T)
    question.memory[shape, True] = search.cuts
    if solution is None:
        return None
    P = search.values(solution.P)[solution.coefficients]  # h P, h in parts of T_max
    by_rate = -2 * T * float(np.einsum("kij,kij->", P, solution.Z))
    flows = np.array(list(posed.maps.corners()))[solution.corners]
    images = np.array([lyapunov(one, A, sigma * T) for one, A in zip(P, flows, strict=True)])
    stretched = np.repeat(_stretch(search.shape, search.T_min), shape.D + 1)[solution.coefficients]
    by_period = -float(np.einsum("k,kij,kij->", stretched, images, solution.Z)) / T
    by_gain = np.zeros((0, 0))
    if letter is not None:
        pulled = -2 * T * np.einsum("kij,kjl->li", solution.Z, P)
        by_gain = np.einsum("ab,ijab->ij", pulled, _directions(question, letter, np.array(posed.S, dtype=float)))
    return Slope(solution.margin, by_gain, by_period, by_rate)


def _stretch(shape: Shape, T_min: float) -> list[float]:
    """T_max / h dh/dT_max of each piece: those before T_min stay."""
    if shape.points or not shape.after:  # all of them stretch alike
        return [1.0] * shape.pieces
    return [0.0] * shape.before + [1 / (1 - T_min)] * shape.after


def _directions(question: Question, letter: str, S: Array) -> Array:
    """(n, p, N, N): dA/dL_ij in the coordinates z, e = S z; A is affine in L."""
    gain = question.gain(letter).floats
    back = np.array(np.linalg.inv(S), dtype=np.float64)

    def base(L: Array) -> Array:
        about = question.with_gain({letter: ExactMatrix.from_floats(L, 17)})
        flow: Array = in_basis(about.inclusion.floats, S, back).base
        return flow

    zero = base(np.zeros(gain.shape))
    units = np.eye(gain.size).reshape(-1, *gain.shape)
    return np.array([base(unit) - zero for unit in units]).reshape(*gain.shape, *zero.shape)
