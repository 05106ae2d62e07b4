"""Theorem 2': (17) with any eps and the exact domination of the slopes, proved from P and p_3."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import ClassVar

from flint import arb, fmpq

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, lower_text, upper_text
from cdobs_cli.families.updated_sampling.domination import largest_growth, proves_ii
from cdobs_cli.families.updated_sampling.prime_search import Found, PrimeSearch, best_p_3, longest_period
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
from cdobs_cli.families.updated_sampling.theorems import Chain, condition_9_lower, is_definite, theorem_2_prime_i
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_SLOPES = {"triangular": "lower triangular G with |G_ij| <= 1", "last_row": "|Delta| <= c |e| in the last row"}
_EPSILONS = tuple(Fraction(1, 10**k) for k in (1, 2, 3, 4, 5, 7))


@dataclass(frozen=True)
class Theorem2Prime(Theorem):
    """P > 0, P D + D P >= p_3 P > 0, (i) with some eps, (ii) with g = a_2 p_3."""

    p_3: str

    name: ClassVar[str] = "theorem_2_prime"
    rung: ClassVar[str] = "theorem_2_prime"
    source: ClassVar[str] = "Andrieu2014, Theorem 2 with (17) and (3)"
    how: ClassVar[str] = "pivots of LDL' in balls"
    wanted: ClassVar[str] = "Some P meets (i) with this K, alpha and a_1, and P D + D P > 0"
    missing: ClassVar[str] = "no P was found that meets the conditions of Theorem 2'"

    @classmethod
    def _rounded(cls, law: SamplingLaw, found: Found) -> Theorem2Prime:
        return cls(law, symmetric_texts(found.P), down(found.p_3 * (1 - 1e-6), 8))

    @classmethod
    def guess(cls, question: Question) -> Theorem2Prime | None:
        """P of the least a_2 for the question's gain."""
        K, (alpha, a_1) = question.gain("K").floats, (float(question.gain(name)[0, 0]) for name in ("alpha", "a1"))
        found = best_p_3(PrimeSearch(len(K), question.card.variant, K), alpha, a_1 * alpha, EVALUATIONS[question.level])
        return None if found is None else cls._rounded(question.law, found)

    @classmethod
    def designs(cls, question: Question, c: float) -> Iterator[tuple[Gain, Theorem2Prime]]:
        card, n = question.card, question.plant.n
        search = PrimeSearch(n, card.variant)
        evaluations = EVALUATIONS[question.level] // (2 if n > 4 else 1)
        found = longest_period(search, c, evaluations, None if card.alpha is None else float(card.alpha))
        if found is None:
            return
        alpha = card.alpha or Exact(decimal_text(found.alpha, 4))
        for attempt in range(6):
            # Rounding costs a little room: a_1 a little smaller, a_2 a little larger, until the proof goes through.
            slack = 1 + 5e-4 * 4**attempt
            again = search.least_growth(float(alpha), found.a_1_alpha / slack, found.p_3 * (1 - 1e-4))
            if again is not None:
                a_1, a_2 = down(again.a_1_alpha / float(alpha), 4), up(again.a_2 * slack, 5)
                gain = gain_of(ExactMatrix.from_floats(again.K, 6), alpha, a_1, a_2, "0")
                yield gain, cls._rounded(question.law, again)

    def _prove(self, question: Question) -> Conditions:
        numbers, variant, n = Numbers.of(question.inclusion.gain), question.card.variant, question.plant.n
        chain, P, p_3 = Chain.exact(n), self.matrix(n), Exact(self.p_3).scalar
        if P is None or not (p_3 > 0 and is_definite(condition_9_lower(chain, P, p_3))):
            text = f"P > 0 and P D + D P >= p_3 P > 0 with p_3 = {self.p_3}"
            return Conditions.all_of(self.condition("P", False, text, self.source))

        def meets_i(epsilon: Fraction) -> bool:
            shrink = fmpq(epsilon.numerator, epsilon.denominator)
            return is_definite(theorem_2_prime_i(chain, P, numbers.K, numbers.alpha, numbers.a_1, shrink))

        epsilon = next(filter(meets_i, _EPSILONS if numbers.is_signed else ()), None)
        falls, margin = "", None
        if epsilon is not None:
            falls = f": V = E'PE falls by a factor 1 - {float(epsilon):g} at each sample at least"
            margin = lower_text(fraction_ball(epsilon), 6)
        dominates = proves_ii(P, numbers.alpha, numbers.a_2 * p_3, variant)
        rate = f"V grows at most at the rate a_2 p_3 c = {lower_text(arb(numbers.a_2) * arb(p_3), 6)} c"
        need = "" if dominates else f"; with this P, a_2 = {self._least_a_2(numbers, variant)} or more is needed"
        text = f"(ii) of Theorem 2' holds: between samples {rate}, for {_SLOPES[variant]}{need}"
        positive = f"P > 0 and P D + D P >= p_3 P with p_3 = {self.p_3}"
        pieces = "Bernstein coefficients over halved pieces"
        falling = f"(i) of Theorem 2' holds{falls}"
        return Conditions.all_of(
            self.condition("P", True, positive, self.source),
            self.condition("i", epsilon is not None, falling, self.source, margin=margin, method=self.how),
            self.condition("ii", dominates, text, self.source, method=f"{pieces} of [0, alpha]"),
        )

    def _least_a_2(self, numbers: Numbers, variant: str) -> str:
        """g / p_3 in floats: what to try where (ii) is not proved."""
        g = largest_growth(ExactMatrix(self.P).floats, float(arb(numbers.alpha).mid()), variant)
        return upper_text(arb(g / float(self.p_3)), 4)
