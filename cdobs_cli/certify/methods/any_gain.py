"""Periods that no gain survives: constant slopes, constant periods, and Farkas' lemma over the gain.

With one output the characteristic polynomial of the sampled error, p(z) = det(z I - Phi + Gamma L C), is
affine in L. Each condition below is necessary for all roots in the open disc and affine in L too; a positive
combination of them that is a constant <= 0 shows that every L breaks one of them, at one of the slopes and
periods used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import comb
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from flint import arb, arb_mat

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.words import are_within
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_MOST_ENTRIES = 6


@dataclass(frozen=True)
class NoGain(Method):
    """faces: n + 1 conditions of which every gain breaks one."""

    faces: list[dict[str, Any]]

    name: ClassVar[str] = "any_gain"
    rung: ClassVar[str] = "any_gain"
    source: ClassVar[str] = "Farkas' lemma over the gain"
    how: ClassVar[str] = "multipliers enclosed in balls"
    statement: ClassVar[str] = "Every gain fails"
    reach: ClassVar[Reach] = "no gain"

    @classmethod
    def applies(cls, question: Question) -> bool:
        """One output, few slopes that vary."""
        few = len(question.plant.slopes.quantities) <= _MOST_ENTRIES
        return super().applies(question) and question.plant.p == 1 and few

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        from scipy.optimize import linprog

        if not cls.applies(question):
            return None
        faces, offsets, matrix = _guessed_faces(question)
        columns = np.abs(matrix).max(axis=0)
        if not np.all(np.isfinite(matrix)) or not np.all(np.isfinite(offsets)) or not np.all(columns > 0):
            return None
        matrix = matrix / columns
        sizes = np.abs(matrix).sum(axis=1) + np.abs(offsets)
        # A condition that no gain moves and that holds with equality: nothing to weigh.
        kept = np.flatnonzero(sizes > 0)
        matrix, offsets = matrix[kept] / sizes[kept, None], offsets[kept] / sizes[kept]
        rows, right = np.vstack([matrix.T, np.ones(len(kept))]), np.append(np.zeros(question.plant.n), 1.0)
        weights = linprog(offsets, A_eq=rows, b_eq=right, method="highs-ds")
        if weights.status != 0 or weights.x is None or float(offsets @ weights.x) > 1e-12:
            return None
        support = cls(question.law, [faces[kept[k]].document() for k in np.flatnonzero(weights.x > 1e-12)])
        return support if support.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        """The faces are n + 1 conditions b_k + a_k L > 0 at slopes of the box and periods of the law; multipliers
        with sum lambda_k a_k = 0 are enclosed, and lambda_k > 0, sum lambda_k b_k <= 0 proved."""
        plant, view = question.plant, question.inclusion.view_balls
        faces, n = [Face.from_document(face) for face in self.faces], plant.n
        if plant.p != 1 or len(faces) != n + 1 or not all(face.is_of(plant, self.law) for face in faces):
            return NOTHING
        rows = []
        for face in faces:
            polynomials = sampled_polynomials(view.flow(v.scalar for v in face.slopes), view.C, face.period)
            rows.append(affine(polynomials, face.kind, face.order))
        a = Matrix.from_rows([[arb(rows[k][1][i]) for k in range(n)] for i in range(n)])
        last = Matrix.from_rows([[-arb(value)] for value in rows[n][1]])
        multipliers = [arb(a.solve(last)[k, 0]) for k in range(n)] + [arb(1)]
        total = sum((weight * row[0] for weight, row in zip(multipliers, rows, strict=True)), arb(0))
        return Proof.of(all(weight > 0 for weight in multipliers) and bool(total <= 0))


@dataclass(frozen=True)
class Face:
    """One necessary condition at constant slopes and a constant period.

    kind `plus`: p^(order)(1) > 0; `minus`: (-1)^(n - order) p^(order)(-1) > 0 (roots of derivatives stay in the
    disc); `below`, `above`: the coefficient of z^(n - order) lies in (-1, 1) times binomial(n, order).
    """

    kind: str
    order: int
    slopes: tuple[Exact, ...]
    period: Exact

    def is_of(self, plant: Plant, law: SamplingLaw) -> bool:
        """Whether its slopes lie in the plant's box and its period in the law."""
        quantities = plant.slopes.quantities
        return (
            are_within(self.slopes, quantities)
            and self.period.sign() == 1
            and law.contains(SamplingLaw.periodic(self.period))
            and (self.kind, self.order) in set(kinds(plant.n))
        )

    def document(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "order": self.order,
            "slopes": [str(v) for v in self.slopes],
            "period": str(self.period),
        }

    @staticmethod
    def from_document(document: dict[str, Any]) -> Face:
        """Raises: KeyError, ValueError, ExpressionError on what `document` did not write."""
        slopes = tuple(Exact(v) for v in document["slopes"])
        return Face(str(document["kind"]), int(document["order"]), slopes, Exact(document["period"]))


def kinds(n: int) -> Iterator[tuple[str, int]]:
    """All conditions for degree n."""
    for order in range(n):
        yield "plus", order
        yield "minus", order
    for order in range(1, n + 1):
        yield "below", order
        yield "above", order


def condition(coefficients: Sequence[Any], kind: str, order: int) -> Any:
    """The value that must be positive, from the coefficients of p (highest power first)."""
    n = len(coefficients) - 1
    if kind in ("plus", "minus"):
        z = 1 if kind == "plus" else -1
        total: Any = 0
        for power in range(order, n + 1):
            falling = comb(power, order) * (z ** (power - order)) * (z ** (n - order))
            total = coefficients[n - power] * falling + total
        return total
    return comb(n, order) - coefficients[order] if kind == "below" else comb(n, order) + coefficients[order]


def affine(coefficients: Sequence[Sequence[Any]], kind: str, order: int) -> tuple[Any, list[Any]]:
    """The condition as b + a L: from the coefficients of p at L = 0 and at the n unit gains."""
    b = condition(coefficients[0], kind, order)
    return b, [condition(row, kind, order) - b for row in coefficients[1:]]


def sampled_polynomials(A_i: Matrix, C: Matrix, T: Exact) -> list[list[arb]]:
    """Coefficients of p, highest power first, at L = 0 and at each unit gain, enclosed.

    Phi and Gamma (the integral of exp(A_i s) over a period) from exp([[A_i, I], [0, 0]] T).
    """
    n = A_i.shape[0]
    identity = Matrix.identity(n)
    flow = block([[A_i, identity], [identity * 0, identity * 0]]).exp(T.scalar)
    Phi, Gamma = flow[:n, :n], flow[:n, n:]
    maps = [Phi] + [Phi - Gamma @ identity[:, k] @ C for k in range(n)]
    return [_characteristic(arb_mat(M.arb)) for M in maps]


def _characteristic(M: arb_mat) -> list[arb]:
    polynomial = M.charpoly()
    return [polynomial[k] for k in range(M.nrows(), -1, -1)]


def _characteristics(maps: Array) -> Array:
    """Coefficients of det(z I - M), highest power first, of matrices (.., n, n)."""
    roots = np.linalg.eigvals(maps)
    made = np.zeros((*roots.shape[:-1], roots.shape[-1] + 1), dtype=complex)
    made[..., 0] = 1.0
    for k in range(roots.shape[-1]):
        made[..., 1:] = made[..., 1:] - roots[..., [k]] * made[..., :-1]
    return np.real(made)


def _guessed_faces(question: Question) -> tuple[list[Face], Array, Array]:
    """The conditions tried, each b + a L > 0 with b (k,) and a (k, n) in floats."""
    plant, view, n = question.plant, question.inclusion.view_floats, question.plant.n
    places = [(v, T) for T in _periods(question.law) for v in _slopes(plant, question.effort)]
    flow = np.zeros((len(places), 2 * n, 2 * n))
    for k, (slopes, T) in enumerate(places):
        flow[k, :n, :n] = view.flow(tuple(map(float, slopes))) * float(T)
        flow[k, :n, n:] = np.eye(n) * float(T)
    sampled = exponentials(flow)
    Phi, Gamma = sampled[:, :n, :n], sampled[:, :n, n:]
    maps = np.array([Phi, *(Phi - Gamma[:, :, [k]] @ view.C for k in range(n))])
    # (n + 1, places, n + 1): coefficients first, then places, then L = 0 and the unit gains.
    polynomials = _characteristics(maps).transpose(2, 1, 0)
    faces, offsets, rows = [], [], []
    for kind, order in kinds(n):
        values = condition(list(polynomials), kind, order)
        faces += [Face(kind, order, slopes, T) for slopes, T in places]
        offsets.append(values[:, 0])
        rows.append(values[:, 1:] - values[:, [0]])
    return faces, np.concatenate(offsets), np.concatenate(rows)


def _periods(law: SamplingLaw) -> list[Exact]:
    """The largest period, and for an interval some below it."""
    if law.is_periodic or law.T_max.rational is None or law.T_min.rational is None:
        return [law.T_max]
    low, high = law.T_min.rational, law.T_max.rational
    return [law.T_max, *(Exact(low + (high - low) * k / 4) for k in (1, 2, 3))]


def _slopes(plant: Plant, effort: int) -> list[tuple[Exact, ...]]:
    """The corners of the slope box, and with one or two entries a grid inside it."""
    quantities = plant.slopes.quantities
    count = {0: 1, 1: 8 * 2**effort, 2: 4}.get(len(quantities), 1)
    choices = []
    for rho in quantities:
        low, high = rho.lower, rho.upper
        choices.append([low, *(low + (high - low) * Exact(f"{k}/{count}") for k in range(1, count)), high])
    return list(product(*choices))
