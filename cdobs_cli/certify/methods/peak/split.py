"""The error in a basis that parts what samples keep of it from the rest, shifted by what noise has left in the rest.

    y = S^-1 e,    S^-1 J S = diag(I, j),    S^-1 G = [0; G_w],    x = y - H s_k,

s_k constant between samples, so that noise is an input of the flow and no sample adds any. Where j = 0 each sample
erases the noise of the one before: H = [0; G_w], s_k = v_k. Otherwise what is left of all noise, s_k = j s_(k-1) +
G_w v_k, enters through H = [0; I], and is at most s0 = (1 - |j|)^-1 |G_w| v0, component by component, where that
inverse is >= 0: exactly then the powers of |j| have a finite sum. A hold has S = I, j = 0; a correction K has j similar
to I - C K.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.form import erases_the_rest, in_basis, jump_gap, kept_states
from cdobs_cli.certify.methods.peak.signals import Signals, exact_signals
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.plant import Box


@dataclass(frozen=True)
class Split:
    """The shifted error: maps with jump = diag(I, j), I on `kept`; B (N, q), H (N, m), S (N, N); d0 (q,), s0 (m,)."""

    maps: ErrorMaps[Matrix]
    kept: list[int]
    B: Matrix
    H: Matrix
    S: Matrix
    d0: tuple[Any, ...]
    s0: tuple[Any, ...]

    @property
    def sizes(self) -> tuple[Any, ...]:
        """u0 = (d0, s0)."""
        return (*self.d0, *self.s0)

    def inputs(self, A: Matrix) -> Matrix:
        """[B, A H]: how (d, s_k) enters."""
        return block([[self.B, A @ self.H]])

    def target(self, i: int) -> tuple[Matrix, Matrix]:
        """z and g of state i; g of no rows where it is 0."""
        z = self.S[[i], :].T
        g = self.H.T @ z
        return z, g[[], :] if all(row[0] == 0 for row in g.tolist()) else g

    def first_vertices(self, start: Box) -> list[Matrix] | None:
        """The corners of x just after the first sample, from errors in this box before it."""
        none = Signals(self.B, self.H[:, []], self.d0, ())  # the noise of that sample is what x is shifted by
        jump = self.S @ self.maps.jump @ self.S.inverse()
        vertices = first_vertices(replace(self.maps, jump=jump), none, start)
        return None if vertices is None else [self.S.inverse() @ e for e in vertices]

    def begins_apart(self, P_0: Matrix) -> bool:
        """P(0) = diag(P_11, Q) exactly, and Q - j'Q j > 0 for J = diag(I, j)."""
        lost = [i for i in range(P_0.shape[0]) if i not in self.kept]
        if any(P_0[i, j] != 0 for i in self.kept for j in lost):
            return False
        Q = P_0[lost, lost]
        return not lost or has_positive_pivots(jump_gap(Q, Q, self.maps.jump[lost, lost]).balls())


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
        H, s0 = Matrix.identity(S.shape[0])[:, lost], left
    return Split(maps, kept, back @ signals.B, H, S, signals.d0, s0)


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
