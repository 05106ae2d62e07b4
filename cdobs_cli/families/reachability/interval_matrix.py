"""Interval matrices and the few members that decide a quadratic inequality over all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.certify.kernel import is_zero
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Signs = tuple[tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True)
class IntervalMatrix:
    """{Mc + E : |E_ij| <= Rad_ij}, both (n, n), Rad >= 0 (entries that do not vary have Rad_ij = 0 exactly)."""

    center: Matrix
    radius: Matrix

    @staticmethod
    def between(lower: Sequence[Sequence[arb]], upper: Sequence[Sequence[arb]]) -> IntervalMatrix:
        """From the ends; an entry whose ends are one and the same object does not vary."""
        center = [
            [low if low is high else (low + high) / 2 for low, high in zip(*rows, strict=True)]
            for rows in zip(lower, upper, strict=True)
        ]
        radius = [
            [0 if low is high else (high - low) / 2 for low, high in zip(*rows, strict=True)]
            for rows in zip(lower, upper, strict=True)
        ]
        return IntervalMatrix(Matrix.from_rows(center), Matrix.from_rows(radius))

    @property
    def lower(self) -> Matrix:
        return self.center - self.radius

    @property
    def upper(self) -> Matrix:
        return self.center + self.radius

    @cached_property
    def floats(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Center and radius as arrays."""
        return self.center.floats, self.radius.floats

    def contains(self, other: IntervalMatrix) -> bool:
        """Whether every member of `other` is certainly a member."""
        inner, outer = (other.lower.balls(), other.upper.balls()), (self.lower.balls(), self.upper.balls())
        size = range(self.center.shape[0])
        return all(
            bool(outer[0][i, j] <= inner[0][i, j]) and bool(inner[1][i, j] <= outer[1][i, j])
            for i in size
            for j in size
        )

    def signs(self, active: Sequence[int]) -> Iterator[Signs]:
        """The sign vectors (eps, sigma) of the members that matter for vectors supported on the states `active`.

        For a given x, M x runs over Mc x + diag(eps) Rad |x| with |eps_i| <= 1, and a convex function of M x
        is largest at eps in {-1, 1}^n; |x| = diag(sigma) x. (eps, sigma) and (-eps, -sigma) give the same
        member, and the sign of a row or column without radius does not matter: 2^(rows + columns - 1) members.

        Source: Dinh2014, (31)
        Deviates: the paper takes the 2^(n^2) corners of the box.
        """
        n = self.center.shape[0]
        varies = [[not is_zero(self.radius[i, j]) for j in range(n)] for i in range(n)]
        columns = [j for j in active if any(varies[i][j] for i in range(n))]
        rows = [i for i in range(n) if any(varies[i][j] for j in columns)]
        for free in product((1, -1), repeat=max(0, len(columns) - 1)):
            sigma = [1] * n
            for j, sign in zip(columns[1:], free, strict=True):
                sigma[j] = sign
            for chosen in product((1, -1), repeat=len(rows)):
                eps = [1] * n
                for i, sign in zip(rows, chosen, strict=True):
                    eps[i] = sign
                yield tuple(eps), tuple(sigma)

    def member(self, signs: Signs) -> Matrix:
        """Mc + diag(eps) Rad diag(sigma)."""
        eps, sigma = signs
        n = len(eps)
        flipped = [[self.radius[i, j] * (eps[i] * sigma[j]) for j in range(n)] for i in range(n)]
        return self.center + Matrix.from_rows(flipped)

    def members(self, signs: Sequence[Signs]) -> NDArray[np.float64]:
        """All the members at once as floats, shape (len(signs), n, n)."""
        import numpy as np

        center, radius = self.floats
        eps = np.array([pair[0] for pair in signs], dtype=float)
        sigma = np.array([pair[1] for pair in signs], dtype=float)
        with np.errstate(over="ignore", invalid="ignore"):
            members: NDArray[np.float64] = center + eps[:, :, None] * radius * sigma[:, None, :]
        return members
