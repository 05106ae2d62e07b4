"""How large errors stay under noise and disturbance, of sensors with periods of their own.

With a certificate over a timed graph at a rate sigma > 0, V = e'P_q(tau)e, s = sqrt(V): between samples a disturbance
adds at most sqrt(d'P d) to ds/dt + sigma s <= 0, and the noise of an edge into r at most kappa = max
sqrt((K v)'P_r(0)(K v)). What noise comes to just after a sample is at most any x of the nodes with

    x_r >= exp(-sigma tau) x_q + kappa    of every edge from q to r, tau the least that its guard holds:

s - x only shrinks where it is above 0. In the long run, and at all times from e = 0,

    s <= max sqrt(d'P d) / sigma + max_r x_r,    |e_j| <= sqrt((P^-1)_jj) s.

White noise and disturbances, independent of what was before, add tr(P Q) to dE V/dt + 2 sigma E V <= 0 and
tr(K'P_r(0)K R) at a sample: E V has the same bound with 2 sigma. Errors of bounded and of white signals add (the error
system is linear under each V(t)): roots of mean squares do.

Source: cdobs, error bounds
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from flint import arb

from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import NOTHING, Proof, Question
from cdobs_cli.certify.methods.clock.certificate import is_small, largest_states
from cdobs_cli.certify.methods.clock.graph import ClockGraph, shapes, unit
from cdobs_cli.certify.methods.mean_square.signals import bounded_floats, noise_floats
from cdobs_cli.certify.methods.of_state import OfState, UnderBounded, UnderWhite
from cdobs_cli.certify.methods.peak.signals import acting, acting_sizes
from cdobs_cli.certify.methods.peak.state import number_of
from cdobs_cli.certify.methods.response import error_sizes
from cdobs_cli.certify.texts import rate_of, upper_texts
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.methods.clock.graph_aim import GraphAim

_PARTS = (0.2, 0.4, 0.65)  # of the fastest rate
_WIDTH = Fraction(1, 20)
_P_DIGITS = 12
_MOST_VERTICES = 2**10
_POLICIES, _SLACK = 200, 1e-9


@dataclass(frozen=True)
class GraphSize(OfState, ClockGraph):
    """A certificate over a timed graph at a rate above 0, and the state (its number) whose error it bounds."""

    state: str

    @classmethod
    def applies(cls, question: Question) -> bool:
        inclusion = question.inclusion
        known = question.law.has_sensors and inclusion.assemble_noise is not None and is_small(inclusion)
        return known and question.start is None and cls.is_about(question.plant)

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """The least bound found for the error of the question's state, of a few rates, where its response to signals
        leaves much open. The memory keeps the fastest."""
        if question.state is None or not cls.applies(question):
            return None
        if question.law.is_multirate:
            response = error_sizes(question.inclusion)
            if response is not None and response.are_close:
                return None
        proposals = (cls._at(question.with_rate(sigma)) for sigma in _rates(question))
        proved = [(one, one.prove(question).error) for one in proposals if one is not None]
        known = [(one, error) for one, error in proved if error is not None]
        return min(known, key=lambda pair: float(pair[1]), default=(None,))[0]

    @classmethod
    def error_guess(cls, question: Question) -> float | None:
        """Of the rate in the middle of those that `propose` tries."""
        if question.state is None or not cls.applies(question):
            return None
        if question.law.is_multirate:
            response = error_sizes(question.inclusion)
            if response is not None and response.are_close:
                return None
        question = question.afresh()  # the fastest rate is one gain's
        rates = _rates(question)
        one = cls._at(question.with_rate(rates[len(rates) // 2])) if rates else None
        error = None if one is None else one.prove(question).error
        return None if error is None else float(error)

    @classmethod
    def _at(cls, question: Question) -> Self | None:
        """Of the first shape that gives one at the question's rate."""
        from cdobs_cli.certify.methods.clock.graph_aim import aimed

        aim = _aim(question)
        for shape in list(shapes(question))[-2:]:
            posed = aimed(question, shape, aim, given=True)
            solution = None if posed is None else posed.solve(question)
            if posed is None or solution is None:
                continue
            texts = [[fraction_text(value) for value in row] for row in posed.S]
            P, pieces = (
                [upper_texts(P, _P_DIGITS) for P in solution.P],
                [list(map(str, one)) for one in shape.pieces_of],
            )
            rate = fraction_text(question.rate)
            one = cls(question.law, str(shape.d), str(shape.D), pieces, rate, texts, P, str(question.state))
            if one.prove(question).holds:
                return one
        return None

    def _prove(self, question: Question) -> Proof:
        sigma, i = rate_of(self.sigma), number_of(self.state, question.plant)
        if not self.applies(question) or not sigma > 0 or not super()._prove(question).holds:
            return NOTHING
        reach = largest_states(self._pieces(self.coefficients), self.S, question.plant.n)
        s = None if reach is None else self._largest(question, sigma)
        if reach is None or s is None:
            return NOTHING
        error = (reach[i].sqrt() * s).upper()
        return Proof(True, error=error) if error.is_finite() else NOTHING

    def _largest(self, question: Question, sigma: Fraction) -> arb | None:
        """An upper end of the root of (the mean of) V in the long run; None where there are too many vertices."""
        plant, back, P = question.plant, self.S.inverse(), self.coefficients
        noise = question.inclusion.phases_noise_balls
        kicks = [back @ one.kick for one in noise]
        drive = back @ noise[0].drive
        graph = self.law.graph
        ends = [P[self.shape.starts[graph.into(q).target]] for q in range(len(kicks))]
        d, v = _vertices(plant.disturbance, drive), [_vertices(plant.noise, G) for G in kicks]
        if d is None or any(one is None for one in v):
            return None
        by_disturbance = _most(arb((x.T @ one @ x)[0, 0]) for one in P for x in d).sqrt()
        kappa = [_most(arb((x.T @ P_0 @ x)[0, 0]) for x in own or ()).sqrt() for P_0, own in zip(ends, v, strict=True)]
        bounded = by_disturbance / fraction_ball(sigma) + self._summed(kappa, sigma)
        Q = None if plant.intensity is None else drive @ plant.intensity.balls() @ drive.T
        drift = arb(0) if Q is None else _most(_trace(one @ Q) for one in P) / fraction_ball(2 * sigma)
        R = None if plant.covariance is None else plant.covariance.balls()
        jumps = [arb(0) if R is None else _trace(G.T @ P_0 @ G @ R) for P_0, G in zip(ends, kicks, strict=True)]
        return bounded + (drift + self._summed(jumps, 2 * sigma)).max(arb(0)).sqrt()

    def _summed(self, jumps: list[arb], rate: Fraction) -> arb:
        """Just after the worst sample: what readings that add so much, all of it decaying at this rate, come to."""
        graph, base, rho = self.law.graph, self.law.base.ball(), fraction_ball(rate)
        decay = {low: (-rho * base * fraction_ball(low)).exp() for low in {edge.low for edge in graph.edges}}
        added = [arb(0) if edge.reading is None else jumps[edge.reading] for edge in graph.edges]
        links = [(edge.source, edge.target, float(decay[edge.low])) for edge in graph.edges]
        x = [Exact(value).ball() for value in sums(len(graph.nodes), links, list(map(float, added)))]
        most = _most(iter(x))
        for edge, kappa in zip(graph.edges, added, strict=True):
            if not x[edge.target] >= decay[edge.low] * x[edge.source] + kappa:
                return arb("inf")
        return most


def sums(count: int, links: Sequence[tuple[int, int, float]], added: Sequence[float]) -> list[Fraction]:
    """About the least x (count,) with x_r >= factor x_q + added of all links (q, r, factor), by more than rounding: of
    each node the link that decides is kept, and changed until none is above."""
    slack = _SLACK * max(added)
    added = [one + slack for one in added]
    into = [[k for k, link in enumerate(links) if link[1] == r] for r in range(count)]
    chosen = [max(own, key=lambda k: added[k]) for own in into]
    x: Array = np.zeros(count)
    for _ in range(_POLICIES):
        A, b = np.eye(count), np.zeros(count)
        for r, k in enumerate(chosen):
            A[r, links[k][0]] -= links[k][2]
            b[r] = added[k]
        try:
            x = np.asarray(np.linalg.solve(A, b), dtype=float)
        except np.linalg.LinAlgError:
            break
        value = [links[k][2] * x[links[k][0]] + added[k] for k in range(len(links))]
        better = [max(own, key=lambda k: value[k]) for own in into]
        if all(value[new] <= value[old] + slack / 10 for new, old in zip(better, chosen, strict=True)):
            break
        chosen = better
    return [Fraction(float(value)) if np.isfinite(value) else Fraction(0) for value in x]


@dataclass(frozen=True)
class GraphPeak(UnderBounded, GraphSize):
    """Of bounded disturbance and noise."""

    name: ClassVar[str] = "graph_peak"


@dataclass(frozen=True)
class GraphMeanSquare(UnderWhite, GraphSize):
    """Where one of disturbance and noise is white, or both."""

    name: ClassVar[str] = "graph_mean_square"


def _rates(question: Question) -> list[Fraction]:
    """Parts of the fastest rate that is proved with little effort, which the memory keeps."""
    from cdobs_cli.certify.methods.rung import GENERAL

    if "fastest" not in question.memory:
        quick = question.with_effort(min(question.effort, 1)).afresh()
        met = GENERAL.fastest(quick, _WIDTH)
        rate = None if met is None else met.prove(quick).rate
        question.memory["fastest"] = 0.0 if rate is None else min(float(rate.lower()), 1e9)
    fastest = question.memory["fastest"]
    return [search.short(fastest * part, 6).rational or Fraction(0) for part in _PARTS if fastest > 0]


def _aim(question: Question) -> GraphAim:
    """The state, and second moments that stand for what is declared at this rate: of N samples in a unit of time
    bounded noise adds up to about N^2, and all of it over 1 / (sigma H) such units."""
    from cdobs_cli.certify.methods.clock.graph_aim import GraphAim

    plant, law = question.plant, question.law
    (R, Q), (v, d) = noise_floats(plant), bounded_floats(plant)
    H = unit(law)
    count = max(1, round(H / float(law.base * Exact(_gap(law)))))
    turns = 1 / (float(question.rate) * H)
    floor = np.zeros((plant.n, plant.n))
    floor[question.state, question.state] = 1.0
    bounded = count * turns**2 * np.diag(v**2), H * turns**2 * np.diag(d**2)
    return GraphAim(R * turns / 2 + bounded[0], Q * turns / 2 + bounded[1], np.zeros_like(floor), floor)


def _gap(law: SamplingLaw) -> Fraction:
    """Between two samples, about, in the shortest period."""
    edges = law.graph.edges
    return sum((edge.low + edge.high for edge in edges), Fraction(0)) / (2 * len(edges))


def _vertices(box: Box | None, G: Matrix) -> list[Matrix] | None:
    """G times the corners of a box as large as the signals become, one of each two that are opposite."""
    columns = acting(box)
    sizes = acting_sizes(box)
    if 2 ** len(columns) > _MOST_VERTICES:
        return None
    if not columns:
        return []
    own = G[:, columns]
    signs = ((1, *rest) for rest in product((1, -1), repeat=len(columns) - 1))
    return [own @ Matrix.from_rows([[size * sign] for size, sign in zip(sizes, one, strict=True)]) for one in signs]


def _trace(M: Matrix) -> arb:
    return sum((arb(M[i, i]) for i in range(M.shape[0])), arb(0))


def _most(values: Iterator[arb]) -> arb:
    most = arb(0)
    for value in values:
        most = most.max(value)
    return most
