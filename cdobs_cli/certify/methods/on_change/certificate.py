"""Practical stability of sensors that send on change: the error falls at a rate to a ball that the thresholds fix.

Between messages |C_i e| <= D_i = delta_i + vbar_i (`form`), and messages do not let V grow. Compared all the time,
V = e'P e with P > 0, mu, gamma >= 0 and

    P A_v + A_v'P + 2 sigma P - sum mu_i C_i'C_i + P E Gamma^-1 E'P < 0    at every corner of the slopes

obeys Vdot <= -2 sigma V + sum mu_i D_i^2 + sum gamma_k d0_k^2, whatever the events, so finally

    V <= L = (sum mu_i D_i^2 + sum gamma_k d0_k^2) / (2 sigma).

Each message takes a least amount from V
(`form.drop`), so there are finitely many in finite time, and every solution goes on for ever.

Compared every h, V = e'P(tau)e with tau the time since the last comparison, P a polynomial of pieces: the same of
Pdot + P A_v + .. on [0, h] without mu (proved coefficient by coefficient), messages at P(h), and where none is left to
send, P(h) + sum mu_i C_i'C_i - P(0) > 0. Just after comparisons V_(k+1) <= q V_k + G (1 - q) + sum mu_i D_i^2 with
q = exp(-2 sigma h) and G = sum gamma_k d0_k^2 / (2 sigma), so finally, and at all times between as G is not above it,

    V <= L = sum mu_i D_i^2 / (1 - q) + G.

For a state: with nu >= 0 and N(0) <= P(0) + sum nu_i C_i'C_i, e'N(0)e <= L + sum nu_i D_i^2 just after comparisons,
and at all times where outputs are compared all the time; N is constant then. With Ndot + N A_v + A_v'N +
N E Gamma_N^-1 E'N < 0 on [0, h], finally e_j^2 <= max (N(tau)^-1)_jj (L + sum nu_i D_i^2 + h sum gamma_N,k d0_k^2).

Source: cdobs, sensors that send on change
"""

from __future__ import annotations

from dataclasses import fields
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

from flint import arb

from cdobs_cli.certificate import Claim
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.certify.levels import Level
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.clock.certificate import is_small, largest_states
from cdobs_cli.certify.methods.clock.form import GraphShape, flow_coefficients, lyapunov
from cdobs_cli.certify.methods.of_state import UnderBounded
from cdobs_cli.certify.methods.on_change.form import Setting, drop, factors, flow_gap, silent_gap, weighted_outputs
from cdobs_cli.certify.methods.peak.state import number_of
from cdobs_cli.certify.texts import rate_of, rational, symmetric_from_upper
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import upper_text
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.certify.methods.on_change.search import Aim

_MOST_COEFFICIENTS = 64


@dataclass(frozen=True)
class SettledLevel(Level):
    """Level sets of a V that may rise to what it is finally: at most the larger of that and of `extra` above what it is
    at the start."""

    extra: arb
    settled: arb

    def largest(self, start: Any) -> arb:
        return (super().largest(start) + self.extra).max(self.settled).upper()


@dataclass(frozen=True)
class OnChange(Method):
    """sigma; degree d of P, elevated degree D of the inequalities and pieces (0, 0, 1 for a constant P); P: the upper
    triangles of its Bernstein coefficients; mu of the outputs, gamma of the disturbances that are not 0."""

    sigma: str
    shape: list[str]
    P: list[list[list[str]]]
    mu: list[str]
    gamma: list[str]

    name: ClassVar[str] = "on_change"
    rung: ClassVar[str] = "on_change"
    source: ClassVar[str] = "cdobs, sensors that send on change"
    how: ClassVar[str] = "exact pivots of LDL'"
    statement: ClassVar[str] = "e'Pe falls to a level that the thresholds fix, and does not grow at any message"

    @classmethod
    def takes_law(cls, law: SamplingLaw) -> bool:
        return law.is_on_change

    @classmethod
    def applies(cls, question: Question) -> bool:
        inclusion, plant = question.inclusion, question.plant
        linear = not inclusion.outputs and inclusion.assemble_noise is not None
        return question.law.is_on_change and linear and is_small(inclusion) and not plant.has_white

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The one of least weighted error at the question's rate at least."""
        from cdobs_cli.certify.methods.on_change.search import Aim, best_of_rates

        if not cls.applies(question):
            return None
        return best_of_rates(question, Aim.weighted(question), cls.of)

    @classmethod
    def of(cls, question: Question, data: dict[str, Any], aim: Aim) -> Self:
        """As a search found it."""
        return cls(question.law, **{one.name: data[one.name] for one in fields(cls) if one.name in data})

    @cached_property
    def coefficients(self) -> list[Matrix]:
        return [symmetric_from_upper(rows) for rows in self.P]

    @cached_property
    def pieces(self) -> GraphShape:
        d, D, pieces = map(int, self.shape)
        return GraphShape(d, D, ((pieces,),))

    @property
    def _ends(self) -> tuple[Matrix, Matrix]:
        """P just after a comparison, and just before the next."""
        return self.coefficients[0], self.coefficients[-1]

    def _prove(self, question: Question) -> Proof:
        return Proof.of(self._holds(question), rate_of(self.sigma))

    def _holds(self, question: Question) -> bool:
        if not self.applies(question) or not rate_of(self.sigma) > 0 or not self._is_well_posed(question.plant):
            return False
        setting = Setting.of(question)
        first, last = self._ends
        if len(self.gamma) != len(setting.d0) or factors(last, setting) is None:
            return False
        if not all(map(_positive, self.coefficients)):
            return False
        Q = weighted_outputs(setting.C, _diagonal(self.mu))
        if self.law.is_checked:
            falls = _positive(silent_gap(first, last, Q))
            return falls and self._flows(setting, self.coefficients, self.gamma, rate_of(self.sigma))
        sigma, Gamma, P = rate_of(self.sigma), _diagonal(self.gamma), first
        gaps = (flow_gap(lyapunov(P, A, sigma), Q, P @ setting.E, Gamma) for A in setting.corners)
        return all(map(_positive, gaps))

    def _is_well_posed(self, plant: Plant) -> bool:
        signs = all(rational(text) >= 0 for text in (*self.mu, *self.gamma))
        return signs and len(self.mu) == plant.p and self._fits(self.coefficients, plant)

    def _fits(self, coefficients: list[Matrix], plant: Plant) -> bool:
        """Whether these are the coefficients of one P."""
        shape = self.pieces
        if len(coefficients) != shape.count or any(one.shape != (plant.n,) * 2 for one in coefficients):
            return False
        if not self.law.is_checked:
            return tuple(self.shape) == ("0", "0", "1")
        return 1 <= shape.d <= shape.D and shape.pieces >= 1 and shape.count <= _MOST_COEFFICIENTS

    def _flows(self, setting: Setting, P: list[Matrix], gamma: list[str], sigma: Fraction) -> bool:
        """The inequality of the flow between comparisons, without the outputs."""
        Gamma, lengths = _diagonal(gamma), self.pieces.lengths([[0, self.law.T_max.scalar]])
        for slope, value in flow_coefficients(P, self.pieces, lengths):
            for A in setting.corners:
                S = slope + lyapunov(value, A, sigma)
                if not _positive(flow_gap(S, S * 0, value @ setting.E, Gamma * lengths[0])):
                    return False
        return True

    def final(self, question: Question) -> arb:
        """L: what V is at most finally."""
        setting, sigma = Setting.of(question), fraction_ball(rate_of(self.sigma))
        M, G = _weighted(self.mu, setting.reach), _weighted(self.gamma, setting.d0)
        if not self.law.is_checked:
            return (M + G) / (2 * sigma)
        q = (-2 * sigma * self.law.T_max.ball()).exp()
        return M / (1 - q) + G / (2 * sigma)

    def level(self, question: Question) -> Level | None:
        """V is at most the larger of L and of what it is at first, plus what a comparison may add."""
        if not self.prove(question).holds:
            return None
        question = question.under(self.law)
        reach = self._largest(self.coefficients, question.plant)
        if reach is None:
            return None
        extra = _weighted(self.mu, Setting.of(question).reach) if self.law.is_checked else arb(0)
        return SettledLevel((self._ends[1],), tuple(reach), extra, self.final(question))

    def _largest(self, P: list[Matrix], plant: Plant) -> list[arb] | None:
        """Upper ends of the (P^-1)_jj."""
        if not self.law.is_checked:
            inverse = P[0].inverse()
            return [arb(inverse[j, j]) for j in range(plant.n)]
        d = self.pieces.d
        return largest_states((P[k : k + d + 1] for k in self.pieces.firsts), Matrix.identity(plant.n), plant.n)

    def claims(self, question: Question, proof: Proof) -> list[Claim]:
        """With how often sensors send: from V <= L on, and to V >= 0, messages in a time t take no more than L and
        what Vdot <= sum mu_i D_i^2 + .. adds in t."""
        told = super().claims(question, proof)
        often = self._often(question.under(self.law)) if proof.holds else arb("nan")
        if not often.is_finite():
            return told
        what = (
            f"Messages are finitely many in finite time: in the long run at most {upper_text(often, 4)} per time unit"
        )
        if self.law.is_checked:
            what += " on average"
        how, statement = "least amount that a message takes from V", f"{what}, sampling {self.covers.words}."
        return [*told, Claim("messages", "certificate", "proved", statement, self.source, method=how)]

    def _often(self, question: Question) -> arb:
        """Messages per time in the long run, at most."""
        setting = Setting.of(question)
        of_V, CK = factors(self._ends[1], setting), setting.C @ setting.K
        assert of_V is not None
        least = arb.pos_inf()
        for i, factor in enumerate(of_V):
            least = least.min(_ball(factor) * _ball(drop(CK[i, i], setting.delta[i], setting.vbar[i])))
        M, G = _weighted(self.mu, setting.reach), _weighted(self.gamma, setting.d0)
        gained = M / self.law.T_max.ball() + G if self.law.is_checked else M + G
        return gained / least


@dataclass(frozen=True)
class OnChangePeak(UnderBounded, OnChange):
    """The same with N, which bounds the error of one state (its number): the upper triangles of its coefficients, nu of
    the outputs, gamma_N of the disturbances that are not 0."""

    nu: list[str]
    N: list[list[list[str]]]
    gamma_N: list[str]
    state: str

    name: ClassVar[str] = "on_change_peak"

    @classmethod
    def applies(cls, question: Question) -> bool:
        return question.start is None and super().applies(question)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound that is found for the error of the question's state."""
        from cdobs_cli.certify.methods.on_change.search import Aim, best_of_rates

        if question.state is None or not cls.applies(question):
            return None
        return best_of_rates(question, Aim.of_state(question.state), cls.of)

    @classmethod
    def of(cls, question: Question, data: dict[str, Any], aim: Aim) -> Self:
        return cls(question.law, **data, state=str(aim.state))

    @cached_property
    def enlarged(self) -> list[Matrix]:
        return [symmetric_from_upper(rows) for rows in self.N]

    def _prove(self, question: Question) -> Proof:
        j = number_of(self.state, question.plant)
        if not self._holds(question):
            return NOTHING
        setting, N = Setting.of(question), self.enlarged
        reach = self._largest(N, question.plant) if self._enlarges(setting, question.plant) else None
        if reach is None:
            return NOTHING
        most = self.final(question) + _weighted(self.nu, setting.reach)
        most += _weighted(self.gamma_N, setting.d0) * self.law.T_max.ball()
        error = (reach[j] * most).sqrt().upper()
        return Proof(True, fraction_ball(rate_of(self.sigma)), error=error) if error.is_finite() else NOTHING

    def _enlarges(self, setting: Setting, plant: Plant) -> bool:
        """What is asked of N and nu."""
        N, signs = self.enlarged, all(rational(text) >= 0 for text in (*self.nu, *self.gamma_N))
        if not signs or len(self.nu) != plant.p or len(self.gamma_N) != len(setting.d0) or not self._fits(N, plant):
            return False
        Q = weighted_outputs(setting.C, _diagonal(self.nu))
        if not all(map(_positive, N)) or not _positive(silent_gap(N[0], self.coefficients[0], Q)):
            return False
        return not self.law.is_checked or self._flows(setting, N, self.gamma_N, Fraction(0))

    def claims(self, question: Question, proof: Proof) -> list[Claim]:
        return Method.claims(self, question, proof)


def _positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def _diagonal(texts: list[str]) -> Matrix:
    values = [rational(text) for text in texts]
    return Matrix.diagonal(values) if values else Matrix.zeros(0, 0)


def _weighted(weights: list[str], sizes: tuple[Any, ...]) -> arb:
    """sum w_i s_i^2."""
    terms = (fraction_ball(rational(text)) * _ball(size) ** 2 for text, size in zip(weights, sizes, strict=True))
    return sum(terms, arb(0))


def _ball(value: Any) -> arb:
    return fraction_ball(value) if isinstance(value, Fraction) else arb(value)
