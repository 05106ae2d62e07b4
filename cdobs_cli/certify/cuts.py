"""Linear matrix inequalities over many members (corners, matrices of a set): cutting planes, so that most of them are
never handed over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.lmi import Program, Solution, Unknown, full

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

    Values = Mapping[str, Array]

MOST_CORNERS = 4096
_FIRST = 8
_MORE = 8
_ROUNDS = 40
_SLIGHT = 1e-3  # of the largest multiplier: members of less do not bind


def largest_margin(
    unknowns: Mapping[str, Unknown],
    inequality: Callable[[Values, Any], Array],
    members: Sequence[Any],
    positive: Sequence[Callable[[Values], Array]],
    normalise: Callable[[Values], float] | None = None,
    *,
    margins: Callable[[Values], Array] | None = None,
    share: float = 0.9,
    memory: dict[Any, list[int]] | None = None,
) -> tuple[Solution, float]:
    """maximise t <= 1 with inequality(x, member) >= t I at every member, positive(x) >= t I, normalise(x) = 0.

    The members whose margin a guess leaves below `share` of t are added, until there are none; a few suffice even of
    thousands. Inequalities that are homogeneous in the unknowns need a `normalise`.

    Args:
        inequality: by +, -, products, .T and `block`, so that it takes stacks of matrices.
        margins: over all members at once, where that is quicker than the least eigenvalue of each inequality.
        memory: the members that bound in the search before, by what was searched: this one starts from them.

    Returns:
        The last solution, and its margin over all members recomputed from its values: a guess, not a proof.
    """
    solution, margin, _ = margin_and_binding(
        unknowns, inequality, members, positive, normalise, margins=margins, share=share, memory=memory
    )
    return solution, margin


def margin_and_binding(
    unknowns: Mapping[str, Unknown],
    inequality: Callable[[Values, Any], Array],
    members: Sequence[Any],
    positive: Sequence[Callable[[Values], Array]],
    normalise: Callable[[Values], float] | None = None,
    *,
    margins: Callable[[Values], Array] | None = None,
    share: float = 0.9,
    memory: dict[Any, list[int]] | None = None,
) -> tuple[Solution, float, list[tuple[int, Array]]]:
    """`largest_margin`, and the members imposed with their multipliers Z: where the inequality moves, t moves by
    the sum of <Z, dF> over them, while it is below 1."""
    kind, known = ("+".join(unknowns), len(members)), {} if memory is None else memory
    wanted = known.get(kind) or _spread(len(members))
    program = Program({**unknowns, "t": full(1, 1)})
    zeros = {name: unknown.matrix(np.zeros(unknown.size)) for name, unknown in unknowns.items()}

    def above(form: Callable[[Values], Array]) -> None:
        unit = np.eye(len(form(zeros)))
        program.require_at_once(lambda x: form(x) - unit * x["t"])

    for form in positive:
        above(form)
    program.require(lambda x: 1 - x["t"])
    if normalise is not None:
        program.equate(lambda x: np.atleast_2d(normalise(x)))
    program.maximise(lambda x: x["t"])
    chosen: list[int] = []
    for _ in range(_ROUNDS):
        for k in wanted:
            above(lambda x, member=members[k]: inequality(x, member))  # type: ignore[misc]
        chosen += wanted
        solution = program.solve()
        x = solution.values
        if not all(np.all(np.isfinite(value)) for value in x.values()):
            return solution, -np.inf, []
        met = _least(x, inequality, members) if margins is None else margins(x)
        margin = min(float(met.min()), *(float(np.linalg.eigvalsh(form(x))[0]) for form in positive))
        t = float(x["t"][0, 0])
        weights = [float(np.trace(Z)) for Z in solution.multipliers[len(positive) + 1 :]]
        binding = sorted(zip(weights, chosen, strict=True), key=lambda pair: -pair[0])
        known[kind] = [k for weight, k in binding[: 4 * _FIRST] if weight > _SLIGHT * binding[0][0]]
        wanted = [int(k) for k in np.argsort(met)[:_MORE] if k not in chosen and met[k] < share * t]
        if t <= 0 or not wanted:
            break
    return solution, margin, list(zip(chosen, solution.multipliers[len(positive) + 1 :], strict=True))


def _least(x: Values, inequality: Callable[[Values, Any], Array], members: Sequence[Any]) -> Array:
    eigenvalues: Array = np.linalg.eigvalsh(np.array([inequality(x, member) for member in members]))[:, 0]
    return eigenvalues


def _spread(count: int) -> list[int]:
    """All of a few; of many some that differ much: the ends, and some between."""
    if count <= 2 * _FIRST:
        return list(range(count))
    return sorted({round(k * (count - 1) / (_FIRST - 1)) for k in range(_FIRST)})
