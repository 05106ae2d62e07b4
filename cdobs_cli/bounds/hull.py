"""Functions of the same variables trace a curve: its hull in a parallelogram, where that is much smaller than the box.

For rho_1, .., rho_m of one variable set (1/v and 1/v^2, an Arrhenius factor and its derivative) the class

    rho_k - sum_(j < k) b_kj rho_j in [low_k, high_k]

is cut by the edges of the box in rho_1 and by pairs of parallel facets, chord and tangent of the curve. For any b the
functions on the left are as good as the rho_k: Dphi = A_0 + sum rho_k A_k holds with them, exactly, once b_kj A_k is
added to A_j. The b are guessed by least squares over points of the domain; what is claimed is what is proved later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression, Number
from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.exact.rational import TooLargeError, simplify
from cdobs_cli.plant import Entry, Plant
from cdobs_cli.records import dataclass

_POINTS = 400
_LARGEST_PART = 0.5  # of its range that may be left of a function for the parallelogram to pay
_DIGITS = 3


@dataclass(frozen=True)
class Shared:
    """A function of several entries, and its exact weights there."""

    function: Expression
    weights: tuple[tuple[Entry, Fraction], ...]


def within_parallelograms(functions: Sequence[Shared], plant: Plant) -> list[Shared]:
    """Functions that span the same slopes, of smaller ranges over the plant's domain where some follow others."""
    kept: list[Shared] = list(functions)
    for members in _of_same_variables(functions):
        values = _values([functions[k].function for k in members], plant)
        if values is None:
            continue
        for position, k in enumerate(members[1:], start=1):
            before = members[:position]
            fit = _fit(values[:, :position], values[:, position])
            rest = _without(kept[k].function, [kept[j].function for j in before], fit) if any(fit) else None
            if rest is None:
                continue
            values[:, position] -= values[:, :position] @ np.array([float(b) for b in fit])
            for b, j in zip(fit, before, strict=True):
                kept[j] = Shared(kept[j].function, _added(kept[j].weights, kept[k].weights, b))
            kept[k] = Shared(rest, kept[k].weights)
    return kept


def _of_same_variables(functions: Sequence[Shared]) -> Iterator[list[int]]:
    groups: dict[frozenset[str], list[int]] = {}
    for k, one in enumerate(functions):
        groups.setdefault(frozenset(one.function.variables), []).append(k)
    yield from (members for members in groups.values() if len(members) > 1)


def _values(functions: list[Expression], plant: Plant) -> Array | None:
    """The functions at points spread over the domain and the inputs' ranges, shape (points, functions); None where
    these are unbounded, or a value is not finite."""
    names = sorted({name for one in functions for name in one.variables})
    ends = plant.domain.box | {one.name: one.range for one in plant.inputs if one.range is not None}
    boxes = [ends.get(name) for name in names]
    sides = [(box.lower, box.upper) for box in boxes if box is not None]
    finite = [(float(low), float(high)) for low, high in sides if low is not None and high is not None]
    if len(finite) < len(names):
        return None
    compiled = compile_floats(functions, names, arrays=True)
    index = np.arange(_POINTS)
    # Additive recurrence by powers of the root of x^(d + 1) = x + 1: evenly spread in any dimension.
    root = 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (len(names) + 1))
    columns = [
        low + (high - low) * ((0.5 + index / root ** (k + 1)) % 1.0) for k, (low, high) in enumerate(finite)
    ]  # fmt: skip
    with np.errstate(all="ignore"):
        values = np.array([np.broadcast_to(value, (_POINTS,)) for value in compiled(*columns)], dtype=float).T
    return values if np.all(np.isfinite(values)) else None


def _fit(others: Array, values: Array) -> list[Fraction]:
    """Coefficients b, short decimals, with which values - others b varies much less than the values; zeros where there
    are none."""
    none = [Fraction(0)] * others.shape[1]
    spread = np.ptp(values)
    sizes = np.ptp(others, axis=0)
    if not spread > 0 or not np.all(sizes > 0):
        return none
    centred = (others - others.mean(axis=0)) / sizes
    b = np.linalg.lstsq(centred, values - values.mean(), rcond=1e-6)[0] / sizes
    short = [Fraction(decimal_text(float(one), _DIGITS)) if np.isfinite(one) else Fraction(0) for one in b]
    left = values - others @ np.array([float(one) for one in short])
    return short if np.ptp(left) <= _LARGEST_PART * spread else none


def _without(function: Expression, others: list[Expression], fit: list[Fraction]) -> Expression | None:
    """function - sum b_j others_j; None where that becomes too large."""
    for b, other in zip(fit, others, strict=True):
        function = function - Number(b) * other
    try:
        return simplify(function)
    except TooLargeError:
        return None


def _added(
    weights: tuple[tuple[Entry, Fraction], ...], more: tuple[tuple[Entry, Fraction], ...], b: Fraction
) -> tuple[tuple[Entry, Fraction], ...]:
    total = dict(weights)
    for entry, weight in more:
        total[entry] = total.get(entry, Fraction(0)) + b * weight
    return tuple((entry, weight) for entry, weight in sorted(total.items()) if weight)
