"""Theorem 1 of Boukal2020 put to the test with given (P, Y): each printed condition, and the largest tau_max
that meets them all."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from typing import Any

from flint import arb, fmpq

from cdobs_cli.certificate import Bound, Claim, Status, Witness
from cdobs_cli.certify.definite import Range, eigenvalue_range, positive_definite
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text, upper_text
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.records import dataclass

SOURCE = "Boukal2020, Theorem 1"
_DOUBLINGS = 40


@dataclass(frozen=True)
class Printed:
    """(P, Y), the first entry of L, and the vertices at which (26) is asked for. Shapes: P, vertices (n, n);
    Y (n, 1); C (1, n)."""

    P: Matrix
    Y: Matrix
    L_1: Any
    C: Matrix
    vertices: tuple[Matrix, ...]

    @staticmethod
    def of(
        P: ExactMatrix, Y: ExactMatrix, L: ExactMatrix | None, C: Matrix, vertices: Sequence[Matrix]
    ) -> Printed | None:
        """The printed data; L_1 from the printed gain, else from P^-1 Y. None where P is not proved regular."""
        ball_P, ball_Y = P.balls(), Y.balls()
        try:
            L_1 = ball_P.solve(ball_Y)[0, 0] if L is None else L.balls()[0, 0]
        except ZeroDivisionError:
            return None
        return Printed(ball_P, ball_Y, L_1, C, tuple(vertices))

    @property
    def n(self) -> int:
        return self.P.shape[0]

    def lmi_26(self, tau_max: Any, delta: Any, mu: Any, A_i: Matrix) -> Any:
        """The left side of (26) at one vertex."""
        R = Matrix.from_rows([[int(j == 1) for j in range(self.n)]])
        return theorems.lmi_26(self.P, self.Y, A_i, self.C, R, tau_max, delta, mu, Matrix.identity(self.n))

    def mu(self, tau_max: Any, delta: Any) -> Range:
        """The largest mu with (26) at every vertex, enclosed (negative where (26) fails for every mu > 0)."""
        ranges = [eigenvalue_range(-self.lmi_26(tau_max, delta, 0, A_i), smallest=True) for A_i in self.vertices]
        return Range(reduce(arb.min, [arb(r.low) for r in ranges]), reduce(arb.min, [arb(r.high) for r in ranges]))

    def lambda_min(self) -> Range:
        return eigenvalue_range(self.P, smallest=True)

    def lambda_max(self) -> Range:
        return eigenvalue_range(self.P, smallest=False)


@dataclass(frozen=True)
class Numbers:
    """What Theorem 1 and Remark 2 compute at one tau_max, each between proved ends.

    delta is the least with beta < alpha_2, delta_2 the least with tau_max < T_2 (both a little more); mu, alpha_2
    and T_2 are at delta, mu_2 at delta_2; alpha_1 and T_1 at mu_at_1, which is the most they can be.
    """

    tau_max: Any
    delta: Any
    mu_at_1: Range
    mu: Range
    beta: Range
    alpha_1: Range
    alpha_2: Any
    T_1_squared: Range
    T_2_squared: Range
    delta_2: Any
    mu_2: Range

    def document(self) -> dict[str, list[str]]:
        """Both ends of each number as decimal strings."""
        ranges = {
            "delta": Range(self.delta, self.delta), "mu_at_delta_1": self.mu_at_1, "mu": self.mu, "beta": self.beta,
            "alpha_1": self.alpha_1, "alpha_2": Range(self.alpha_2, self.alpha_2),
            "T_1": _root(self.T_1_squared), "T_2": _root(self.T_2_squared),
        }  # fmt: skip
        return {name: [lower_text(arb(r.low)), upper_text(arb(r.high))] for name, r in ranges.items()}


def _root(square: Range) -> Range:
    """The square root of a range, 0 where the square is not positive."""
    low, high = arb(square.low), arb(square.high)
    return Range(low.sqrt() if low > 0 else arb(0), high.sqrt() if high > 0 else arb(0))


def evaluate(printed: Printed, tau_max: Any) -> Numbers:
    """All numbers of Theorem 1 at one tau_max.

    delta is free in the paper. alpha_2 > beta asks for delta > 1 + beta / (2 tau_max), and mu, with it
    alpha_1, falls as delta grows: so the least such delta decides. mu_at_1 bounds mu for every delta > 1.
    """
    low, high = printed.lambda_min(), printed.lambda_max()
    L_1 = printed.L_1
    beta = Range(theorems.theorem_1_beta(tau_max, high.low, L_1), theorems.theorem_1_beta(tau_max, high.high, L_1))
    delta = _just_above(1 + beta.high / (2 * tau_max))
    delta_2 = _just_above(1 + theorems.theorem_1_beta(tau_max, high.high, L_1) / 2)
    at_1, mu = printed.mu(tau_max, 1), printed.mu(tau_max, delta)
    return Numbers(
        tau_max,
        delta,
        at_1,
        mu,
        beta,
        Range(theorems.theorem_1_alpha_1(at_1.low, low.low), theorems.theorem_1_alpha_1(at_1.high, low.high)),
        theorems.theorem_1_alpha_2(tau_max, delta),
        Range(
            theorems.remark_2_T_1_squared(at_1.low, low.low, high.high, L_1),
            theorems.remark_2_T_1_squared(at_1.high, low.high, high.low, L_1),
        ),
        Range(
            theorems.remark_2_T_2_squared(delta, high.high, L_1), theorems.remark_2_T_2_squared(delta, high.low, L_1)
        ),
        delta_2,
        printed.mu(tau_max, delta_2),
    )


def _just_above(value: Any) -> Any:
    """A little more: what holds for every delta above the value is put to the test there."""
    return value + (value - 1) * fmpq(1, 10**6) + fmpq(1, 10**12)


def side_conditions(printed: Printed, tau_max: Any) -> Status:
    """beta < min(alpha_1, alpha_2) with (26), for some delta > 1 and mu > 0.

    Proved with the delta of `evaluate`. Refuted for every delta and mu: beta < alpha_2 asks for
    delta > 1 + beta / (2 tau_max), and there mu lambda_min(P) <= beta already.
    """
    numbers = evaluate(printed, tau_max)
    low = printed.lambda_min()
    if arb(low.low) > 0 and arb(theorems.theorem_1_alpha_1(numbers.mu.low, low.low)) > arb(numbers.beta.high):
        return "proved"
    least_delta = 1 + numbers.beta.low / (2 * tau_max)
    mu_most = printed.mu(tau_max, least_delta).high
    refuted = arb(low.high) <= 0 or arb(mu_most) <= 0 or arb(mu_most * low.high) <= arb(numbers.beta.low)
    return "refuted" if refuted else "undecided"


def tau_max_bound(printed: Printed) -> Bound:
    """The largest tau_max at which the printed conditions hold for these (P, Y): a bracket.

    beta grows and mu falls with tau_max, so the conditions hold on an interval from 0.
    """

    def status(value: Fraction) -> Status:
        return side_conditions(printed, fmpq(value.numerator, value.denominator))

    proved: Fraction | None = None
    refuted: Fraction | None = None
    value = Fraction(1)
    for _ in range(_DOUBLINGS):
        found = status(value)
        if found == "proved":
            proved, value = value, value * 4
        elif found == "refuted":
            refuted, value = value, value / 4
        else:
            break
        if proved is not None and refuted is not None:
            break
    while proved is not None and refuted is not None and refuted - proved > refuted / 10**6:
        middle = (proved + refuted) / 2
        found = status(middle)
        if found == "undecided":
            break
        proved, refuted = (middle, refuted) if found == "proved" else (proved, middle)
    return Bound(
        lower_text(fraction_ball(proved), 9) if proved is not None else None,
        upper_text(fraction_ball(refuted), 9) if refuted is not None else None,
        method="theorem_1",
        about="the printed conditions for these (P, Y); their proof has a gap, so this is not a bound of stability",
    )


def claims(printed: Printed, tau_max: Exact, prefix: str, where: str) -> list[Claim]:
    """Each printed condition as a claim of its own. `where` names the vertices in the sentences."""
    tau = tau_max.scalar
    numbers = evaluate(printed, tau)
    data = numbers.document()
    made = []

    def claim(name: str, status: Status, statement: str, source: str, margin: str | None = None) -> None:
        witness = Witness("vector", "class", data={"numbers": data}) if status == "refuted" else None
        made.append(
            Claim(
                f"{prefix}.{name}",
                "printed",
                status,
                statement,
                source,
                margin=margin,
                method="theorem_1",
                witness=witness,
            )
        )

    P = positive_definite(printed.P)
    negative: Status = "refuted" if arb(printed.lambda_min().high) <= 0 else "undecided"
    claim(
        "P",
        "proved" if P.proved else negative,
        "P > 0",
        SOURCE,
        lower_text(arb(printed.lambda_min().low)) if P.proved else None,
    )
    mu_low, mu_high = arb(numbers.mu_at_1.low), arb(numbers.mu_at_1.high)
    status: Status = "proved" if mu_low > 0 else "refuted" if mu_high <= 0 else "undecided"
    claim(
        "lmi_26", status,
        f"(26) holds {where} for some mu > 0, delta > 1: mu up to {data['mu_at_delta_1'][0]} as delta falls to "
        f"1", f"{SOURCE}, (26)",
        data["mu_at_delta_1"][0] if status == "proved" else data["mu_at_delta_1"][1],
    )  # fmt: skip
    claim(
        "side_conditions", side_conditions(printed, tau),
        f"beta < min(alpha_1, alpha_2) for some delta > 1: beta = {data['beta'][0]}, alpha_1 = mu lambda_min(P) "
        f"<= {data['alpha_1'][1]}",
        SOURCE, upper_text(arb(numbers.alpha_1.high) - arb(numbers.beta.low), 9),
    )  # fmt: skip
    square = arb(tau * tau)
    status = (
        "refuted"
        if square >= arb(numbers.T_1_squared.high)
        else "proved"
        if square < arb(numbers.T_1_squared.low)
        else "undecided"
    )
    claim("T_1", status, f"tau_max < T_1, which is at most {data['T_1'][1]}", "Boukal2020, Remark 2, (39)")
    # T_2 grows with delta and mu falls: at the least delta with tau_max < T_2, (26) must still leave a mu > 0.
    mu_2, least = numbers.mu_2, 1 + numbers.beta.low / 2
    status = "proved" if arb(mu_2.low) > 0 else "refuted" if arb(printed.mu(tau, least).high) <= 0 else "undecided"
    claim(
        "T_2", status, f"tau_max < T_2 for some delta that (26) allows: from delta = "
        f"{upper_text(arb(numbers.delta_2), 7)} on",
        "Boukal2020, Remark 2, (40)", lower_text(arb(mu_2.low), 7) if status == "proved" else None,
    )  # fmt: skip
    return made
