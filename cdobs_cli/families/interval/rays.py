"""Extreme rays of a polyhedral cone inside the orthant, in exact rationals: the double description method."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

Ray = tuple[Fraction, ...]

MOST_RAYS = 400


def extreme_rays(rows: Sequence[Sequence[Fraction]], size: int) -> tuple[Ray, ...] | None:
    """Vectors with nonnegative combinations K = {e >= 0 : h e >= 0 for every row h}, each of sum 1.

    Starts from the unit vectors and cuts by one row at a time: rays on its good side stay, and every two
    adjacent rays that it separates meet it in a new one. None where there are more than `MOST_RAYS`.

    Source: Motzkin, Raiffa, Thompson, Thrall, The double description method (1953)
    """
    unit = [tuple(Fraction(int(i == j)) for j in range(size)) for i in range(size)]
    rays: list[Ray] = list(unit)
    faces: list[Ray] = list(unit)
    for row in rows:
        heights = [product(row, ray) for ray in rays]
        on = [frozenset(k for k, face in enumerate(faces) if product(face, ray) == 0) for ray in rays]
        kept = [ray for ray, height in zip(rays, heights, strict=True) if height >= 0]
        for i, above in enumerate(heights):
            for j, below in enumerate(heights):
                if above > 0 > below and _are_adjacent(on, i, j):
                    kept.append(_scaled([above * b - below * a for a, b in zip(rays[i], rays[j], strict=True)]))
        rays = list(dict.fromkeys(kept))
        faces.append(tuple(row))
        if len(rays) > MOST_RAYS:
            return None
    return tuple(rays)


def product(one: Sequence[Fraction], other: Sequence[Fraction]) -> Fraction:
    """The scalar product."""
    return sum((a * b for a, b in zip(one, other, strict=True)), Fraction(0))


def _are_adjacent(on: Sequence[frozenset[int]], i: int, j: int) -> bool:
    """Whether no third ray lies on every face that both rays lie on."""
    common = on[i] & on[j]
    return not any(k not in (i, j) and common <= faces for k, faces in enumerate(on))


def _scaled(ray: Sequence[Fraction]) -> Ray:
    total = sum(ray, Fraction(0))
    return tuple(value / total for value in ray)
