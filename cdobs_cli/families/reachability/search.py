"""Gains and Lyapunov matrices for one period, in floats. What it returns is a guess: `certificate.py` decides.

Coordinates: z_i = s_i e_i with s_i = delta^(i-1) for chains, so that time has unit length (unscaled, five
states and more give wrong limits). Cutting planes: solve with few members of the set, add the worst
members over all of them, until none is violated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.cuts import largest_margin
from cdobs_cli.certify.kernel import Kernel
from cdobs_cli.certify.lmi import full, symmetric
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.families.reachability.theorems import lmi_reduced, reduced_map, schur_reduced
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# The members that the last searches ended with, by what was searched: the next period starts from them.
Memory = dict[Any, Any]

LARGEST = 1e100  # maps beyond this contract nothing, and their squares overflow


@dataclass(frozen=True)
class Members:
    """The members of the set that matter, in scaled coordinates: M (V, n, n), with C_r, R, N of the kernel."""

    M: Array
    C: Array
    R: Array
    N: Array
    s: Array
    s_output: Array
    others: tuple[int, ...]

    @property
    def A(self) -> Array:
        """R M N, shape (V, r, r)."""
        value: Array = self.R @ self.M @ self.N
        return value

    @property
    def b(self) -> Array:
        """C M N, shape (V, m, r)."""
        value: Array = self.C @ self.M @ self.N
        return value

    def Z(self, scaled: Array) -> Array:
        """The scaled Q^-1 Y in the plant's coordinates."""
        value: Array = scaled * self.s_output / self.s[list(self.others)][:, None]
        return value

    def Q(self, scaled: Array) -> Array:
        """The scaled Q in the plant's coordinates."""
        s = self.s[list(self.others)]
        value: Array = scaled * s[:, None] * s
        return value


def members(boxes: tuple[IntervalMatrix, ...], kernel: Kernel) -> Members:
    """The members that decide the reduced inequality, over all the boxes."""
    active = [j for j in range(kernel.C.shape[1]) if any(value != 0 for value in kernel.N.floats[j])]
    M = np.concatenate([box.members(list(box.signs(active))) for box in boxes])
    s = scales(M)
    C, R, N = kernel.C_r.floats, kernel.R.floats, kernel.N.floats
    others = list(kernel.others)
    C_scaled = C / s
    s_output = 1.0 / np.max(np.abs(C_scaled), axis=1, initial=1e-300) if len(C) else np.ones(0)
    return Members(
        M=s[:, None] * M / s, C=C_scaled * s_output[:, None], R=s[others][:, None] * R / s, N=s[:, None] * N /
        s[others],
        s=s, s_output=s_output, others=kernel.others,
    )  # fmt: skip


def scales(M: Array) -> Array:
    """s_1 = 1, s_i = s_(i-1) |M_(i-1,i)|: delta^(i-1) for chains. Where the entry vanishes, as the state before."""
    largest = np.max(np.abs(M), axis=0)
    s = np.ones(len(largest))
    for i in range(1, len(largest)):
        step = largest[i - 1, i]
        s[i] = s[i - 1] * (step if 1e-12 < step < 1e12 else 1.0)
    return s if np.all(np.isfinite(s)) and np.all(s > 0) else np.ones(len(largest))


@dataclass(frozen=True)
class Guess:
    """A margin (positive where every member holds), Q and Z = Q^-1 Y, in scaled coordinates."""

    margin: float
    Q: Array
    Z: Array


def design(data: Members, memory: Memory) -> Guess:
    """Maximise t with [[Q, B'], [B, Q]] >= t I at every member, trace Q = 1.

    Source: Dinh2014, Theorem II.2, (13), reduced to ker C
    """
    r, m = data.A.shape[1], data.b.shape[1]
    if r == 1 and m == 1:
        return _minimax(data)

    def margins(x: Any) -> Array:
        return _smallest(x["Q"], data.A - np.linalg.solve(x["Q"], x["Y"]) @ data.b)

    def inequality(x: Any, M: Array) -> Array:
        block: Array = lmi_reduced(x["Q"], reduced_map(x["Q"], x["Y"], M, data.C, data.R, data.N))
        return block

    x, t = _largest_margin({"Q": symmetric(r), "Y": full(r, m)}, inequality, data.M, margins, memory)
    return Guess(t, x["Q"], np.linalg.solve(x["Q"], x["Y"]) if t > 0 else x["Y"])


def _minimax(data: Members) -> Guess:
    """n - m = m = 1: the z that minimises max |a_k - z b_k| lies where two of the lines +-(a - z b) cross."""
    a, b = data.A[:, 0, 0], data.b[:, 0, 0]
    lines = np.concatenate([np.stack([a, b], 1), np.stack([-a, -b], 1)])
    difference = lines[:, None, :] - lines[None, :, :]
    crossing = difference[..., 1] != 0
    candidates = np.unique(np.concatenate([difference[crossing][:, 0] / difference[crossing][:, 1], [0.0]]))
    values = np.max(np.abs(a - candidates[:, None] * b), axis=1)
    best = int(np.argmin(values))
    return Guess(1.0 - float(values[best]), np.eye(1), np.array([[candidates[best]]]))


def lyapunov(F: Array, memory: Memory, rho: float = 1.0) -> tuple[float, Array]:
    """Maximise t with rho^2 Q - F_k'Q F_k >= t I, trace Q = 1, over the matrices F (V, r, r)."""
    r = F.shape[1]
    if not np.max(np.abs(F), initial=0.0) < LARGEST:
        return -1.0, np.eye(r) / r
    if r == 1:
        return rho**2 - float(np.max(F**2)), np.eye(1)

    def margins(x: Any) -> Array:
        return _smallest(x["Q"], F / rho)

    x, t = _largest_margin({"Q": symmetric(r)}, lambda x, F_k: schur_reduced(x["Q"], F_k, rho**2), F, margins, memory)
    return t, x["Q"]


def _largest_margin(
    unknowns: dict[str, Any],
    inequality: Callable[[Any, Array], Array],
    members: Array,
    margins: Callable[[Any], Array],
    memory: Memory,
) -> tuple[Any, float]:
    """maximise t with inequality >= t I at every member, Q >= t I, trace Q = 1: the unknowns, and t; not positive where
    no guess holds at all members."""
    try:
        solution, margin = largest_margin(
            unknowns, inequality, list(members), (lambda x: x["Q"],), lambda x: np.trace(x["Q"]) - 1,
            margins=margins, share=0.5, memory=memory,
        )  # fmt: skip
    except np.linalg.LinAlgError:
        return {name: unknown.matrix(np.zeros(unknown.size)) for name, unknown in unknowns.items()}, -1.0
    t = float(solution.values["t"][0, 0])
    if not np.isfinite(t) or not t > 1e-13:
        return solution.values, t if np.isfinite(t) else -1.0
    return solution.values, t if margin > 0 else -1e-9


def contraction(Q: Array, F: Array) -> float:
    """The largest rho with rho^2 an eigenvalue of Q^-1 F_k'Q F_k; infinite where Q is not positive definite."""
    try:
        L = np.linalg.cholesky((Q + Q.T) / 2)
    except np.linalg.LinAlgError:
        return float("inf")
    norms = np.linalg.norm(L.T @ F @ np.linalg.inv(L.T), 2, axis=(1, 2))
    return float(np.max(norms))


def fastest(F: Array, memory: Memory, rounds: int) -> tuple[float, Array]:
    """(rho, Q) with rho^2 Q - F_k'Q F_k >= 0, rho about as small as one Q allows; rho >= 1 where none is found."""
    margin, Q = lyapunov(F, memory)
    if margin <= 0:
        return 1.0, Q
    rho = contraction(Q, F)
    low, best = 0.0, (rho, Q)
    for _ in range(rounds if F.shape[1] > 1 else 0):
        middle = max((low + best[0]) / 2, 0.8 * best[0])
        margin, Q = lyapunov(F, memory, middle)
        if margin > 0:
            best = min(best, (contraction(Q, F), Q), key=lambda pair: pair[0])
        else:
            low = middle
        if best[0] - low < 1e-3:
            break
    return best


def _smallest(Q: Array, F: Array) -> Array:
    """The smallest eigenvalue of Q - F_k'Q F_k for each k."""
    values: Any = np.linalg.eigvalsh(Q - np.swapaxes(F, 1, 2) @ Q @ F)[:, 0]
    return values  # type: ignore[no-any-return]
