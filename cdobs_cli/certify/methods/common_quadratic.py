"""Linear loops under an interval of periods: one form of degree 2 d in the error falls from sample to sample.

The error just after a sample obeys z+ = M(s) z (`sampled_error`). If P > 0 and

    G(s) = P - exp(2 d sigma s) M^[d](s)' P M^[d](s) > 0    for every s in [T_min, T_max],

M^[d] the map of the monomials z^[d] of degree d (`symmetric_power`), then V = z^[d]' P z^[d], a form of degree 2 d,
falls at every sample whatever the periods, by a factor below exp(-2 d sigma s), so |z| decays at rate sigma at
least. Between samples e = exp(F s) X z with s <= T_max: |e| is bounded by a constant times |z| and decays with it.
d = 1 is the common quadratic function; larger d are less conservative.

The interval is cut until the Bernstein coefficients of each piece, Taylor polynomials in s with their rest
enclosed, are positive definite. From T_min = 0, where M^[d](0) = diag(I, j) and P = diag(P_1, Q) alike,

    G(0) = diag(0, H),    H = Q - j'Qj > 0:

coefficient 0 of the first piece [0, b] is >= 0, exactly so, and the others are > 0. As 1 - (1 - u)^K >= u that gives
G(s) >= epsilon s P: V falls in proportion to the time between samples. Where samples of a constant period are lost,
s is one of finitely many, and G > 0 at each of them is enough.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np
from flint import arb, arb_poly

from cdobs_cli.certify import search
from cdobs_cli.certify.cover import covered, ends_of, law_ends
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.linear import is_linear_loop
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.sampled_error import SampledError, sampled_error
from cdobs_cli.certify.symmetric_power import dimension, monomials, power
from cdobs_cli.certify.taylor import ORDER, Taylor, bernstein_weights, entries, exponential
from cdobs_cli.certify.texts import rate_of, symmetric_from_upper, upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import fraction_text
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

T_ = TypeVar("T_")

_DIGITS = 17
_DEGREES = (3, 4, 6, 8)  # largest d, by effort
_LARGEST = (10, 15, 21, 36)  # most monomials, by effort
_GRID, _FINE, _ROUNDS = 10, 96, 6


@dataclass(frozen=True)
class CommonQuadratic(Method):
    """sigma; degree d; P: the upper triangle, each row from the diagonal on."""

    sigma: str
    degree: str
    P: list[list[str]]

    name: ClassVar[str] = "common_quadratic"
    rung: ClassVar[str] = "clock"
    source: ClassVar[str] = "form of the sampled error that falls at every sample"
    how: ClassVar[str] = "Bernstein coefficients in balls"
    statement: ClassVar[str] = "One form of the error just after a sample falls from each sample to the next"

    @classmethod
    def applies(cls, question: Question) -> bool:
        """No uncertain slope, an interval of periods."""
        return is_linear_loop(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least degree first."""
        error = sampled_loop(question)
        if error is None:
            return None
        periods, maps = _maps(error, question.law, float(question.rate))
        # A constant period of the law at which the error does not decay: no form can fall.
        if not np.all(np.isfinite(maps)) or not np.all(spectral_radii(maps) < 1):
            return None
        for degree in range(1, _DEGREES[question.level] + 1):
            if degree > 1 and dimension(error.size, degree) > _LARGEST[question.level]:
                return None
            P = _Search(periods, maps, error.kept, degree).run()
            if P is None:
                continue
            form = cls(question.law, fraction_text(question.rate), str(degree), upper_texts(P, _DIGITS))
            if form.prove(question).holds:
                return form
        return None

    def _prove(self, question: Question) -> Proof:
        sigma, degree = rate_of(self.sigma), int(self.degree)
        error = sampled_loop(question)
        if not 1 <= degree <= max(_DEGREES) or error is None:
            return NOTHING
        P = symmetric_from_upper(self.P)
        if dimension(error.size, degree) != P.shape[0] or P.shape[0] > max(_LARGEST) or not has_positive_pivots(P):
            return NOTHING
        form = _Form(error, degree, sigma, P)
        if error.kept is not None and not form.falls_at_zero():
            return NOTHING
        if self.law.multiples:
            return Proof.of(all(form.falls(*ends_of(T)) for T in self.law.multiples), sigma)
        return Proof.of(covered(form.falls, *law_ends(self.law)), sigma)


def sampled_loop(question: Question) -> SampledError | None:
    """The sampled error of a linear loop under an interval of periods; None for any other question."""
    if not is_linear_loop(question) or not 0 <= float(question.law.T_min) < float(question.law.T_max) < 1e12:
        return None
    error = sampled_error(question.inclusion.balls, question.law.from_zero)
    return None if error is None or error.size == 0 else error


def longest_aperiodic(propose: Callable[[Question], T_ | None], question: Question) -> T_ | None:
    """The longest law [T_min, T]: laws grow with T, so the walk keeps T_min."""
    law, width = question.law, search.tolerance(question.effort, quick=True)
    return search.longest(
        lambda T: propose(question.at(T)), law.period, width, floor=0.0 if law.is_lossy else float(law.T_min)
    )


def fall(P: Any, M: Any) -> Any:
    """G = P - M' P M."""
    return P - M.T @ P @ M


class _Form:
    """V of degree 2 d with its P, and the pieces of the inequality."""

    def __init__(self, error: SampledError, degree: int, sigma: Fraction, P: Matrix) -> None:
        self.error, self.degree, self.P = error, degree, P
        self.F = error.F + Matrix.identity(error.F.shape[0]) * sigma  # of e exp(sigma t)
        kept = error.kept or 0
        names = monomials(error.size, degree, kept)
        self.first = [k for k, name in enumerate(names) if name[-1] < kept]
        self.lost = [k for k in range(len(names)) if k not in self.first]
        self.S = _rounding_basis(P, self.first, self.lost)

    def falls_at_zero(self) -> bool:
        """G(0) = diag(0, H) with H > 0, exactly so; P = diag(P_1, Q) follows, as 1 is no eigenvalue of j."""
        M_0 = Matrix.from_rows(power((self.error.Y @ self.error.X).tolist(), self.degree, self.error.kept or 0))
        gap = fall(self.P, M_0)
        if any(gap[i, j] != 0 for i in self.first for j in range(gap.shape[0])):
            return False
        return not self.lost or has_positive_pivots(gap[self.lost, self.lost])

    def falls(self, a: Fraction, b: Fraction) -> bool:
        """Whether G > 0 on [a, b]; on [0, b] in proportion to s."""
        coefficients = exponential(self.error.Y, self.F, self.error.X, a, b)
        if coefficients is None:
            return False
        G = self._fall(power(entries(coefficients), self.degree, self.error.kept or 0))
        size = self.P.shape[0]
        first = 1 if a == 0 and self.error.kept is not None else 0
        for weights in bernstein_weights(ORDER)[first:]:
            rows: list[list[Any]] = [[arb(0)] * size for _ in range(size)]
            for i in range(size):
                for j in range(i + 1):
                    rows[i][j] = rows[j][i] = G[i][j].combination(weights)
            if not has_positive_pivots(Matrix.from_rows(rows)):
                return False
        return True

    def _fall(self, M: list[list[Taylor]]) -> list[list[Taylor]]:
        """S'(P - M' P M) S, in coordinates in which P is close to I: balls are sharpest there."""
        P, S = self.P.balls(), self.S.balls()
        size = len(M)
        PS = (S.T @ P @ S).balls()
        # N = S^-1 M S as polynomials: P in the new coordinates is PS.
        left, right = self.S.inverse().balls().arb.table(), S.arb.table()
        half = [[_weighted(left[i], [M[k][j] for k in range(size)]) for j in range(size)] for i in range(size)]
        N = [[_weighted([right[k][j] for k in range(size)], half[i]) for j in range(size)] for i in range(size)]
        table = PS.arb.table()
        PN = [[_weighted(table[i], [N[k][j] for k in range(size)]) for j in range(size)] for i in range(size)]
        G: list[list[Taylor]] = [[N[0][0]] * size for _ in range(size)]
        for i in range(size):
            for j in range(i + 1):
                product = N[0][i] * PN[0][j]
                for k in range(1, size):
                    product = product + N[k][i] * PN[k][j]
                G[i][j] = G[j][i] = _constant(table[i][j]) - product
        return G


def _weighted(weights: list[arb], terms: list[Taylor]) -> Taylor:
    total: Taylor = terms[0] * weights[0]
    for weight, term in zip(weights[1:], terms[1:], strict=True):
        if not weight.is_zero():
            total = total + term * weight
    return total


def _constant(value: arb) -> Taylor:
    return Taylor(arb_poly([value]))


def _rounding_basis(P: Matrix, first: list[int], lost: list[int]) -> Matrix:
    """A rational S, diagonal by blocks, with S' P S close to I."""
    return Matrix.from_floats(_unit_basis(P.floats, [part for part in (first, lost) if part]))


def _unit_basis(P: Array, blocks: list[list[int]]) -> Array:
    """S, diagonal by blocks, with S' P S = I there; the identity where floats do not find P positive."""
    S = np.eye(len(P))
    try:
        for part in blocks:
            S[np.ix_(part, part)] = np.linalg.inv(np.linalg.cholesky(P[np.ix_(part, part)])).T
    except np.linalg.LinAlgError:
        return np.eye(len(P))
    return S if np.all(np.isfinite(S)) and np.linalg.cond(S) < 1e12 else np.eye(len(P))


# The search: floats and the solver propose, `prove` decides.


def _maps(error: SampledError, law: SamplingLaw, sigma: float) -> tuple[Array, Array]:
    """Periods of the law, denser at both ends where the inequality is tight as a rule, and M there."""
    low, high = float(law.T_min), float(law.T_max)
    periods = low + (high - low) * (1 - np.cos(np.pi * np.arange(_FINE + 1) / _FINE)) / 2
    periods[0] = low if low > 0 else 1e-5 * high
    if law.multiples:
        periods = np.array([float(T) for T in law.multiples])
    F, X, Y = (matrix.floats for matrix in (error.F, error.X, error.Y))
    with np.errstate(all="ignore"):
        maps: Array = Y @ exponentials((F + sigma * np.eye(len(F))) * periods[:, None, None]) @ X
    return periods, maps


class _Search:
    """P of largest margin in floats: the inequality at some periods, and at those of a fine grid that it violates."""

    def __init__(self, periods: Array, maps: Array, kept: int | None, degree: int) -> None:
        r = maps.shape[-1]
        entries = [[maps[:, i, j] for j in range(r)] for i in range(r)]
        self.maps = np.array(power(entries, degree, kept or 0)).transpose(2, 0, 1)
        self.size = self.maps.shape[-1]
        names = monomials(r, degree, kept or 0)
        first = [k for k, name in enumerate(names) if name[-1] < (kept or 0)]
        self.blocks = [part for part in (first, [k for k in range(self.size) if k not in first]) if part]
        # From T_min = 0 the inequality is of the size of s on what the jump keeps.
        self.weights = np.ones((len(periods), self.size))
        if kept:
            self.weights[:, first] = np.sqrt(periods[-1] / periods)[:, None]

    def run(self) -> Array | None:
        S = self._scale()
        inverse = np.linalg.inv(S)
        maps = inverse @ self.maps @ S
        if not np.all(np.isfinite(maps)):
            return None
        chosen = list(dict.fromkeys(int(k) for k in np.linspace(0, len(maps) - 1, _GRID)))
        for _ in range(_ROUNDS):
            P = self._solve(maps, chosen)
            if P is None:
                return None
            gaps = (P - maps.transpose(0, 2, 1) @ P @ maps) * self.weights[:, :, None] * self.weights[:, None, :]
            margins = np.linalg.eigvalsh(gaps)[:, 0]
            if margins.min() > 0:
                found: Array = inverse.T @ P @ inverse
                return found
            padded = np.concatenate([[np.inf], margins, [np.inf]])
            valleys = np.flatnonzero((margins <= 0) & (margins <= padded[:-2]) & (margins <= padded[2:]))
            worst = [int(k) for k in valleys if k not in chosen]
            if not worst:
                return None
            chosen += worst
        return None

    def _scale(self) -> Array:
        """Coordinates in which a Lyapunov function of one period is the identity, block by block."""
        total, step = np.eye(self.size), self.maps[len(self.maps) // 2]
        with np.errstate(all="ignore"):
            for _ in range(40):  # the sum of M'^k M^k, by doubling
                total = total + step.T @ total @ step
                step = step @ step
                if not np.all(np.isfinite(total)) or np.linalg.norm(step) < 1e-9:
                    break
        return _unit_basis(total, self.blocks) if np.all(np.isfinite(total)) else np.eye(self.size)

    def _solve(self, maps: Array, chosen: list[int]) -> Array | None:
        from cdobs_cli.certify.lmi import Program, full
        from cdobs_cli.certify.lmi import symmetric as symmetric_unknown

        program = Program(
            {**{f"P{b}": symmetric_unknown(len(part)) for b, part in enumerate(self.blocks)}, "t": full(1, 1)}
        )
        identity = np.eye(self.size)

        def P_of(x: Any) -> Array:
            P = np.zeros((self.size, self.size))
            for b, part in enumerate(self.blocks):
                P[np.ix_(part, part)] = x[f"P{b}"]
            return P

        def at(k: int) -> Callable[[Any], Array]:
            M, W = maps[k], np.outer(self.weights[k], self.weights[k])
            return lambda x: fall(P_of(x), M) * W - identity * x["t"]

        for k in chosen:
            program.require(at(k))
        program.require(lambda x: P_of(x) - identity * x["t"])
        program.equate(lambda x: np.atleast_2d(np.trace(P_of(x)) - self.size))
        program.maximise(lambda x: x["t"])
        found = program.solve(tolerance=1e-9, iterations=100).values
        if not float(found["t"][0, 0]) > 0 or not all(np.all(np.isfinite(value)) for value in found.values()):
            return None
        return P_of(found)
