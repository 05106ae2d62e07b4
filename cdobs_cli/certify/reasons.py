"""Why there is no design, and what to try: told in the names of the states, by floats (a reason is no proof)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import islice, product
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from numpy.typing import NDArray

TOLERANCE = 1e-9
MAX_CORNERS = 256
MAX_QUANTITIES = 6
_SHOWN = 5e-3  # of a direction's largest entry


def undetectable(plant: Plant) -> str | None:
    """The slopes at which the sampled plant is not detectable, as far as floats can tell.

    An eigenvalue of modulus at least 1 whose eigenvector C does not see is not moved by any gain; with constant slopes
    in the class, none converges. The test is Hautus': [lambda I - exp((A + V) delta); C] loses rank. Tried at the
    middle and the corners of the slope box, at the longest period of the law; of sensors with periods of their own over
    a hyperperiod, with the rows C_q exp((A + V) t_q) of all of its samples.
    """
    met = _unseen_at(plant, 0.0)
    if met is None:
        return None
    where, along, root = met
    moves = "grows" if root.real > TOLERANCE else "does not decay"
    advice = f"keep the domain away from {where}, or measure another quantity" if where else "measure another quantity"
    law = plant.sampling
    sampled = law.words if law.has_sensors or law.is_on_change else f"every {law.T_max}"
    return (
        f"sampled {sampled} the plant is not detectable{' where ' + where if where else ''}: "
        f"an error along {along} {moves} (eigenvalue {_complex(root)}) and no output shows it; {advice}"
    )


def unreachable(plant: Plant, rate: float) -> str | None:
    """Why no gain makes errors decay at this rate, as far as floats can tell: an error that no output shows and that
    decays more slowly. Tried where `undetectable` is."""
    met = _unseen_at(plant, rate) if rate > 0 else None
    if met is None:
        return None
    where, along, root = met
    return (
        f"no gain keeps the rate {rate:.6g}: {'where ' + where + ' ' if where else ''}an error along {along} decays at "
        f"{-root.real:.6g} and no output shows it"
    )


def _unseen_at(plant: Plant, rate: float) -> tuple[str, str, complex] | None:
    """Where in the slope class, along which states and with which eigenvalue an unseen error does not decay at this
    rate."""
    view = PlantView.floats(plant, {})
    law = plant.sampling
    delta = 1.0 if law.is_on_change else float(law.hyperperiod if law.is_multirate else law.T_max)
    middle = tuple((low + high) / 2 for low, high in zip(view.lower, view.upper, strict=True))
    corners = product(*zip(view.lower, view.upper, strict=True))
    for v in (middle, *islice(corners, MAX_CORNERS)):
        flow = view.flow(v)
        if not np.all(np.isfinite(flow)):
            return None
        mode = _unseen_mode(flow + rate * np.eye(plant.n), _seen_rows(flow, view.C, law), delta)
        if mode is not None:
            values = zip(v, view.quantities, strict=True)
            where = ", ".join(_equation(rho.text(plant.states), value) for value, rho in values)
            return where, _direction(plant, mode[1]), mode[0] - rate
    return None


def _seen_rows(flow: NDArray[np.float64], C: NDArray[np.float64], law: SamplingLaw) -> NDArray[np.float64]:
    """What the samples of a hyperperiod show of the error at its beginning; C where all are alike."""
    if not law.is_multirate:
        return C
    times = np.array([float(phase.time) * float(law.base) for phase in law.phases])
    Phi = exponentials(flow * times[:, None, None])
    return np.vstack([C[list(phase.outputs)] @ one for phase, one in zip(law.phases, Phi, strict=True)])


def _unseen_mode(flow: NDArray[np.float64], C: NDArray[np.float64], delta: float) -> tuple[complex, Any] | None:
    """An eigenvalue of the flow that does not decay, and a direction of its sampled eigenspace that C does not see."""
    eigenvalues = np.linalg.eigvals(flow)
    if np.max(eigenvalues.real) * delta > 300:
        return None
    sampled = np.exp(eigenvalues * delta)
    size = max(1.0, float(np.linalg.norm(flow, 2)))
    for a in range(len(flow)):
        if abs(sampled[a]) < 1 - TOLERANCE:
            continue
        # The sampled eigenspace joins the eigenspaces of every flow eigenvalue that samples to the same.
        same = [b for b in range(len(flow)) if abs(sampled[b] - sampled[a]) <= TOLERANCE * max(1.0, abs(sampled[a]))]
        spaces = [
            _null_space(flow - eigenvalues[b] * np.eye(len(flow)), size) for b in _distinct(eigenvalues, same, size)
        ]
        basis = np.concatenate(spaces, axis=1)
        seen = C @ basis
        if basis.shape[1] and _rank(seen, float(np.linalg.norm(C, 2)) or 1.0) < basis.shape[1]:
            return complex(eigenvalues[a]), basis @ np.linalg.svd(seen)[2][-1].conj()
    return None


def _equation(function: str, value: float) -> str:
    """`x = 3`, for the function x and for -x = -3."""
    minus = function.startswith("-") and function[1:].isidentifier()
    return f"{function[1:]} = {0.0 - value:.6g}" if minus else f"{function} = {value:.6g}"


def _direction(plant: Plant, direction: Any) -> str:
    """`x - 0.5 y`."""
    turned = direction * np.exp(-1j * np.angle(direction[int(np.argmax(np.abs(direction)))]))
    share = turned.real / np.abs(turned.real).max()
    return " ".join(
        f"{'-' if value < 0 else '+'} {'' if abs(value) == 1 else format(abs(value), '.3g') + ' '}{name}"
        for value, name in zip(share, plant.states, strict=True) if abs(value) > _SHOWN
    ).removeprefix("+ ")  # fmt: skip


def costliest(plant: Plant, longest: Callable[[Plant], float]) -> str | None:
    """Which range of slopes shortens the period most: each halved in turn. None where nothing helps, or for many.

    Args:
        longest: the period that a quick search reaches for a plant; 0 where it finds none.
    """
    quantities = plant.slopes.quantities
    if not 1 <= len(quantities) <= MAX_QUANTITIES:
        return None
    reached = {k: longest(_halved(plant, k)) for k in range(len(quantities))}
    k = max(reached, key=lambda k: reached[k])
    if not reached[k] > 1.05 * longest(plant):
        return None
    rho = quantities[k]
    half = f"half of the range of {rho.text(plant.states)}, now [{rho.lower}, {rho.upper}]"
    return f"{half}, would reach about {reached[k]:.3g}"


def _halved(plant: Plant, k: int) -> Plant:
    """The plant with the range of one quantity halved round its middle."""
    slopes, rho = plant.slopes, plant.slopes.quantities[k]
    quarter = (rho.upper - rho.lower) * Exact(Fraction(1, 4))
    narrow = replace(rho, lower=rho.lower + quarter, upper=rho.upper - quarter)
    if not rho.is_entry:
        return replace(
            plant, slopes=replace(slopes, joint=tuple(narrow if one is rho else one for one in slopes.joint))
        )
    (i, j), rows = rho.entry, [[list(row) for row in side.rows] for side in (slopes.lower, slopes.upper)]
    rows[0][i][j], rows[1][i][j] = narrow.lower, narrow.upper
    lower, upper = (type(slopes.lower)(side) for side in rows)
    return replace(plant, slopes=replace(slopes, lower=lower, upper=upper))


def _distinct(eigenvalues: Any, indices: list[int], size: float) -> list[int]:
    kept: list[int] = []
    for b in indices:
        if all(abs(eigenvalues[b] - eigenvalues[c]) > 1e-6 * size for c in kept):
            kept.append(b)
    return kept


def _null_space(matrix: Any, size: float) -> Any:
    _, values, right = np.linalg.svd(matrix)
    return right[values <= 1e-7 * size].conj().T


def _rank(matrix: Any, size: float) -> int:
    return int(np.sum(np.linalg.svd(matrix, compute_uv=False) > 1e-9 * size))


def _complex(value: complex) -> str:
    return (
        f"{value.real:.6g}"
        if abs(value.imag) < 1e-9
        else f"{value.real:.6g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.6g}i"
    )
