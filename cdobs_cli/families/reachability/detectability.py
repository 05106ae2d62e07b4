"""Why no gain can be expected: a constant slope for which the sampled pair is not detectable."""

from __future__ import annotations

from itertools import islice, product
from typing import Any

from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

TOLERANCE = 1e-9
MAX_CORNERS = 256


def undetectable(plant: Plant) -> str | None:
    """A sentence that names slopes V with (exp((A + V) delta), C) not detectable, as far as floats can tell.

    An eigenvalue of modulus at least 1 whose eigenvector C does not see is not moved by any K; with constant V
    in the class, no gain converges. The test is Hautus': [lambda I - exp((A + V) delta); C] loses rank. Tried at
    the middle and the corners of the slope box, at the longest period of the law.
    """
    import numpy as np

    view = PlantView.floats(plant, {})
    delta = float(plant.sampling.T_max)
    middle = tuple((low + high) / 2 for low, high in zip(view.lower, view.upper, strict=True))
    corners = product(*zip(view.lower, view.upper, strict=True))
    for v in (middle, *islice(corners, MAX_CORNERS)):
        flow = view.flow(v)
        if not np.all(np.isfinite(flow)):
            return None
        eigenvalues = np.linalg.eigvals(flow)
        if np.max(eigenvalues.real) * delta > 300:
            continue
        sampled = np.exp(eigenvalues * delta)
        size = max(1.0, float(np.linalg.norm(flow, 2)))
        for a in range(len(flow)):
            if abs(sampled[a]) < 1 - TOLERANCE:
                continue
            # The sampled eigenspace joins the eigenspaces of every flow eigenvalue that samples to the same.
            same = [
                b for b in range(len(flow)) if abs(sampled[b] - sampled[a]) <= TOLERANCE * max(1.0, abs(sampled[a]))
            ]
            space = [
                _null_space(flow - eigenvalues[b] * np.eye(len(flow)), size) for b in _distinct(eigenvalues, same, size)
            ]
            basis = np.concatenate(space, axis=1)
            seen = view.C @ basis
            if basis.shape[1] and _rank(seen, float(np.linalg.norm(view.C, 2)) or 1.0) < basis.shape[1]:
                where = ", ".join(
                    f"{rho.text(plant.states)} = {value:g}" for value, rho in zip(v, view.quantities, strict=True)
                )
                return (
                    f"(exp((A + V) delta), C) is not detectable at delta = {delta:g}"
                    f"{' with ' + where if where else ''}: "
                    f"no output sees the eigenvalue {_complex(complex(sampled[a]))}"
                )
    return None


def _distinct(eigenvalues: Any, indices: list[int], size: float) -> list[int]:
    kept: list[int] = []
    for b in indices:
        if all(abs(eigenvalues[b] - eigenvalues[c]) > 1e-6 * size for c in kept):
            kept.append(b)
    return kept


def _null_space(matrix: Any, size: float) -> Any:
    import numpy as np

    _, values, right = np.linalg.svd(matrix)
    return right[values <= 1e-7 * size].conj().T


def _rank(matrix: Any, size: float) -> int:
    import numpy as np

    return int(np.sum(np.linalg.svd(matrix, compute_uv=False) > 1e-9 * size))


def _complex(value: complex) -> str:
    return (
        f"{value.real:.6g}"
        if abs(value.imag) < 1e-9
        else f"{value.real:.6g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.6g}i"
    )
