"""The error of a linear loop from sample to sample, without what the jump erases.

edot = F e, e+ = J e. With J = X Y, X a basis of the range of J, the error just after a sample is e = X z and

    z+ = M(s) z,    M(s) = Y exp(F s) X,

s the time since the sample before. M(0) = Y X is J on its range. Where J keeps errors, M(0) has the eigenvalue
1 and a law from T_min = 0 needs coordinates in which that shows: M(0) = diag(I, j), z in ker(I - M(0)) and in
the range of I - M(0).
"""

from __future__ import annotations

from cdobs_cli.certify.ball import null_space
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class SampledError:
    """z+ = Y exp(F s) X z. Shapes: F (N, N), X (N, r), Y (r, N).

    kept: so many leading coordinates have M(0) = diag(I, j); None where M(0) was not taken apart.
    """

    F: Matrix
    X: Matrix
    Y: Matrix
    kept: int | None

    @property
    def size(self) -> int:
        """r = rank J."""
        return self.X.shape[1]


def sampled_error(maps: ErrorMaps[Matrix], from_zero: bool) -> SampledError | None:
    """The sampled error of a linear loop.

    None where T_min = 0 is asked for and M(0) cannot be taken apart: J irrational, or the eigenvalue 1 of J not
    semisimple.
    """
    F, J = maps.base, maps.jump
    if not J.is_rational:
        return None if from_zero else SampledError(F, Matrix.identity(J.shape[0]), J, None)
    X, Y = full_rank_factors(J)
    whole = SampledError(F, X, Y, None)
    if not from_zero or whole.size == 0:
        return whole
    parts = kept_and_lost(Y @ X)
    if parts is None:
        return None
    kept, S = parts
    return SampledError(F, X @ S, S.inverse() @ Y, kept)


def full_rank_factors(J: Matrix) -> tuple[Matrix, Matrix]:
    """X, Y of full rank with J = X Y, for a rational J: pivot columns, and the reduced rows."""
    reduced, rank = J.data.rref()
    N = J.shape[1]
    pivots = [next(j for j in range(N) if reduced[i, j] != 0) for i in range(rank)]
    if not pivots:
        return Matrix.zeros(N, 0), Matrix.zeros(0, N)
    return J[:, pivots], Matrix(reduced)[list(range(rank)), :]


def kept_and_lost(J: Matrix) -> tuple[int, Matrix] | None:
    """(k, S) with S^-1 J S = diag(I, j), I of size k, and 1 no eigenvalue of j; for a rational J.

    Columns of S: ker(I - J), then the range of I - J. None where they overlap (1 is not semisimple).
    """
    identity = Matrix.identity(J.shape[0])
    kept = null_space(identity - J)
    lost, _ = full_rank_factors(identity - J)
    columns = [*(kept.T.tolist() if kept is not None else []), *lost.T.tolist()]
    S = Matrix.from_rows(columns).T
    if S.data.det() == 0:
        return None
    return (kept.shape[1] if kept is not None else 0), S
