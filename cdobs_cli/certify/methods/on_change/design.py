"""Gains of sensors that send on change: K_i = c_i P^-1 C_i' / (C_i P^-1 C_i'), of the P of least error."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import lcm
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.gains import Candidate, GainSearch, Merit
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.on_change.certificate import OnChange
from cdobs_cli.certify.methods.on_change.form import deltas, noise_sizes
from cdobs_cli.certify.methods.on_change.scaled import Scaled
from cdobs_cli.certify.methods.on_change.search import Aim, Found, Search, scan, shape_of
from cdobs_cli.certify.methods.rung import told
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_GAIN_DIGITS = 6
_QUIET = 0.45  # noise over threshold up to which all of the error that is seen is taken


@dataclass(frozen=True)
class OnChangeRung:
    """The one line of the ladder: there is no period to be the longest."""

    name: str = OnChange.rung

    def propose(self, question: Question) -> Method | None:
        return told(lambda: OnChange.propose(question), self.name, question)

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        return None

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        """The one of least error: a faster rate has a larger one."""
        return self.propose(question)


class OnChangeGain(GainSearch):
    """K whose every column is along P^-1 C_i', exactly so after rounding."""

    def at(self, question: Question) -> Candidate | None:
        return Candidate.of(design(question.afresh()), 0.0)

    quietest = at

    def least_error(
        self, question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None,
        near: ExactMatrix | None = None,
    ) -> Candidate | None:  # fmt: skip
        return self.at(question)

    def nearest(self, question: Question) -> Candidate | None:
        return None


def design(question: Question) -> tuple[ExactMatrix, Method] | None:
    """A gain of the least weighted error that is found, at the question's rate at least, with its certificate, or None.

    The gain is rounded, and what is proved is about that. Uses the solver."""
    if not OnChange.applies(question):
        return None
    with np.errstate(all="ignore"):
        scaled = Scaled.of(question)
        if scaled is None:
            return None
        found = scan(question, Search(scaled, None, Aim.weighted(question), shape_of(question)))
    for one in found[:4]:
        K = _gain(question, scaled, one)
        method = None if K is None else OnChange.propose(question.with_gain({"K": K}).afresh())
        if K is not None and method is not None:
            return K, method
    return None


def _gain(question: Question, scaled: Scaled, found: Found) -> ExactMatrix | None:
    """K = Q C' L with Q = P^-1 and L diagonal, as decimals. One column is rounded as it is; several only through Q and
    L, so that one P goes with all of them."""
    C, S = question.plant.C, scaled.S
    Q = np.linalg.inv(found.P) * np.outer(S, S)
    rows: Array = np.array(C.floats)
    taken = _corrections(question)
    with np.errstate(all="ignore"):
        K = Q @ rows.T / np.einsum("ij,jk,ik->i", rows, Q, rows) * taken
    if not np.all(np.isfinite(K)):
        return None
    if len(rows) == 1:
        return ExactMatrix.from_floats(K, _GAIN_DIGITS)
    integers = [_integers([C[i, j] for j in range(C.shape[1])]) for i in range(C.shape[0])]
    n = len(Q)
    short = [[Fraction(decimal_text(float(Q[min(i, j), max(i, j)]), _GAIN_DIGITS)) for j in range(n)] for i in range(n)]
    columns: list[list[Fraction]] = []
    for row in integers:
        if row is None:
            return None
        along = [sum((short[i][j] * row[j] for j in range(n)), Fraction(0)) for i in range(n)]
        size = sum((a * b for a, b in zip(row, along, strict=True)), Fraction(0))
        if size <= 0:
            return None
        # row = C_i / unit
        unit, c = _unit(C, len(columns), row), float(taken[len(columns)])
        factor = Fraction(decimal_text(c / (float(size) * unit), _GAIN_DIGITS))
        columns.append([value * factor for value in along])
    return ExactMatrix([[Exact(column[i]) for column in columns] for i in range(n)])


def _corrections(question: Question) -> Array:
    """c_i = C_i K_i: all of the error that sensor i sees, and less where noise is near half of the threshold: c =
    1 - vbar / delta takes most from V at the worst noise, and something as long as noise is below the threshold."""
    plant = question.plant
    share = np.array([float(v) / float(delta) for v, delta in zip(noise_sizes(plant), deltas(plant), strict=True)])
    taken: Array = np.where(share < _QUIET, 1.0, 1.0 - share)
    return taken


def _unit(C: ExactMatrix, i: int, row: list[Fraction]) -> float:
    j = next(j for j, value in enumerate(row) if value)
    return float(C[i, j]) / float(row[j])


def _integers(row: list[Exact]) -> list[Fraction] | None:
    """A row in proportion that is whole; None where it is not rational."""
    values: list[Any] = [one.rational for one in row]
    if any(value is None for value in values):
        return None
    common = lcm(*(value.denominator for value in values))
    return [value * common for value in values]
