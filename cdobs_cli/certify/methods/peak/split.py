"""The error in a basis that parts what samples keep of it from the rest, shifted by what noise has left in the rest.

    y = S^-1 e,    S^-1 J S = diag(I, j),    S^-1 G = [0; G_w],    x = y - H s_k,

s_k constant between samples, so that noise acts on the flow and no sample adds any. Where j = 0 each sample
erases the noise of the one before: H = [0; G_w], s_k = v_k. Otherwise what is left of all noise, s_k = j s_(k-1) +
G_w v_k, enters through H = [0; I], and is at most s0 = (1 - |j|)^-1 |G_w| v0, component by component, where that
inverse is >= 0: exactly then the powers of |j| have a finite sum. A hold has S = I, j = 0; a correction K has j similar
to I - C K.
"""

from __future__ import annotations

from typing import Any

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import erases_the_rest, in_basis, jump_gap, kept_states
from cdobs_cli.certify.methods.peak.signals import Signals, exact_signals
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Split:
    """The shifted error and what it is shifted by, (x, s): s is constant between samples, and arbitrary after each.

    maps: of (x, s), the jump diag(I, j, 0) with I on `kept`. B (N + m, q); H (N, m), S (N, N); d0 (q,), s0 (m,).
    """

    maps: ErrorMaps[Matrix]
    kept: list[int]
    B: Matrix
    H: Matrix
    S: Matrix
    d0: tuple[Any, ...]
    s0: tuple[Any, ...]

    @property
    def N(self) -> int:
        """How many states x has."""
        return self.S.shape[0]

    def target(self, i: int) -> Matrix:
        """z with e_i = z'(x, s)."""
        row: Matrix = self.S[[i], :]
        return block([[row, row @ self.H]]).T

    def fed(self, weights: list[Any]) -> Matrix:
        """diag(0, weights) on (x, s)."""
        return Matrix.diagonal([0] * self.N + weights)

    def first_vertices(self, start: Box) -> list[Matrix] | None:
        """The corners of (x, 0) just after the first sample, from errors in this box before it: the noise of that
        sample is what x is shifted by, and P(0) does not look at s."""
        rows, back = list(range(self.N)), self.S.inverse()
        flat = self.maps.mapped(lambda flow: flow[rows, rows], lambda J: self.S @ J[rows, rows] @ back)
        silent = Signals(self.B[rows, :], self.H[:, []], self.d0, ())
        vertices = first_vertices(flat, silent, start)
        none = Matrix.zeros(len(self.s0), 1)
        return None if vertices is None else [block([[back @ e], [none]]) for e in vertices]

    def begins_apart(self, P_0: Matrix, from_zero: bool) -> bool:
        """P(0) is exactly 0 on s, so that what s becomes does not matter; from T_min = 0 it is diag(P_11, Q) on x,
        exactly so, with Q - j'Q j > 0."""
        size, N = P_0.shape[0], self.N
        if any(P_0[i, j] != 0 for i in range(N, size) for j in range(size)):
            return False
        lost = [i for i in range(N) if i not in self.kept]
        if not from_zero or not lost:
            return True
        if any(P_0[i, j] != 0 for i in self.kept for j in lost):
            return False
        Q = P_0[lost, lost]
        return has_positive_pivots(jump_gap(Q, Q, self.maps.jump[lost, lost]).balls())


def split_error(question: Question, S: Matrix) -> Split | None:
    """The error in this basis; None where it does not split: J = diag(I, j) exactly, noise enters nothing that J keeps,
    and what it leaves elsewhere stays bounded."""
    inclusion = question.inclusion
    if S.shape != inclusion.balls.base.shape:
        return None
    back, signals = S.inverse(), exact_signals(inclusion)
    maps = in_basis(inclusion.balls, S, back)
    kept, G = kept_states(maps.jump), back @ signals.G
    if not all(value == 0 for row in G[kept, :].tolist() for value in row):
        return None
    H, s0 = G, signals.v0
    if s0 and not erases_the_rest(maps.jump, kept):
        lost = [i for i in range(S.shape[0]) if i not in kept]
        left = _left(maps.jump[lost, lost], G[lost, :], s0)
        if left is None:
            return None
        reached = [k for k, size in enumerate(left) if size != 0]
        H, s0 = Matrix.identity(S.shape[0])[:, [lost[k] for k in reached]], tuple(left[k] for k in reached)
    m, q = len(s0), len(signals.d0)
    below, right = Matrix.zeros(m, S.shape[0]), Matrix.zeros(S.shape[0], m)
    none = Matrix.zeros(m, m)
    extended = maps.mapped(lambda A: block([[A, A @ H], [below, none]]), lambda J: block([[J, right], [below, none]]))
    return Split(extended, kept, block([[back @ signals.B], [Matrix.zeros(m, q)]]), H, S, signals.d0, s0)


def _left(j: Matrix, G_w: Matrix, v0: tuple[Any, ...]) -> tuple[Any, ...] | None:
    """(1 - |j|)^-1 |G_w| v0; None where noise adds up without end."""
    try:
        total = (Matrix.identity(j.shape[0]) - _moduli(j)).inverse()
    except ZeroDivisionError:
        return None
    if not all(value >= 0 for row in total.tolist() for value in row):
        return None
    return tuple(row[0] for row in (total @ _moduli(G_w) @ Matrix.from_rows([[size] for size in v0])).tolist())


def _moduli(M: Matrix) -> Matrix:
    return Matrix.from_rows([[abs(value) for value in row] for row in M.tolist()])
