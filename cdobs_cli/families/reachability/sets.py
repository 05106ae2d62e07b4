"""The set M of a plant and a period: interval matrices whose members hold every Phi_V(delta)."""

from __future__ import annotations

from functools import reduce
from math import prod
from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.certify.ball import is_finite
from cdobs_cli.certify.kernel import is_zero
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability.canonical import box_31, delta_star, holds_until, last_row
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import MatrixSet, Reachability

SAME = arb(10) ** -25

MatrixRows = tuple[tuple[frozenset[Expression], ...], ...]


def construction(plant: Plant) -> str:
    """Which theorem gives the box of `reachable_box`."""
    if not plant.slopes.uncertain:
        return "exp(A delta), all slopes are constant"
    return "Dinh2014, Theorem III.2, (31)" if is_chain(plant) else "Dinh2014, Lemma III.1, extreme u at each instant"


def reachable_box(plant: Plant, delta: arb) -> IntervalMatrix | None:
    """The box that holds every Phi_V(delta); None where it could not be enclosed.

    For chains it holds for delta <= delta_star only, which `box_holds` proves.
    """
    if not plant.slopes.uncertain:
        flow = PlantView.balls(plant, {}).A.exp(delta)
        return IntervalMatrix(flow, Matrix.zeros(plant.n, plant.n)) if is_finite(flow) else None
    if is_chain(plant):
        box: IntervalMatrix | None = box_31(last_row(plant), delta)
    else:
        from cdobs_cli.families.reachability.feedforward import lemma_3_1

        box = lemma_3_1(plant, delta)
    return box if box is not None and is_finite(box.upper) else None


def box_holds(plant: Plant, delta: arb) -> bool:
    """Whether the construction of `reachable_box` is proved to hold at delta."""
    return not plant.slopes.uncertain or not is_chain(plant) or holds_until(last_row(plant), delta)


def set_limit(plant: Plant) -> arb:
    """Up to which delta the construction holds: delta_star for chains, +inf for the others."""
    return delta_star(last_row(plant)) if plant.slopes.uncertain and is_chain(plant) else arb("inf")


def matrix_set(family: Reachability, plant: Plant, delta: Exact) -> tuple[IntervalMatrix, ...] | None:
    """The set M at delta: the typed one, or the box of the plant's structure."""
    return set_round(family, reachable_box(plant, delta.ball()), delta)


def set_round(family: Reachability, box: IntervalMatrix | None, delta: Exact) -> tuple[IntervalMatrix, ...] | None:
    """The same where the box of the plant's structure is known."""
    if family.set != "clarke":
        boxes = typed_set(family.set, delta.ball())
        return boxes if boxes is None or box is None else tuple(meeting(outer, box) for outer in boxes)
    return None if box is None else (box,)


def meeting(outer: IntervalMatrix, inner: IntervalMatrix) -> IntervalMatrix:
    """`outer` with each end that equals the end of `inner` to 25 digits moved out by as much: balls cannot
    tell whether equal numbers are in order, and (13) is proved with the ends that were moved."""
    ends = []
    for sign, theirs, ours in (
        (-1, inner.lower.balls(), outer.lower.balls()),
        (1, inner.upper.balls(), outer.upper.balls()),
    ):
        n = ours.shape[0]
        rows = [[ours[i, j] for j in range(n)] for i in range(n)]
        for i in range(n):
            for j in range(n):
                slack = SAME * (ours[i, j].abs_upper() + theirs[i, j].abs_upper())
                if (ours[i, j] - theirs[i, j]).abs_upper() <= slack and not slack.is_zero():
                    rows[i][j] = ours[i, j] + 2 * sign * slack
        ends.append(rows)
    varies = [
        [not is_zero(outer.radius[i, j]) or bool(ends[0][i][j] < ends[1][i][j]) for j in range(n)] for i in range(n)
    ]
    for i in range(n):
        for j in range(n):
            if not varies[i][j]:
                ends[0][i][j] = ends[1][i][j]
    return IntervalMatrix.between(ends[0], ends[1])


def typed_set(typed: MatrixSet, delta: arb) -> tuple[IntervalMatrix, ...] | None:
    """The typed matrices at delta. Matrices that run over every combination of their entries' values are
    one box; its convex hull is that of the smallest and largest values."""
    matrices: list[MatrixRows] = [
        tuple(
            tuple(frozenset(entry) if isinstance(entry, tuple) else frozenset((entry,)) for entry in row)
            for row in matrix
        )
        for matrix in typed.matrices
    ]
    n = len(matrices[0])
    joined: MatrixRows = tuple(
        tuple(frozenset().union(*(matrix[i][j] for matrix in matrices)) for j in range(n)) for i in range(n)
    )
    if all(len(entry) == 1 for matrix in matrices for row in matrix for entry in row) and len(set(matrices)) == prod(
        len(entry) for row in joined for entry in row
    ):
        matrices = [joined]
    boxes = tuple(_box(matrix, delta) for matrix in matrices)
    return boxes if all(is_finite(box.upper) and is_finite(box.lower) for box in boxes) else None


def _box(matrix: MatrixRows, delta: arb) -> IntervalMatrix:
    lower, upper = [], []
    for row in matrix:
        values = [[expression.ball({"delta": delta}) for expression in entry] for entry in row]
        lower.append([reduce(arb.min, entry) for entry in values])
        upper.append([reduce(arb.max, entry) for entry in values])
    return IntervalMatrix.between(lower, upper)


def inclusion_12(box: IntervalMatrix, boxes: tuple[IntervalMatrix, ...]) -> bool:
    """Whether every member of the reachable box is proved to lie in one of the boxes of the set.

    Source: Dinh2014, Theorem II.2, (12)
    """
    return any(outer.contains(box) for outer in boxes)
