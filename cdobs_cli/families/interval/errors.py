"""What the errors of one design obey, in balls and in floats.

e = (z - z_lower, z_upper - z),    e(t_k + s) = E(s) e(t_k) + ..,    E(s) = exp(M s) + Gamma(s) N1

e(0) = [S^+ S^-; S^- S^+] (x - x_lower, x_upper - x)
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.families.interval.held import flows, growth
from cdobs_cli.families.interval.parts import both_sides, identity_like, zeros_like
from cdobs_cli.families.interval.theorems import Coordinates, coordinates, error_flow
from cdobs_cli.hybrid import ErrorMaps, PlantView
from cdobs_cli.records import dataclass

_LARGEST_EXPONENT = 200.0  # of |M| s in floats


@dataclass(frozen=True)
class ErrorSystem:
    """M, N1: flow and held part, shapes (2n, 2n); start: columns that generate the errors a box of x(0) starts; driven:
    pairs (width, two columns) of what one disturbance or noise adds to the flow, between its two ends; cut: rows of
    e that the intersection with y may shrink at samples.
    """

    M: Matrix
    N1: Matrix
    start: Matrix
    driven: tuple[tuple[arb, Matrix], ...]
    cut: tuple[int, ...] = ()

    @staticmethod
    def of(z: Coordinates, disturbance: Matrix, noise: Matrix, measured: Iterable[int] = ()) -> ErrorSystem:
        """Widths of disturbance and noise have shapes (n, 1) and (p, 1); measured: rows of z cut at samples."""
        n = z.S.shape[0]
        start = both_sides(z.S)
        driven = (*_pairs(start, disturbance), *_pairs(both_sides(z.SL), noise))
        cut = tuple(i + side for side in (0, n) for i in measured)
        return ErrorSystem(error_flow(z.Q0), error_flow(z.Q1), start, driven, cut)

    @property
    def size(self) -> int:
        return self.M.shape[0]

    @cached_property
    def pulled_down(self) -> tuple[int, ...]:
        """Rows whose own injection may be negative: no other entry of e can be the first to lose its sign."""
        return tuple(i for i in range(self.size) if not arb(self.N1[i, i]) >= 0)

    def growth(self, s: arb) -> Matrix:
        """Phi(s) with E(s) = I + s Phi(s)."""
        return growth(self.M, self.M + self.N1, s)

    def at(self, s: arb) -> Matrix:
        """E(s)."""
        E: Matrix = Matrix.identity(self.size) + self.growth(s) * s
        return E

    def after(self, e: Matrix, b: Matrix, s: arb) -> Matrix:
        """exp(M s) e + Gamma(s) (N1 e + b): the errors a time s after a sample, b held since."""
        flow = block([[self.M, self.N1 @ e + b], [Matrix.zeros(1, self.size), Matrix.zeros(1, 1)]]).exp(s)
        after: Matrix = (flow @ block([[e], [Matrix.identity(1)]]))[0 : self.size, :]
        return after

    def maps(self, times: Any) -> tuple[Array, Array] | None:
        """E(s) and Gamma(s) for each s in floats, shapes (times, 2n, 2n); None where they are too large for floats."""
        M, N1, s = self.M.floats, self.N1.floats, np.reshape(times, (-1, 1, 1))
        if not (np.abs(M).sum(axis=1).max() + 1) * s.max() <= _LARGEST_EXPONENT:
            return None
        parts = flows(M, times)
        if parts is None:
            return None
        Gamma = s * parts[1]
        E = parts[0] + Gamma @ N1
        return (E, Gamma) if np.all(np.isfinite(E)) else None


def _pairs(columns: Matrix, widths: Matrix) -> list[tuple[arb, Matrix]]:
    count = widths.shape[0]
    return [(arb(widths[k, 0]), columns[:, [k, count + k]]) for k in range(count) if not arb(widths[k, 0]).is_zero()]


def error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """The errors of the bounds with what is held of them: (e, e(t_k))' = [M N1; 0 0], and e(t_k)+ = e.

    Source: Efimov2016, (11), (12)
    """
    S: Any = view.gain["S"]
    R = S.inverse() if isinstance(S, Matrix) else np.linalg.inv(S)
    z = coordinates(view.A, view.C, S, R, view.gain["L"])
    M, N1 = error_flow(z.Q0), error_flow(z.Q1)
    zero, identity = zeros_like(M, *M.shape), identity_like(M, M.shape[0])
    jump: Any = block([[identity, zero], [identity, zero]])
    return ErrorMaps(base=block([[M, N1], [zero, zero]]), parts=(), lower=(), upper=(), jump=jump)
