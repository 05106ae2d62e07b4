"""The conditions of Theorem 2' and of Theorem 2, proved one by one from a stored certificate. No solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, fmpq, fmpq_poly

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.ball import spectral_radius_upper
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.updated_sampling.domination import proves_ii
from cdobs_cli.families.updated_sampling.period import Timing
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    condition_8_lower,
    condition_8_upper,
    condition_9,
    condition_9_lower,
    condition_9_upper,
    lemma_4,
    lemma_5_N_1,
    lemma_5_N_2,
    one_step_map,
    theorem_2_a_1,
    theorem_2_a_2,
    theorem_2_a_2_least,
    theorem_2_prime_i,
)

_EPSILONS = (Fraction(1, 10), Fraction(1, 100), Fraction(1, 1000), Fraction(1, 10**4), Fraction(1, 10**5), Fraction(1, 10**7))


@dataclass(frozen=True)
class Numbers:
    """K (n, 1) and alpha, a_1, a_2, a_3 as they run: rationals where they are, else balls."""

    K: Matrix
    alpha: Any
    a_1: Any
    a_2: Any
    a_3: Any

    @staticmethod
    def of(gain: Mapping[str, ExactMatrix]) -> Numbers:
        """Raises: KeyError where the design holds no such gain."""
        return Numbers(gain["K"].balls(), *(_value(gain[name][0, 0]) for name in ("alpha", "a1", "a2", "a3")))

    @property
    def are_signed(self) -> bool:
        """alpha, a_1, a_2 > 0, a_3 >= 0 and a_1 alpha < 1: what (6)-(7) take for granted."""
        positive = all(arb(value) > 0 for value in (self.alpha, self.a_1, self.a_2))
        return bool(positive and arb(self.a_3) >= 0 and arb(self.a_1 * self.alpha) < 1)

    @property
    def timing(self) -> Timing:
        return Timing(*(arb(value) for value in (self.alpha, self.a_1, self.a_2, self.a_3)))


def _value(number: Exact) -> Any:
    rational = number.rational
    return number.ball() if rational is None else fmpq(rational.numerator, rational.denominator)


def _matrix(certificate: Certificate, n: int) -> Matrix | None:
    P = ExactMatrix(certificate.data["P"]).balls()
    return P if P.shape == (n, n) and P.T.data == P.data and has_positive_pivots(P.balls()) else None


@dataclass(frozen=True)
class PrimeProof:
    """Conditions of Theorem 2'. epsilon: V falls by (1 - epsilon) at each sample (None where (i) is not proved)."""

    positive: bool
    dilation: bool
    epsilon: Fraction | None
    domination: bool

    @property
    def holds(self) -> bool:
        return self.positive and self.dilation and self.epsilon is not None and self.domination


def prove_prime(numbers: Numbers, certificate: Certificate, variant: str) -> PrimeProof:
    """P > 0, P D + D P >= p_3 P > 0, (i) with some epsilon, (ii) with g = a_2 p_3."""
    n = numbers.K.shape[0]
    P = _matrix(certificate, n)
    p_3 = _value(Exact(certificate.data["p_3"]))
    if P is None:
        return PrimeProof(False, False, None, False)
    chain = Chain.exact(n)
    dilation = p_3 > 0 and has_positive_pivots(condition_9_lower(chain, P, p_3).balls())
    epsilon = None
    if numbers.are_signed:
        for trial in _EPSILONS:
            gap = theorem_2_prime_i(chain, P, numbers.K, numbers.alpha, numbers.a_1, fmpq(trial.numerator, trial.denominator))
            if has_positive_pivots(gap.balls()):
                epsilon = trial
                break
    domination = bool(dilation and proves_ii(P, numbers.alpha, numbers.a_2 * p_3, variant))
    return PrimeProof(True, bool(dilation), epsilon, domination)


@dataclass(frozen=True)
class PaperProof:
    """Conditions of Theorem 2. N_1, N_2: upper bounds at alpha; a_1_limit = 1 / (2 p_2 p_4); a_2_limit and
    a_2_printed: what step 3 needs and what the paper takes; alpha_m: (below, above), None where open."""

    condition_8: bool
    condition_9: bool
    dilation: bool
    a_1: bool
    lemma_4: bool
    a_2: bool
    a_3: bool
    a_1_limit: arb
    N_1: arb
    N_2: arb
    a_2_limit: arb
    a_2_printed: arb
    alpha_m: tuple[Fraction, Fraction | None] | None

    @property
    def holds(self) -> bool:
        return all((self.condition_8, self.condition_9, self.dilation, self.a_1, self.lemma_4, self.a_2, self.a_3))


def prove_theorem_2(numbers: Numbers, certificate: Certificate, weight: int) -> PaperProof | None:
    """(8), (9), a_1, (17) at alpha, N_1, N_2, a_2, a_3 = 2 w; None where the certificate holds no P > 0."""
    n = numbers.K.shape[0]
    P = _matrix(certificate, n)
    if P is None:
        return None
    chain = Chain.exact(n)
    p_1, p_2, p_3, p_4 = (_value(Exact(certificate.data[f"p_{k}"])) for k in range(1, 5))
    positive = all(arb(value) > 0 for value in (p_1, p_2, p_3, p_4))
    a_1_limit = theorem_2_a_1(p_2, p_4)
    small = numbers.are_signed
    J = chain.identity + (numbers.K @ chain.C) * numbers.alpha
    norm_Q, norm_J = spectral_norm(one_step_map(chain, numbers.K, numbers.alpha)), spectral_norm(J)
    shrink = 1 - arb(numbers.a_1 * numbers.alpha)
    scale, grown = shrink ** (2 * n), arb(numbers.alpha).exp()
    N_1 = lemma_5_N_1(norm_Q, norm_J, grown, arb(p_2), scale)
    N_2 = lemma_5_N_2(norm_J, grown, arb(p_2), scale)
    limit = theorem_2_a_2_least(weight, N_1, N_2, arb(p_1), arb(p_3), lambda x, y: x.max(y))
    return PaperProof(
        condition_8=positive
        and _definite(condition_8_lower(P, p_1, chain.identity))
        and _definite(condition_8_upper(P, p_2, chain.identity)),
        condition_9=_definite(condition_9(chain, P, P @ numbers.K)),
        dilation=positive and _definite(condition_9_lower(chain, P, p_3)) and _definite(condition_9_upper(chain, P, p_4)),
        a_1=bool(arb(numbers.a_1) <= arb(a_1_limit)),
        lemma_4=small and _definite(lemma_4(chain, P, numbers.K, numbers.alpha, numbers.a_1, p_2)),
        a_2=bool(arb(numbers.a_2) >= limit),
        a_3=bool(arb(numbers.a_3) >= 2 * weight),
        a_1_limit=arb(a_1_limit),
        N_1=N_1,
        N_2=N_2,
        a_2_limit=limit,
        a_2_printed=theorem_2_a_2(weight, N_1, N_2, arb(p_1), arb(p_3)),
        alpha_m=alpha_m(P, numbers.K, numbers.a_1, p_2) if positive and small else None,
    )  # fmt: skip


def _definite(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def spectral_norm(M: Matrix) -> arb:
    """|M|, bounded from above: the root of a bound of rho(M'M), scaled so that its powers stay near 1."""
    import numpy as np

    size = Fraction(float(np.linalg.norm(M.floats, 2)))
    return (spectral_radius_upper((M / size).T @ (M / size)).sqrt() * fraction_ball(size)).upper()


def alpha_m(P: Matrix, K: Matrix, a_1: Any, p_2: Any) -> tuple[Fraction, Fraction | None] | None:
    """(below, above): (17) holds on (0, below] and fails just past `above` (None: it holds up to 1 / a_1).

    M(alpha) = (1 - a_1 alpha)^(2n) times (17) is a polynomial matrix that vanishes at 0; det M / alpha^n is
    interpolated from exact values, and M / alpha is definite up to its first root. None where the data are not
    rational or M / alpha is not definite at 0+.
    """
    if not (P.is_rational and K.is_rational and isinstance(a_1, fmpq) and isinstance(p_2, fmpq)):
        return None
    n = P.shape[0]
    chain = Chain.exact(n)
    end = 1 / a_1
    degree = n * (4 * n - 1)

    def reduced(alpha: fmpq) -> Matrix:
        factor = 1 - a_1 * alpha
        gap: Matrix = lemma_4(chain, P, K, alpha, a_1, p_2)
        scaled: Matrix = gap * (factor ** (2 * n) / alpha)
        return scaled

    points = [end * k / (degree + 2) for k in range(1, degree + 2)]
    determinant = _interpolated(points, [reduced(alpha).data.det() for alpha in points])
    roots = []
    for root, _ in determinant.complex_roots():
        if root.imag.contains(0) and root.real.upper() > 0 and root.real.lower() < arb(end):
            roots.append(root.real)
    first = min(roots, key=lambda root: float(root.mid()), default=None)
    if first is None:
        return (_fraction(end), None) if has_positive_pivots(reduced(end / 2).balls()) else None
    room = arb(1) / 2**40
    low, high = first.lower() * (1 - room), first.upper() * (1 + room)
    if not low > 0:
        return None
    below, above = (_fraction(_dyadic(value)) for value in (low, high))
    if not has_positive_pivots(reduced(fmpq(below.numerator, below.denominator)).balls()):
        return None
    return below, above


def _dyadic(value: arb) -> fmpq:
    mantissa, exponent = value.mid().man_exp()
    return fmpq(int(mantissa)) * fmpq(2) ** int(exponent)


def _fraction(value: fmpq) -> Fraction:
    return Fraction(int(value.p), int(value.q))


def _interpolated(points: list[fmpq], values: list[fmpq]) -> fmpq_poly:
    """The polynomial through exact values, by divided differences."""
    table = list(values)
    for k in range(1, len(points)):
        for i in range(len(points) - 1, k - 1, -1):
            table[i] = (table[i] - table[i - 1]) / (points[i] - points[i - k])
    result = fmpq_poly([table[-1]])
    for point, value in zip(reversed(points[:-1]), reversed(table[:-1]), strict=True):
        result = result * fmpq_poly([-point, 1]) + fmpq_poly([value])
    return result
