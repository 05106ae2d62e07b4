"""Theorem 2 as the paper has it, proved from P and p_1 .. p_4 of (8)-(9)."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from flint import arb, fmpq, fmpq_poly

from cdobs_cli.arrays import Array
from cdobs_cli.certify.ball import spectral_radius_upper
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, arb_fraction, fmpq_fraction, lower_text, upper_text
from cdobs_cli.families.updated_sampling import paper_search
from cdobs_cli.families.updated_sampling.theorem import (
    EVALUATIONS,
    Conditions,
    Gain,
    Numbers,
    Theorem,
    down,
    gain_of,
    symmetric_texts,
    up,
)
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    condition_8,
    condition_9,
    condition_9_lower,
    condition_9_upper,
    is_definite,
    lemma_4,
    lemma_5,
    one_step_map,
    theorem_2_a_1,
    theorem_2_a_2,
    theorem_2_a_2_least,
)
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw


def weight(variant: str, n: int) -> int:
    """a_3 / 2: n in the triangular form, 1 for the last row.

    Source: Andrieu2014; Andrieu2013
    """
    return n if variant == "triangular" else 1


@dataclass(frozen=True)
class Theorem2(Theorem):
    """(8), (9), a_1, (17) at alpha, N_1, N_2, a_2, a_3 = 2 w."""

    p_1: str
    p_2: str
    p_3: str
    p_4: str

    name: ClassVar[str] = "theorem_2"
    rung: ClassVar[str] = "theorem_2"
    source: ClassVar[str] = "Andrieu2014, Theorem 2"
    how: ClassVar[str] = "pivots of LDL' in balls"
    wanted: ClassVar[str] = "Some P meets (8)-(9) with this K"
    missing: ClassVar[str] = "no P, K and alpha were found that meet the conditions of Theorem 2"

    @classmethod
    def _rounded(cls, law: SamplingLaw, P: Array) -> Theorem2:
        texts = symmetric_texts(P)
        p_1, p_2, p_3, p_4 = paper_search.numbers(ExactMatrix(texts).floats)
        return cls(law, texts, down(p_1, 8), up(p_2, 8), down(p_3, 8), up(p_4, 8))

    @classmethod
    def guess(cls, question: Question) -> Theorem2 | None:
        """P of the least a_2 for the question's gain."""
        K, (alpha, a_1) = question.gain("K").floats, (float(question.gain(name)[0, 0]) for name in ("alpha", "a1"))
        n, w = len(K), weight(question.card.variant, len(K))
        tried = (paper_search.matrices(n, p_1, p_3, 4.0 * n, K) for p_1 in (0.01, 0.05, 0.2) for p_3 in (0.2, 0.8))
        best = min(
            (met[0] for met in tried if met is not None),
            key=lambda P: paper_search.a_2_at(P, K, paper_search.numbers(P), alpha, a_1, w), default=None,
        )  # fmt: skip
        return None if best is None else cls._rounded(question.law, best)

    @classmethod
    def designs(cls, question: Question, c: float) -> Iterator[tuple[Gain, Theorem2]]:
        card, n = question.card, question.plant.n
        w, alpha = weight(card.variant, n), None if card.alpha is None else float(card.alpha)
        found = paper_search.longest_period(n, w, c, EVALUATIONS[question.level], alpha)
        if found is not None:
            P, K, exact_alpha = found[0], ExactMatrix.from_floats(found[1], 6), card.alpha or Exact(down(found[2], 4))
            theorem = cls._rounded(question.law, P)
            a_1 = down(float(theorem_2_a_1(Fraction(theorem.p_2), Fraction(theorem.p_4))) * (1 - 1e-9), 6)
            p = tuple(float(value) for value in (theorem.p_1, theorem.p_2, theorem.p_3, theorem.p_4))
            a_2 = paper_search.a_2_at(P, K.floats, p, float(exact_alpha), float(a_1), w)
            yield gain_of(K, exact_alpha, a_1, up(a_2 * (1 + 1e-4), 5), str(2 * w)), theorem

    def _prove(self, question: Question) -> Conditions:
        numbers, n = Numbers.of(question.inclusion.gain), question.plant.n
        P, w = self.matrix(n), weight(question.card.variant, n)
        if P is None:
            return Conditions(False)
        K, alpha, a_1, chain = numbers.K, numbers.alpha, numbers.a_1, Chain.exact(n)
        p_1, p_2, p_3, p_4 = (Exact(text).scalar for text in (self.p_1, self.p_2, self.p_3, self.p_4))
        positive = all(p > 0 for p in (p_1, p_2, p_3, p_4))
        a_1_limit = arb(theorem_2_a_1(p_2, p_4))
        norm_Q, norm_J = map(spectral_norm, (one_step_map(chain, K, alpha), chain.identity + (K @ chain.C) * alpha))
        N_1, N_2 = lemma_5(norm_Q, norm_J, arb(alpha).exp(), arb(p_2), (1 - arb(a_1 * alpha)) ** (2 * n))
        a_2_limit = theorem_2_a_2_least(w, N_1, N_2, arb(p_1), arb(p_3), lambda x, y: x.max(y))
        a_2_printed = theorem_2_a_2(w, N_1, N_2, arb(p_1), arb(p_3))
        dilates = positive and is_definite(condition_9_lower(chain, P, p_3), condition_9_upper(chain, P, p_4))
        reach = _reach(alpha_m(P, K, a_1, p_2) if positive and numbers.is_signed else None)
        sizes = f"{upper_text(a_2_limit, 6)} (N_1 <= {upper_text(N_1, 6)}, N_2 <= {upper_text(N_2, 6)})"
        powers = f"p_3 P <= P D + D P <= p_4 P with p_3 = {self.p_3}, p_4 = {self.p_4}"
        conditions = (
            ("8", positive and is_definite(*condition_8(P, p_1, p_2, chain.identity)),
             f"p_1 I <= P <= p_2 I with p_1 = {self.p_1}, p_2 = {self.p_2}", "Andrieu2014, (8)"),
            ("9", dilates and is_definite(condition_9(chain, P, P @ K)),
             f"(A + K C)'P + P (A + K C) <= -I and {powers}", "Andrieu2014, (9)"),
            ("a_1", arb(a_1) <= a_1_limit, f"a_1 is at most 1 / (2 p_2 p_4), which is {lower_text(a_1_limit, 8)}",
             self.source),
            ("alpha_m", numbers.is_signed and is_definite(lemma_4(chain, P, K, alpha, a_1, p_2)),
             f"(17) holds at alpha; {reach}", "Andrieu2014, Lemma 4, (17)"),
            ("a_2", arb(numbers.a_2) >= a_2_limit,
             f"a_2 is at least what step 3 of the proof needs, {sizes}; the paper takes {upper_text(a_2_printed, 6)}",
             f"{self.source}, step 3"),
            ("a_3", arb(numbers.a_3) >= 2 * w, f"a_3 is at least {2 * w}", f"{self.source}, step 3"),
        )  # fmt: skip
        return Conditions.all_of(*(self.condition(*one) for one in conditions))


def _reach(found: tuple[Fraction, Fraction | None] | None) -> str:
    if found is None:
        return "alpha_m could not be enclosed"
    low, high = found
    if high is None:
        return "it holds up to 1 / a_1"
    return f"alpha_m is in [{lower_text(fraction_ball(low), 9)}, {upper_text(fraction_ball(high), 9)}]"


def spectral_norm(M: Matrix) -> arb:
    """|M|, bounded from above: the root of a bound of rho(M'M), scaled so that its powers stay near 1."""
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
    n, end = P.shape[0], 1 / a_1
    chain, degree = Chain.exact(n), n * (4 * n - 1)

    def reduced(alpha: fmpq) -> Matrix:
        gap: Matrix = lemma_4(chain, P, K, alpha, a_1, p_2)
        scaled: Matrix = gap * ((1 - a_1 * alpha) ** (2 * n) / alpha)
        return scaled

    points = [end * k / (degree + 2) for k in range(1, degree + 2)]
    determinant = _interpolated(points, [reduced(alpha).data.det() for alpha in points])
    roots = [
        root.real for root, _ in determinant.complex_roots()
        if root.imag.contains(0) and root.real.upper() > 0 and root.real.lower() < arb(end)
    ]  # fmt: skip
    first = min(roots, key=lambda root: float(root.mid()), default=None)
    if first is None:
        return (fmpq_fraction(end), None) if is_definite(reduced(end / 2)) else None
    room = arb(1) / 2**40
    low, high = first.lower() * (1 - room), first.upper() * (1 + room)
    if not low > 0:
        return None
    below, above = (arb_fraction(value.mid()) for value in (low, high))
    return (below, above) if is_definite(reduced(fmpq(below.numerator, below.denominator))) else None


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
