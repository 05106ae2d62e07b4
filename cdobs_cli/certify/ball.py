"""Enclosures: the spectral radius of a matrix in balls, and roots of continuous functions.

Nothing here trusts a float: floats choose where to look, balls decide.
"""

from __future__ import annotations

from typing import Any

from flint import acb, acb_mat, arb

from cdobs_cli.exact.matrix import Matrix

_DOUBLINGS = 24


def is_finite(M: Matrix) -> bool:
    """Whether every entry is a bounded ball."""
    return all(value.is_finite() for row in M.balls().tolist() for value in row)


def frobenius(M: Matrix) -> arb:
    """The Frobenius norm, enclosed: an upper bound of the spectral norm."""
    total = arb(0)
    for row in M.balls().tolist():
        for value in row:
            total += value * value
    return total.sqrt() if total > 0 else total.abs_upper().sqrt()


def eigenvalues(M: Matrix) -> list[acb] | None:
    """Enclosures of all eigenvalues with multiplicity; None where the enclosure method gives up."""
    if not is_finite(M):
        return None
    flat = [acb(value) for row in M.balls().tolist() for value in row]
    size = M.shape[0]
    try:
        return list(acb_mat(size, size, flat).eig(multiple=True))
    except (ValueError, ZeroDivisionError):
        return None


def determinant(M: Matrix) -> Any:
    """det M: a rational for rational M, a ball otherwise."""
    return M.data.det()


def spectral_radius_lower(M: Matrix) -> arb:
    """A number that is certainly not above rho(M) (0 where nothing better is known).

    The largest of the least moduli of the eigenvalue enclosures, |det M|^(1/n) and |trace M| / n.
    """
    if not is_finite(M):
        return arb(0)
    size = M.shape[0]
    best = arb(0)
    bounds = [arb(M.trace()).abs_lower() / size]
    modulus = arb(determinant(M)).abs_lower()
    if modulus > 0:
        bounds.append(modulus.root(size).lower())
    bounds.extend(value.abs_lower() for value in eigenvalues(M) or ())
    for bound in bounds:
        if bound.is_finite() and bound > best:
            best = bound.lower()
    return best


def has_spectral_radius_at_least(M: Matrix, radius: Any = 1) -> bool:
    """Whether rho(M) >= radius > 0 is proved.

    With p(s) = det(s I - M): a real eigenvalue >= radius exists if p(radius) <= 0, one <= -radius if
    (-1)^n p(-radius) <= 0 (p is monic, so both change sign further out); for pairs, the eigenvalue
    enclosures; |det M| >= radius^n and |trace M| >= n radius always suffice. Exact for rational M.
    """
    if not is_finite(M):
        return False
    size = M.shape[0]
    identity = Matrix.identity(size)
    sign = -1 if size % 2 else 1
    if arb(determinant(identity * radius - M)) <= 0:
        return True
    if arb(determinant(identity * radius + M)) <= 0:  # det(r I + M) = (-1)^n p(-r)
        return True
    if arb(determinant(M)) * sign >= arb(radius) ** size or arb(determinant(M)) * -sign >= arb(radius) ** size:
        return True
    return bool(spectral_radius_lower(M) >= arb(radius))


def has_eigenvalue_beyond(M: Matrix) -> bool:
    """Whether a real eigenvalue >= 1 is proved by the sign of det(I - M), exactly 0 too: of a map that keeps a cone, as
    that of a mean square, the spectral radius is an eigenvalue."""
    return is_finite(M) and bool(arb(determinant(Matrix.identity(M.shape[0]) - M)) <= 0)


def has_spectral_radius_below(M: Matrix, radius: Any = 1) -> bool:
    """Whether rho(M) < radius is proved: |(M / radius)^(2^k)| < 1 for some k, in balls."""
    if not is_finite(M):
        return False
    power = M.balls() / radius
    for _ in range(_DOUBLINGS):
        norm = frobenius(power)
        if not norm.is_finite() or norm > 1e100:
            return False
        if norm < 1:
            return True
        power = power @ power
    return False


def spectral_radius_upper(M: Matrix) -> arb:
    """A number that is certainly not below rho(M): the least |M^(2^k)|^(1/2^k) met."""
    if not is_finite(M):
        return arb("inf")
    power, exponent = M.balls(), 1
    best = frobenius(power).upper()
    for _ in range(_DOUBLINGS):
        power, exponent = power @ power, 2 * exponent
        if not is_finite(power):
            break
        norm = frobenius(power).upper()
        bound = norm.root(exponent).upper() if norm > 0 else arb(0)
        if bound < best:
            best = bound
        if norm < 1e-60 or norm > 1e60:
            break
    return best


def is_hurwitz(M: Matrix) -> bool:
    """Whether every eigenvalue of a rational M has a negative real part: Routh's array, exactly.

    Raises: ValueError for a matrix of balls.
    """
    if not M.is_rational:
        raise ValueError("an exact answer needs rational entries")
    size = M.shape[0]
    coefficients = [M.data.charpoly()[size - k] for k in range(size + 1)]  # from s^n down
    above, row = coefficients[0::2], coefficients[1::2]
    for _ in range(size):
        if not row or not row[0] > 0:
            return False
        factor = above[0] / row[0]
        below = [above[k + 1] - factor * (row[k + 1] if k + 1 < len(row) else 0) for k in range(len(above) - 1)]
        above, row = row, below
    return True


def null_space(M: Matrix) -> Matrix | None:
    """A rational basis of the null space, as columns; None where it is trivial."""
    reduced, rank = M.data.rref()
    n = M.shape[1]
    pivots = [next(j for j in range(n) if reduced[i, j] != 0) for i in range(rank)]
    free = [j for j in range(n) if j not in pivots]
    if not free:
        return None
    columns = [[-reduced[pivots.index(j), f] if j in pivots else int(j == f) for f in free] for j in range(n)]
    return Matrix.from_rows(columns)
