"""Linear matrix inequalities over many corners: cutting planes, so that most corners are never handed over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from cdobs_cli.certify.lmi import Program, Solution, Unknown, full

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Values = Mapping[str, Array]

MOST_CORNERS = 4096
_FIRST = 8
_MORE = 8
_ROUNDS = 40


def largest_margin(
    unknowns: Mapping[str, Unknown],
    inequality: Callable[[Values, Array], Array],
    vertices: Sequence[Array],
    positive: Sequence[Callable[[Values], Array]],
    normalise: Callable[[Values], float] | None = None,
) -> tuple[Solution, float]:
    """maximise t <= 1 with inequality(x, A_i) <= -t I at every vertex, positive(x) >= t I, normalise(x) = 0.

    `normalise` is for inequalities that are homogeneous in the unknowns. The vertices that a guess violates are
    added until none is; a few suffice even of thousands.

    Returns:
        The last solution, and its margin over all vertices recomputed from its values: a guess, not a proof.
    """
    import numpy as np

    chosen = list(range(len(vertices))) if len(vertices) <= 2 * _FIRST else _spread(len(vertices))
    zeros = {name: unknown.matrix(np.zeros(unknown.size)) for name, unknown in unknowns.items()}
    unit = np.eye(inequality(zeros, vertices[0]).shape[0])
    units = [np.eye(form(zeros).shape[0]) for form in positive]

    def at(A_i: Array) -> Callable[[Values], Array]:
        return lambda x: -inequality(x, A_i) - unit * x["t"]

    def above(k: int) -> Callable[[Values], Array]:
        return lambda x: positive[k](x) - units[k] * x["t"]

    for _ in range(_ROUNDS):
        program = Program({**unknowns, "t": full(1, 1)})
        for index in chosen:
            program.require(at(vertices[index]))
        for k in range(len(positive)):
            program.require(above(k))
        program.require(lambda x: 1 - x["t"])
        if normalise is not None:
            program.equate(lambda x: np.atleast_2d(normalise(x)))
        program.maximise(lambda x: x["t"])
        solution = program.solve()
        x = solution.values
        if not all(np.all(np.isfinite(value)) for value in x.values()):
            return solution, -np.inf
        margins = -np.linalg.eigvalsh(np.array([inequality(x, A_i) for A_i in vertices]))[:, -1]
        margin = min(float(margins.min()), *(float(np.linalg.eigvalsh(form(x))[0]) for form in positive))
        wanted = float(x["t"][0, 0])
        worst = [int(i) for i in np.argsort(margins)[:_MORE] if i not in chosen and margins[i] < 0.9 * wanted]
        if wanted <= 0 or not worst:
            break
        chosen += worst
    return solution, margin


def _spread(count: int) -> list[int]:
    """Corners that differ much: the ends, and some between."""
    return sorted({round(k * (count - 1) / (_FIRST - 1)) for k in range(_FIRST)})
