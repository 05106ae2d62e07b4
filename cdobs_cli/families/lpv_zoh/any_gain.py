"""Periods that no gain survives: constant slopes, constant periods, and Farkas' lemma over the gain.

With one output the characteristic polynomial of the sampled error, p(z) = det(z I - Phi + Gamma L C), is
affine in L. Each condition below is necessary for all roots in the open disc and affine in L too; a positive
combination of them that is a constant <= 0 shows that every L breaks one of them, at one of the slopes and
periods used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import comb
from typing import TYPE_CHECKING, Any

from flint import arb, arb_mat

from cdobs_cli.certificate import Certificate
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

METHOD = "any_gain"
_MOST_ENTRIES = 6


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

    def document(self) -> dict[str, Any]:
        return {"kind": self.kind, "order": self.order, "slopes": [str(v) for v in self.slopes], "period": str(self.period)}

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
    flow = block([[A_i, identity], [identity * 0, identity * 0]]).exp(_number(T))
    Phi, Gamma = flow[:n, :n], flow[:n, n:]
    maps = [Phi] + [Phi - Gamma @ identity[:, k] @ C for k in range(n)]
    return [_characteristic(arb_mat(M.arb)) for M in maps]


def _characteristic(M: arb_mat) -> list[arb]:
    polynomial = M.charpoly()
    return [polynomial[k] for k in range(M.nrows(), -1, -1)]


def _number(value: Exact) -> Any:
    return value.ball() if value.rational is None else value.rational


def _vertex(view: PlantView[Matrix], slopes: Sequence[Exact]) -> Matrix:
    A_i = view.A
    for value, (i, j) in zip(slopes, view.entries, strict=True):
        A_i = A_i + (view.unit(i) @ view.unit(j).T) * _number(value)
    return A_i


def prove(plant: Plant, certificate: Certificate) -> bool:
    """Whether every gain fails under the certificate's law, from the exact plant.

    The faces are n + 1 conditions b_k + a_k L > 0 at slopes of the box and periods of the law; multipliers
    with sum lambda_k a_k = 0 are enclosed, and lambda_k > 0, sum lambda_k b_k <= 0 proved.
    """
    faces = [Face.from_document(face) for face in certificate.data["faces"]]
    n = plant.n
    if plant.p != 1 or len(faces) != n + 1:
        return False
    view = PlantView.balls(plant, {})
    law, slopes = certificate.sampling, plant.slopes
    rows: list[tuple[Any, list[Any]]] = []
    for face in faces:
        inside = len(face.slopes) == len(view.entries) and all(
            slopes.lower[entry].is_at_most(v) and v.is_at_most(slopes.upper[entry])
            for entry, v in zip(view.entries, face.slopes, strict=True)
        )
        if not inside or face.period.sign() != 1 or not law.contains(SamplingLaw.periodic(face.period)):
            return False
        if (face.kind, face.order) not in set(kinds(n)):
            return False
        rows.append(affine(sampled_polynomials(_vertex(view, face.slopes), view.C, face.period), face.kind, face.order))
    a = Matrix.from_rows([[arb(rows[k][1][i]) for k in range(n)] for i in range(n)])
    last = Matrix.from_rows([[-arb(value)] for value in rows[n][1]])
    try:
        multipliers = [arb(a.solve(last)[k, 0]) for k in range(n)] + [arb(1)]
    except ZeroDivisionError:
        return False
    total = sum((weight * row[0] for weight, row in zip(multipliers, rows, strict=True)), arb(0))
    return all(weight > 0 for weight in multipliers) and bool(total <= 0)


def search(plant: Plant, law: SamplingLaw, effort: int) -> Certificate | None:
    """A proved certificate that no gain survives this law, or None. One output only."""
    import numpy as np
    from scipy.optimize import linprog

    if plant.p != 1 or len(plant.slopes.uncertain) > _MOST_ENTRIES:
        return None
    view = PlantView.balls(plant, {})
    faces: list[Face] = []
    b: list[float] = []
    a: list[list[float]] = []
    for period in _periods(law):
        for slopes in _slopes(plant, effort):
            polynomials = sampled_polynomials(_vertex(view, slopes), view.C, period)
            for kind, order in kinds(plant.n):
                offset, row = affine(polynomials, kind, order)
                faces.append(Face(kind, order, slopes, period))
                b.append(float(arb(offset).mid()))
                a.append([float(arb(value).mid()) for value in row])
    offsets, matrix = np.array(b), np.array(a)
    columns = np.abs(matrix).max(axis=0)
    if not np.all(np.isfinite(matrix)) or not np.all(np.isfinite(offsets)) or not np.all(columns > 0):
        return None
    matrix = matrix / columns
    sizes = np.abs(matrix).sum(axis=1) + np.abs(offsets)
    # A condition that no gain moves and that holds with equality: nothing to weigh.
    kept = sizes > 0
    faces = [face for face, keep in zip(faces, kept, strict=True) if keep]
    matrix, offsets = matrix[kept] / sizes[kept, None], offsets[kept] / sizes[kept]
    found = linprog(offsets, A_eq=np.vstack([matrix.T, np.ones(len(faces))]), b_eq=np.append(np.zeros(plant.n), 1.0), method="highs-ds")
    if found.status != 0 or found.x is None or float(offsets @ found.x) > 1e-12:
        return None
    support = [faces[k].document() for k in np.flatnonzero(found.x > 1e-12)]
    certificate = Certificate(METHOD, law, {"faces": support})
    return certificate if prove(plant, certificate) else None


def _periods(law: SamplingLaw) -> list[Exact]:
    """The largest period, and for an interval some below it."""
    if law.is_periodic or law.T_max.rational is None or law.T_min.rational is None:
        return [law.T_max]
    low, high = law.T_min.rational, law.T_max.rational
    return [law.T_max, *(Exact(low + (high - low) * k / 4) for k in (1, 2, 3))]


def _slopes(plant: Plant, effort: int) -> list[tuple[Exact, ...]]:
    """The corners of the slope box, and with one or two entries a grid inside it."""
    entries = plant.slopes.uncertain
    count = {0: 1, 1: 8 * 2**effort, 2: 4}.get(len(entries), 1)
    choices = []
    for entry in entries:
        low, high = plant.slopes.lower[entry], plant.slopes.upper[entry]
        choices.append([low, *(low + (high - low) * Exact(f"{k}/{count}") for k in range(1, count)), high])
    return list(product(*choices))
