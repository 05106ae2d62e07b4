"""A typed set put to the test: a slope history whose error leaves it."""

from __future__ import annotations

from itertools import islice, product
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb

from cdobs_cli.certificate import Claim, Witness
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, decimal_text, lower_text, upper_text
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.families.reachability.sets import construction, matrix_set
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

MAX_CORNERS = 16
PIECES = 16


def escapes(plant: Plant, delta: Exact, boxes: tuple[IntervalMatrix, ...]) -> Witness | None:
    """A V(t) with at most one switch, at the corners of the slope box, for which an entry of Phi_V(delta) is
    proved to lie outside the hull of all boxes: the error from a unit vector is then outside Conv{M e}.

    Source: Dinh2014, Theorem II.2, (12)
    """
    n = plant.n
    low, up = _hull(boxes, n)
    view = PlantView.balls(plant, {})
    corners = list(islice(product(*zip(view.lower, view.upper, strict=True)), MAX_CORNERS))
    flows = [view.flow(v) for v in corners]
    parts = [[flow.exp(delta.ball() * k / PIECES) for k in range(PIECES + 1)] for flow in flows]
    floats = np.array([[part.floats for part in row] for row in parts])
    bottom = np.array([[float(value.mid()) for value in row] for row in low])
    top = np.array([[float(value.mid()) for value in row] for row in up])
    best: tuple[float, Any] = (0.0, None)
    for first, second, k in product(range(len(flows)), range(len(flows)), range(PIECES + 1)):
        Phi = floats[second, PIECES - k] @ floats[first, k]
        size = 1e-12 + np.abs(Phi)
        outside = np.maximum(Phi - top, bottom - Phi) / size
        i, j = np.unravel_index(int(np.argmax(outside)), outside.shape)
        if outside[i, j] > best[0]:
            best = (float(outside[i, j]), (first, second, k, int(i), int(j)))
    if best[1] is None or best[0] < 1e-9:
        return None
    first, second, k, i, j = best[1]
    value = (parts[second][PIECES - k] @ parts[first][k]).balls()[i, j]
    if not (value > up[i][j] or value < low[i][j]):
        return None
    chosen = [(first, k), (second, PIECES - k)]
    arcs = [(corner, count) for corner, count in chosen if count]
    return Witness(
        "switching" if len(arcs) > 1 else "constant", "class",
        times=tuple(str(Exact(f"({delta}) * {count} / {PIECES}")) for _, count in arcs),
        values=tuple(_texts(corners[corner], view) for corner, _ in arcs),
        entries=tuple(rho.entry for rho in view.quantities),
        data={"arcs": [len(arcs)], "entry": [i + 1, j + 1], "reached": decimal_text(float(value.mid()), 9),
              "set": [lower_text(low[i][j], 9), upper_text(up[i][j], 9)]},
    )  # fmt: skip


def _hull(boxes: tuple[IntervalMatrix, ...], n: int) -> tuple[list[list[arb]], list[list[arb]]]:
    lower, upper = [box.lower.balls() for box in boxes], [box.upper.balls() for box in boxes]
    low = [[lower[0][i, j] for j in range(n)] for i in range(n)]
    up = [[upper[0][i, j] for j in range(n)] for i in range(n)]
    for i, j in product(range(n), range(n)):
        for matrix in lower[1:]:
            low[i][j] = low[i][j].min(matrix[i, j])
        for matrix in upper[1:]:
            up[i][j] = up[i][j].max(matrix[i, j])
    return low, up


def _texts(v: tuple[Any, ...], view: PlantView[Matrix]) -> tuple[str, ...]:
    ends = zip(v, view.lower, view.quantities, strict=True)
    return tuple(str(rho.lower if value is low else rho.upper) for value, low, rho in ends)


def inclusion_claim(family: Reachability, plant: Plant, delta: Exact, proved: bool) -> Claim:
    """Proved, refuted by a slope history that leaves a typed set, or open."""
    why = f"{construction(plant)}."
    witness = None
    if family.set != "clarke":
        why = "the set is the typed one."
        boxes = None if proved else matrix_set(family, plant, delta)
        witness = None if boxes is None else escapes(plant, delta, boxes)
    status: Any = "refuted" if witness is not None else "proved" if proved else "undecided"
    statement = f"At delta = {delta} every reachable error lies in Conv{{M e, M in the set}}: {why}"
    kind: Any = "premise" if family.set == "clarke" else "printed"
    return Claim("set.inclusion", kind, status, statement, "Dinh2014, Theorem II.2, (12)", witness=witness)
