"""The clock-dependent certificate: a quadratic function whose matrix depends on the time since the last sample.

For edot in Co{A_v} e, e+ = J e at clock values in [T_min, T_max]: if for P piecewise polynomial and continuous

    Pdot + P A_v + A_v' P + 2 sigma P < 0    on [0, T_max], all corners v,                          (flow)
    P(tau) - J' P(0) J > 0                   on [T_min, T_max], all corners of J,                    (jump)
    P(0) > 0 on the range of J,

then every error decays at rate sigma: V = e' P(tau) e falls along every flow of the inclusion and does not
rise at jumps. In Bernstein form each inequality is a finite list of matrices. Where samples of a constant
period h are lost the jump comes at multiples of h only, and (jump) is asked there. Where each sample is lost with
probability p, independently,

    P(h) - (1 - p) J' P(0) J - p P(0) > 0

makes E V fall by exp(-2 sigma h) a sample, whatever slopes that do not know future losses: the error converges in
mean square, and almost surely. Where outputs have slopes that vary, J = I - K H lies in the hull of its corners at
every sample; |J e|^2 in the norm of P(0) > 0 is convex in J, and corners of flow and jump never multiply.

From T_min = 0 the jump inequality is singular at tau = 0 wherever J keeps errors: P(0) - J'P(0)J vanishes on
ker(I - J), and being >= 0 it vanishes there as a form, so P(0) must not couple what J keeps with what it changes.
In a basis of ker(I - J) and the range of I - J (rational, exact)

    J = diag(I, j),   P(0) = diag(P_11, Q),   P(0) - J'P(0)J = diag(0, Q - j'Q j),   Q - j'Q j > 0.

So coefficient 0 of the jump inequality is >= 0, the others are required to be definite, and the polynomial, a
convex combination of them, is > 0 for tau > 0 and >= 0 at 0. A hold has j = 0, as has I - K C with C K = I; one
output and 0 < C K < 2 has j = 1 - C K, and there P(0) K = s C' with s = Q / C K. Any j of spectral radius < 1 has
such Q.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np
from flint import arb

from cdobs_cli.certify.bernstein import elevation
from cdobs_cli.certify.definite import eigenvalue_range, has_positive_pivots, positive_definite
from cdobs_cli.certify.levels import Level
from cdobs_cli.certify.linear import is_linear, is_linear_loop
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.clock.form import (
    Shape,
    erases_the_rest,
    flow_coefficients,
    in_basis,
    jump_gap,
    kept_states,
    lyapunov,
    mean_gap,
)
from cdobs_cli.certify.sampled_error import kept_and_lost
from cdobs_cli.certify.texts import rate_of, rationals, symmetric_from_upper, upper_texts
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fmpq_fraction, fraction_text
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.methods.clock.search import Search, Solution

MAX_CORNER_ENTRIES = 10  # 2^10 corners at most are enumerated
MAX_OUTPUT_ENTRIES = 6  # and 2^6 of the jump
GAIN_DIGITS = 6
_P_DIGITS = 12
_ELEVATIONS = (0, 6, 18, 40)
_SCHEDULE = ((3, 4, 2), (4, 5, 4), (5, 6, 6), (6, 7, 10))  # (d, D, pieces), coarse to fine
# Unknowns allowed for each shape, by effort: small plants go further in the schedule.
_LARGEST = ((10_000, 0, 0, 0), (10_000, 800, 350, 0), (10_000, 10_000, 1400, 400), (10_000, 10_000, 2600, 2600))


@dataclass(frozen=True)
class ClockFunction(Method):
    """What functions of the error and the clock have in common: degree d of P and elevated degree D of the
    inequalities; pieces; sigma; basis: S in e = S z; P: the upper triangles of the Bernstein coefficients of
    z'P(tau)z."""

    degree: str
    elevated: str
    pieces: list[Any]
    sigma: str
    basis: list[list[str]]
    P: list[list[list[str]]]

    rung: ClassVar[str] = "clock"
    how: ClassVar[str] = "exact Bernstein coefficients"
    nonlinear_outputs: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def shapes(cls, question: Question) -> Iterator[Any]:
        """The schedule of shapes for this question, coarse to fine."""

    @classmethod
    @abstractmethod
    def guess(cls, question: Question, shape: Any) -> Self | None:
        """What the solver proposes for this gain and shape: not proved."""

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        """Of the first shape of the schedule, up to the effort, that gives one.

        The memory remembers which corners bound before, from one period or gain to the next.
        """
        if not cls.applies(question):
            return None
        for shape in cls.shapes(question):
            proposal = cls.guess(question, shape)
            if proposal is not None and proposal.prove(question).holds:
                return proposal
        return None

    @cached_property
    def S(self) -> Matrix:
        return rationals(self.basis)

    @cached_property
    def coefficients(self) -> list[Matrix]:
        return [symmetric_from_upper(rows) for rows in self.P]


@dataclass(frozen=True)
class Clock(ClockFunction):
    """pieces: on [0, T_min] and on [T_min, T_max]."""

    pieces: list[str]

    name: ClassVar[str] = "clock"
    source: ClassVar[str] = "clock-dependent Lyapunov function"
    statement: ClassVar[str] = "A clock-dependent e'P(tau)e decreases along flows and does not grow at jumps"
    in_the_mean: ClassVar[bool] = True

    @property
    def sentence(self) -> str:
        if self.law.is_random:
            return "A clock-dependent e'P(tau)e decreases along flows, and in the mean at samples"
        return self.statement

    @classmethod
    def applies(cls, question: Question) -> bool:
        """What the spectral radius or forms of the sampled error decide better is left to them."""
        if is_linear(question.inclusion):
            return False
        return not (is_linear_loop(question) and question.inclusion.balls.jump.is_rational)

    @classmethod
    def shapes(cls, question: Question) -> Iterator[Shape]:
        return shapes(question)

    @classmethod
    def guess(cls, question: Question, shape: Shape) -> Self | None:
        met = _solve(question, shape, None)
        if met is None:
            return None
        solution, S = met
        texts = [[fraction_text(value) for value in row] for row in S]
        P = [upper_texts(P, _P_DIGITS) for P in solution.P]
        pieces = [str(shape.before), str(shape.after)]
        return cls(question.law, str(shape.d), str(shape.D), pieces, fraction_text(question.rate), texts, P)

    @cached_property
    def shape(self) -> Shape:
        before, after = map(int, self.pieces)
        return Shape(int(self.degree), int(self.elevated), before, after, _points(self.law))

    def _prove(self, question: Question) -> Proof:
        law, shape, sigma, P = self.law, self.shape, rate_of(self.sigma), self.coefficients
        if not is_small(question.inclusion) or not _well_posed(shape, law):
            return NOTHING
        maps = in_basis(question.inclusion.balls, self.S, self.S.inverse())
        size = maps.base.shape
        if len(P) != shape.count or any(matrix.shape != size for matrix in P):
            return NOTHING
        jumps = list(maps.jumps())
        if not (_positive(P[0]) if law.is_random else _positive_on_range(P[0], jumps)):
            return NOTHING
        for number in shape.jumps:
            at_zero = number == 0 and law.from_zero
            for J in jumps:
                if not (_gap_from_zero(P[0], J) if at_zero else _positive(self._gap(P[0], P[number], J))):
                    return NOTHING
        coefficients = list(flow_coefficients(P, shape, shape.lengths(law.T_min.scalar, law.T_max.scalar)))
        for A in maps.corners():
            if not all(_positive(-(slope + lyapunov(value, A, sigma))) for slope, value in coefficients):
                return NOTHING
        return Proof.of(True, sigma)

    def _gap(self, P_0: Matrix, P: Matrix, J: Matrix) -> Matrix:
        if self.law.is_random:
            return mean_gap(P_0, P, J, self.law.probability.scalar)  # type: ignore[no-any-return]
        return jump_gap(P_0, P, J)  # type: ignore[no-any-return]

    def level(self, question: Question) -> Level | None:
        """V = e'P(tau)e never rises; elements beyond the n states (held errors) are 0 just after a sample, or reset
        by its jump. Where samples are lost by chance it falls in the mean only."""
        if self.law.is_random or not self.prove(question).holds:
            return None
        n, back = question.plant.n, self.S.inverse()
        reach = largest_states(self._pieces(self.coefficients), self.S, n)
        if reach is None:
            return None
        V = back.T @ self.coefficients[0] @ back
        jumps = (J[:, :n] for J in question.inclusion.balls.jumps())
        return Level(tuple(J.T @ V @ J for J in jumps), tuple(reach))

    def factor(self, question: Question) -> float | None:
        """factor^2 = lambda_max(J'P(0)J) on the states over the least eigenvalue of P(tau) on [0, T_max]."""
        if self.law.is_random:
            return None
        n, back = question.plant.n, self.S.inverse()
        P = [back.T @ one @ back for one in self.coefficients]
        least = least_eigenvalue(self._pieces(P))
        if least is None:
            return None
        jumps = (J[:, :n] for J in question.inclusion.balls.jumps())
        largest = max(eigenvalue_range(J.T @ P[0] @ J, smallest=False).high for J in jumps)
        quotient = arb(largest) / Exact(least).ball()
        return float(quotient.sqrt().upper()) if quotient.is_finite() else None

    def _pieces(self, P: list[Matrix]) -> Iterator[list[Matrix]]:
        d = self.shape.d
        return (P[start : start + d + 1] for start in range(0, len(P) - d, d))


def largest_states(pieces: Iterable[list[Matrix]], S: Matrix, n: int) -> list[arb] | None:
    """Upper ends of (P^-1)_jj of the first n states over all pieces of P, in the states e = S z; None where some piece
    is not shown to be definite."""
    reach: list[arb] | None = None
    for piece in pieces:
        elevated = _elevated_until_definite(piece)
        if elevated is None:
            return None
        # (P^-1)_jj is a convex function of P: at most its largest value over definite coefficients.
        covariances = [S @ P.inverse() @ S.T for P in elevated]
        ends = [_most([arb(covariance[j, j]) for covariance in covariances]) for j in range(n)]
        reach = ends if reach is None else [a.max(b) for a, b in zip(reach, ends, strict=True)]
    return reach


def least_eigenvalue(pieces: Iterable[list[Matrix]]) -> Fraction | None:
    """A lower end of the eigenvalues of P over all pieces, > 0; None where none is shown."""
    least: Fraction | None = None
    for piece in pieces:
        margins = [positive_definite(one).margin for one in _elevated_until_definite(piece) or []]
        if not margins or not all(margins):
            return None
        least = min(margin for margin in (*margins, least) if margin is not None)
    return least


def _elevated_until_definite(piece: list[Matrix]) -> list[Matrix] | None:
    """The Bernstein coefficients of P on one piece, of the first degree tried at which all are definite."""
    degree = len(piece) - 1
    for more in _ELEVATIONS:
        elevated = [_weighted(weights, piece) for weights in elevation(degree, degree + more)]
        if all(_positive(P) for P in elevated):
            return elevated
    return None


def _weighted(weights: tuple[Fraction, ...], piece: list[Matrix]) -> Matrix:
    total: Any = piece[0] * 0
    for weight, coefficient in zip(weights, piece, strict=True):
        total = total + coefficient * weight
    return total  # type: ignore[no-any-return]


def _most(values: list[arb]) -> arb:
    most = values[0]
    for value in values[1:]:
        most = most.max(value)
    return most.upper()


def _well_posed(shape: Shape, law: SamplingLaw) -> bool:
    """Pieces cover [0, T_max] with T_min a break point."""
    if law.is_updated or shape.d < 1 or shape.d > shape.D or min(shape.before, shape.after) < 0 or shape.pieces < 1:
        return False
    if law.T_max.sign() != 1:
        return False
    if law.is_periodic or law.is_random:
        return shape.before > 0 and shape.after == 0
    if law.is_lossy:
        return shape.before > 0 and shape.after == law.lost * shape.before
    if (law.T_max - law.T_min).sign() != 1 or shape.after == 0:
        return False
    return shape.before == 0 if law.from_zero else law.T_min.sign() == 1 and shape.before > 0


def _points(law: SamplingLaw) -> int:
    """At how many points samples come, where some may be lost."""
    return law.lost + 1 if law.is_lossy else 0


def is_small(inclusion: HybridInclusion) -> bool:
    """Whether there are few enough corners, of flow and jump, to enumerate."""
    return len(inclusion.quantities) <= MAX_CORNER_ENTRIES and len(inclusion.outputs) <= MAX_OUTPUT_ENTRIES


def too_many_outputs(plant: Plant) -> str | None:
    """Why an output is not taken: no other method takes slopes of outputs that vary."""
    count = len(plant.output_quantities)
    if count <= MAX_OUTPUT_ENTRIES:
        return None
    return (
        f"the outputs have {count} slopes that vary, at most {MAX_OUTPUT_ENTRIES} are taken: measure simpler functions"
    )


def _positive_on_range(P_0: Matrix, jumps: list[Matrix]) -> bool:
    """P(0) > 0, or only on what the one J keeps where it erases all the rest."""
    kept = kept_states(jumps[0]) if len(jumps) == 1 else []
    return _positive(P_0[kept, kept] if kept and erases_the_rest(jumps[0], kept) else P_0)


def _gap_from_zero(P_0: Matrix, J: Matrix) -> bool:
    """At tau = 0: J = diag(I, j) and P(0) = diag(P_11, Q) exactly, so P(0) - J'P(0)J = diag(0, Q - j'Q j); Q - j'Q j
    > 0."""
    kept = kept_states(J)
    lost = [i for i in range(J.shape[0]) if i not in kept]
    if any(P_0[i, j] != 0 for i in kept for j in lost):
        return False
    return not lost or _positive(jump_gap(P_0[lost, lost], P_0[lost, lost], J[lost, lost]))


def _positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


# The search: floats and the solver propose, `prove` decides.


def shapes(question: Question) -> Iterator[Shape]:
    """The schedule of shapes for this question, coarse to fine."""
    law = question.law
    if law.is_updated:
        return
    T_min, T_max = float(law.T_min), float(law.T_max)
    if not 0 < T_max < 1e12 or not is_small(question.inclusion):
        return
    N = question.inclusion.floats.base.shape[0]
    # From T_min = 0 coarse shapes end early; for two states a finer one is quick.
    level = min(question.level + 1, len(_LARGEST) - 1) if law.from_zero and N <= 2 else question.level
    for (d, D, pieces), largest in zip(_SCHEDULE, _LARGEST[level], strict=True):
        if law.is_lossy:
            pieces = max(1, pieces // (law.lost + 1)) * (law.lost + 1)
        if (pieces * d + 1) * N * (N + 1) // 2 > largest:
            return
        if law.is_periodic or law.is_random:
            yield Shape(d, D, pieces, 0)
        elif law.is_lossy:
            before = pieces // (law.lost + 1)
            yield Shape(d, D, before, pieces - before, _points(law))
        elif law.from_zero:
            yield Shape(d, D, 0, pieces)
        else:
            before = max(1, min(pieces - 1, round(pieces * T_min / T_max)))
            yield Shape(d, D, before, pieces - before)


def design_impulsive(question: Question, letter: str = "K") -> tuple[ExactMatrix, Clock] | None:
    """A gain K (n, p) for the jump e+ = (I - K C) e with a proved certificate, or None.

    K comes rounded to GAIN_DIGITS significant digits, and the certificate is proved for that K. The gain of the
    question is not read. With T_min = 0 the gain is looked for from T_max / 8 on, and must keep C K = I exactly to
    be proved from 0. Uses the solver; the memory as in `Clock.propose`.
    """
    law = question.law
    if not is_small(question.inclusion) or law.T_max.sign() != 1 or law.is_updated:
        return None
    away = question
    if law.from_zero:
        if law.T_max.rational is None:
            return None
        away = question.under(SamplingLaw("aperiodic", Exact(law.T_max.rational / 8), law.T_max))
        if question.inclusion.floats.base.shape[0] <= 2:
            away = away.with_effort(question.effort + 1)  # as `shapes` goes further from 0
    for shape in shapes(away):
        K = _guess_gain(away, shape)
        if K is None:
            continue
        rounded = ExactMatrix.from_floats(_cleared(K, question) if law.from_zero else K, GAIN_DIGITS)
        closed = question.with_gain({letter: rounded})
        own = Shape(shape.d, shape.D, 0, shape.pieces) if law.from_zero else shape
        certificate = Clock.guess(closed, own)
        if certificate is not None and certificate.prove(closed).holds:
            return rounded, certificate
    return None


def _guess_gain(question: Question, shape: Shape) -> Array | None:
    """The gain K = P(0)^-1 W that the solver proposes for this shape."""
    met = _solve(question, shape, question.inclusion.view_floats.output_corners())
    if met is None:
        return None
    solution, S = met
    assert solution.W is not None
    try:
        K = np.array(S, dtype=float) @ np.linalg.solve(solution.P[0], solution.W)
    except np.linalg.LinAlgError:
        return None
    return K if np.all(np.isfinite(K)) else None


def _cleared(K: Array, question: Question) -> Array:
    """The nearest gain with C K = I (in floats)."""
    C = question.plant.C.floats
    nearest: Array = K + np.linalg.pinv(C) @ (np.eye(len(C)) - C @ K)
    return nearest


def _solve(question: Question, shape: Shape, C: list[Array] | None) -> tuple[Solution, list[list[Fraction]]] | None:
    """The solver's answer in the coordinates z, e = S z, and S; the jump I - K C is free where C is given, at each of
    its corners."""
    posed = pose(question, shape, C)
    if posed is None:
        return None
    solution = posed.search.solve(posed.maps, posed.jumps, float(question.rate) * float(question.law.T_max))
    question.memory[shape, C is None] = posed.search.cuts
    return None if solution is None or not solution.margin > 0 else (solution, posed.S)


def serves(question: Question, shape: Shape) -> bool:
    """Whether a certificate of this shape is met for the question's gain: sooner told than how large its margin is."""
    return _solve(question, shape, None) is not None


class Posed(NamedTuple):
    """A clock problem as the search takes it: in the coordinates z, e = S z, and unit time."""

    search: Search
    maps: ErrorMaps[Array]
    jumps: list[Array]
    S: list[list[Fraction]]


def pose(question: Question, shape: Shape, C: list[Array] | None) -> Posed | None:
    """None where no coordinates serve, or a map is not finite."""
    from cdobs_cli.certify.methods.clock.search import Search

    law, inclusion = question.law, question.inclusion
    S = split_basis(inclusion) if law.from_zero and C is None else basis(inclusion)
    if S is None or (law.from_zero and C is not None):
        return None
    change = np.array(S, dtype=float)
    maps = in_basis(inclusion.floats, change, np.linalg.inv(change))
    T = float(law.T_max)
    jumps = list(maps.jumps())
    if law.from_zero:  # their zeros and ones exactly so
        exact = Matrix.from_rows(S)
        jumps = [J.floats for J in in_basis(inclusion.balls, exact, exact.inverse()).jumps()]
    unit = maps.mapped(lambda flow: flow * T, lambda J: J)
    if not all(np.all(np.isfinite(part)) for part in (unit.base, *jumps, *unit.parts)):
        return None
    seen = None if C is None else [one @ change for one in C]
    search = Search(shape, float(law.T_min) / T, maps.base.shape[0], seen, law.from_zero, float(law.probability))
    search.cuts = question.memory.setdefault((shape, C is None), set())
    return Posed(search, unit, jumps, S)


def split_basis(inclusion: HybridInclusion) -> list[list[Fraction]] | None:
    """Columns of S with S^-1 J S = diag(I, j), 1 no eigenvalue of j, for a rational J; None where there are none.

    A hold's J has j = 0, as has I - K C with C K = I. Columns are scaled like those of `basis`."""
    J = inclusion.balls.jump
    parts = kept_and_lost(J) if J.is_rational else None
    if parts is None:
        return None
    units = [row[i] for i, row in enumerate(basis(inclusion))]
    columns = []
    for column in parts[1].T.tolist():
        entries = [fmpq_fraction(value) for value in column]
        size = max((abs(entry / unit) for entry, unit in zip(entries, units, strict=True)), default=Fraction(1))
        columns.append([entry / Fraction(2) ** _exponent(float(size)) for entry in entries])
    return [list(row) for row in zip(*columns, strict=True)]


def basis(inclusion: HybridInclusion, over: float | None = None) -> list[list[Fraction]]:
    """Columns of S in e = S z, powers of 2: each state in units of what it adds to the outputs' Taylor terms over
    T_max, or another time (for a chain of integrators T^(i-1)); further states, held innovations, in the outputs'
    units."""
    plant, T = inclusion.plant, float(inclusion.sampling.T_max) if over is None else over
    n, N = plant.n, inclusion.floats.base.shape[0]
    seen = np.max(np.abs(inclusion.view_floats.output_corners()), axis=0)
    term = seen
    A = _coupling(inclusion) * T
    size = term.max(axis=0)
    with np.errstate(all="ignore"):
        for _ in range(n - 1):
            term = term @ A
            # A state that the outputs feel directly keeps that unit.
            size = np.where(size > 0, size, term.max(axis=0))
    scale = [Fraction(2) ** -_exponent(value) for value in size]
    rows = seen @ np.diag([float(s) for s in scale])
    for i in range(N - n):
        scale.append(Fraction(2) ** _exponent(rows[i % plant.p].max()))
    return [[s if i == j else Fraction(0) for j in range(N)] for i, s in enumerate(scale)]


def _coupling(inclusion: HybridInclusion) -> Array:
    """How much each state feels another: |A|, and where A has nothing the largest slope."""
    view = inclusion.view_floats
    coupling = np.abs(inclusion.plant.A.floats)
    for part, low, high in zip(view.parts, view.lower, view.upper, strict=True):
        coupling = np.where(coupling == 0, np.abs(part) * max(abs(low), abs(high)), coupling)
    return coupling


def _exponent(value: float) -> int:
    return max(-200, min(200, round(math.log2(value)))) if 0 < value < math.inf else 0
