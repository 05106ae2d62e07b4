"""The clock-dependent certificate: a quadratic function whose matrix depends on the time since the last sample.

For edot in Co{A_v} e, e+ = J e at clock values in [T_min, T_max]: if for P piecewise polynomial and continuous

    Pdot + P A_v + A_v' P + 2 sigma P < 0    on [0, T_max], all corners v,                          (flow)
    P(tau) - J' P(0) J > 0                   on [T_min, T_max],                                      (jump)
    P(0) > 0 on the range of J,

then every error decays at rate sigma: V = e' P(tau) e falls along every flow of the inclusion and does not
rise at jumps. In Bernstein form each inequality is a finite list of matrices.

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

from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import common_quadratic, dead_beat, polygon
from cdobs_cli.certify.ball import has_spectral_radius_below
from cdobs_cli.certify.clock_form import Shape, erases_the_rest, flow_coefficients, in_basis, jump_gap, kept_states, lyapunov
from cdobs_cli.certify.definite import Definiteness, has_positive_pivots
from cdobs_cli.certify.linear import interval_of, is_linear, stable_intervals
from cdobs_cli.certify.sampled_error import kept_and_lost
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

M_ = TypeVar("M_")

METHOD = "clock"
MONODROMY = "spectral_radius"
METHODS = (METHOD, MONODROMY, common_quadratic.METHOD, polygon.METHOD, dead_beat.METHOD)
MAX_CORNER_ENTRIES = 10  # 2^10 corners at most are enumerated
UNDECIDED = Definiteness("undecided", None)


Cuts = dict[tuple["Shape", bool], set[tuple[int, int]]]


def prove(inclusion: HybridInclusion, certificate: Certificate) -> Definiteness:
    """Prove a stored certificate for this inclusion, under the certificate's sampling law and rate. No solver.

    The margin is not computed (a proof by pivots of every coefficient).
    """
    provers = {
        MONODROMY: _prove_monodromy, METHOD: _prove_clock, common_quadratic.METHOD: _by(common_quadratic.prove),
        polygon.METHOD: _by(polygon.prove), dead_beat.METHOD: _by(dead_beat.prove),
    }  # fmt: skip
    if certificate.method not in provers:
        return UNDECIDED
    try:
        return provers[certificate.method](inclusion, certificate)
    except (KeyError, TypeError, ValueError, IndexError, ExpressionError, ZeroDivisionError):
        return UNDECIDED


def decay(certificate: Certificate) -> arb:
    """A lower bound of the decay rate that a proved certificate shows: sigma, infinite for a dead beat.

    Raises: KeyError, ExpressionError, ValueError."""
    return arb("inf") if certificate.method == dead_beat.METHOD else fraction_ball(rate(certificate))


def rate(certificate: Certificate) -> Fraction:
    """The decay rate sigma >= 0 that the certificate was made for. Raises: KeyError, ExpressionError, ValueError."""
    sigma = _rational(certificate.data["sigma"])
    if sigma < 0:
        raise ValueError("a rate below 0 is no decay")
    return sigma


def _prove_clock(inclusion: HybridInclusion, certificate: Certificate) -> Definiteness:
    data, law = certificate.data, certificate.sampling
    if len(inclusion.entries) > MAX_CORNER_ENTRIES:
        return UNDECIDED
    shape = Shape(int(data["degree"]), int(data["elevated"]), int(data["pieces"][0]), int(data["pieces"][1]))
    sigma = rate(certificate)
    T_min, T_max = _value(law.T_min), _value(law.T_max)
    S = Matrix.from_rows([[_rational(text) for text in row] for row in data["basis"]])
    maps = in_basis(inclusion.balls, S, S.inverse())
    P = [symmetric_from_upper(rows) for rows in data["P"]]
    N = maps.base.shape[0]
    if not _well_posed(shape, law) or len(P) != shape.count or any(matrix.shape != (N, N) for matrix in P):
        return UNDECIDED
    kept = kept_states(maps.jump)
    if not _positive_on_range(P[0], maps.jump, kept):
        return UNDECIDED
    for number in range(shape.jump_from, shape.count):
        gap = jump_gap(P[0], P[number], maps.jump)
        if number == 0 and law.from_zero:
            if not _gap_from_zero(P[0], maps.jump, kept):
                return UNDECIDED
        elif not _positive(gap):
            return UNDECIDED
    coefficients = list(flow_coefficients(P, shape, shape.lengths(T_min, T_max)))
    for A in maps.corners():
        for slope, value in coefficients:
            if not _positive(-(slope + lyapunov(value, A, sigma))):
                return UNDECIDED
    return Definiteness("proved", None)


def _well_posed(shape: Shape, law: SamplingLaw) -> bool:
    """Pieces cover [0, T_max] with T_min a break point."""
    if law.is_updated or shape.d < 1 or shape.d > shape.D or min(shape.before, shape.after) < 0 or shape.pieces < 1:
        return False
    if law.T_max.sign() != 1:
        return False
    if law.is_periodic:
        return shape.before > 0 and shape.after == 0
    if (law.T_max - law.T_min).sign() != 1 or shape.after == 0:
        return False
    return shape.before == 0 if law.from_zero else law.T_min.sign() == 1 and shape.before > 0


def _positive_on_range(P_0: Matrix, J: Matrix, kept: list[int]) -> bool:
    """P(0) > 0, or only on what J keeps where it erases all the rest."""
    return _positive(P_0[kept, kept] if kept and erases_the_rest(J, kept) else P_0)


def _gap_from_zero(P_0: Matrix, J: Matrix, kept: list[int]) -> bool:
    """At tau = 0: J = diag(I, j) and P(0) = diag(P_11, Q) exactly, so P(0) - J'P(0)J = diag(0, Q - j'Q j); Q - j'Q j > 0."""
    lost = [i for i in range(J.shape[0]) if i not in kept]
    if any(P_0[i, j] != 0 for i in kept for j in lost):
        return False
    return not lost or _positive(jump_gap(P_0[lost, lost], P_0[lost, lost], J[lost, lost]))


def _positive(M: Matrix) -> bool:
    return has_positive_pivots(M.balls())


def _value(number: Exact) -> Any:
    return number.ball() if number.rational is None else number.rational


def _rational(text: str) -> Fraction:
    value = Exact(text).rational
    if value is None:
        raise ValueError("a certificate holds rationals")
    return value


def symmetric_from_upper(rows: list[list[str]]) -> Matrix:
    """The symmetric matrix with this upper triangle (rows of decimal strings, from the diagonal on)."""
    N = len(rows)
    table = [[_rational(rows[min(i, j)][abs(i - j)]) for j in range(N)] for i in range(N)]
    return Matrix.from_rows(table)


def _prove_monodromy(inclusion: HybridInclusion, certificate: Certificate) -> Definiteness:
    """rho(J exp(A T) exp(sigma T)) < 1 for a linear error system sampled periodically."""
    law = certificate.sampling
    if inclusion.entries or not (law.is_periodic and law.is_bounded):
        return UNDECIDED
    maps, T = inclusion.balls, _value(law.T_max)
    sigma = rate(certificate)
    Phi = (maps.base + Matrix.identity(maps.base.shape[0]) * sigma).exp(T)
    return Definiteness("proved", None) if has_spectral_radius_below(maps.jump @ Phi) else UNDECIDED


def _by(holds: Callable[[HybridInclusion, Certificate], bool]) -> Callable[[HybridInclusion, Certificate], Definiteness]:
    return lambda inclusion, certificate: Definiteness("proved", None) if holds(inclusion, certificate) else UNDECIDED


# The search: floats and the solver propose, `prove` decides.

_SCHEDULE = ((3, 4, 2), (4, 5, 4), (5, 6, 6), (6, 7, 10))  # (d, D, pieces), coarse to fine
# Unknowns allowed for each shape, by effort: small plants go further in the schedule.
_LARGEST = ((10_000, 0, 0, 0), (10_000, 800, 350, 0), (10_000, 10_000, 1400, 400), (10_000, 10_000, 2600, 2600))
_TOLERANCE = (Fraction(1, 100), Fraction(1, 500), Fraction(1, 2000), Fraction(1, 5000))  # of a period search
_LINEAR_TOLERANCE = (Fraction(1, 500), Fraction(1, 2000), Fraction(1, 10000), Fraction(1, 100000))
GAIN_DIGITS = 6


def analyse(inclusion: HybridInclusion, effort: int, sigma: Fraction = Fraction(0), cuts: Cuts | None = None) -> Certificate | None:
    """A proved certificate for this gain under the inclusion's sampling law, with decay rate sigma, or None.

    A dead beat needs no search. A linear error system sampled periodically is decided by its spectral radius,
    under an interval of periods by forms of its sampled error; else the schedule of degrees and pieces is tried
    up to `effort` (0..3). Uses the solver. `cuts` remembers which corners bound before: pass the same dict
    through a search over periods or gains.
    """
    cuts = {} if cuts is None else cuts
    gone = dead_beat.analyse(inclusion)
    if gone is not None:
        return gone
    if not inclusion.entries and inclusion.sampling.is_periodic:
        certificate = Certificate(MONODROMY, inclusion.sampling, {"sigma": fraction_text(sigma)})
        return certificate if prove(inclusion, certificate).proved else None
    if common_quadratic.applies(inclusion):
        common = analyse_linear(inclusion, effort, sigma)
        if common is not None or inclusion.balls.jump.is_rational:
            return common
    for shape in shapes(inclusion, effort):
        proposed = propose(inclusion, shape, sigma, cuts)
        if proposed is not None and prove(inclusion, proposed).proved:
            return proposed
    return None


def analyse_linear(inclusion: HybridInclusion, effort: int, sigma: Fraction) -> Certificate | None:
    """A form or a polygon for a linear loop under an interval of periods, proved, or None."""
    return common_quadratic.analyse(inclusion, effort, sigma) or polygon.analyse(inclusion, effort, sigma)


def design_impulsive(
    open_loop: HybridInclusion, effort: int, sigma: Fraction = Fraction(0), cuts: Cuts | None = None
) -> tuple[NDArray[np.float64], Certificate] | None:
    """A gain K (n, p) for the jump e+ = (I - K C) e with a proved certificate, or None.

    K comes rounded to GAIN_DIGITS significant digits, and the certificate is proved for that K. The jump of
    `open_loop` is not read. With T_min = 0 the gain is looked for from T_max / 8 on, and must keep C K = I
    exactly to be proved from 0. Uses the solver. `cuts` as in `analyse`.
    """
    cuts = {} if cuts is None else cuts
    law = open_loop.sampling
    if len(open_loop.entries) > MAX_CORNER_ENTRIES or law.T_max.sign() != 1 or law.is_updated:
        return None
    from_zero, longest = law.from_zero, law.T_max.rational
    away = open_loop
    if from_zero:
        if longest is None:
            return None
        away = _with_law(open_loop, SamplingLaw("aperiodic", Exact(longest / 8), law.T_max))
    for shape in shapes(away, effort):
        K = propose_gain(away, shape, sigma, cuts)
        if K is None:
            continue
        rounded = ExactMatrix.from_floats(_cleared(K, open_loop) if from_zero else K, GAIN_DIGITS)
        closed = with_gain(open_loop, rounded)
        own = Shape(shape.d, shape.D, 0, shape.pieces) if from_zero else shape
        certificate = propose(closed, own, sigma, cuts)
        if certificate is not None and prove(closed, certificate).proved:
            import numpy as np

            return np.array(rounded.floats), certificate
    return None


def _cleared(K: NDArray[np.float64], open_loop: HybridInclusion) -> NDArray[np.float64]:
    """The nearest gain with C K = I (in floats)."""
    import numpy as np

    C = np.array(open_loop.plant.C.floats)
    return K + np.linalg.pinv(C) @ (np.eye(len(C)) - C @ K)


def _with_law(inclusion: HybridInclusion, law: SamplingLaw) -> HybridInclusion:
    return HybridInclusion(inclusion.assemble, inclusion.plant, inclusion.gain, law, inclusion.entries)


def with_gain(open_loop: HybridInclusion, K: ExactMatrix) -> HybridInclusion:
    """The inclusion with the jump e+ = (I - K C) e."""

    def assemble(view: Any) -> ErrorMaps[Any]:
        maps = open_loop.assemble(view)
        identity = view.unit(0) @ view.unit(0).T
        for i in range(1, view.A.shape[0]):
            identity = identity + view.unit(i) @ view.unit(i).T
        return ErrorMaps(maps.base, maps.left, maps.right, maps.lower, maps.upper, identity - view.gain["K"] @ view.C)

    return HybridInclusion(assemble, open_loop.plant, {**open_loop.gain, "K": K}, open_loop.sampling, open_loop.entries)


def largest_period(
    at: Callable[[Exact], HybridInclusion], start: Exact, effort: int, sigma: Fraction = Fraction(0)
) -> tuple[Exact, Certificate] | None:
    """The largest period found with a proved certificate for this gain, and the certificate.

    Args:
        at: the inclusion with its sampling law at a given period (or largest period).
        start: where to look first; the search walks up or down from it, then bisects. For a linear error system
            sampled periodically: the end of the proved interval that holds `start`, or else of the first one.
            Where one sample erases every error: `start` itself, as no period is too long.
    """
    if dead_beat.resets(at(start)):
        gone = dead_beat.analyse(at(start))
        return None if gone is None else (start, gone)
    if is_linear(at(start)):
        return _longest_linear(at, start, sigma)
    if common_quadratic.applies(at(start)) and at(start).balls.jump.is_rational:
        return _longest_aperiodic(at, start, effort, sigma)
    cuts: Cuts = {}
    return _largest(lambda T: analyse(at(T), effort, sigma, cuts), lambda T: analyse(at(T), 0, sigma, cuts), start, effort)


def _longest_linear(at: Callable[[Exact], HybridInclusion], start: Exact, sigma: Fraction) -> tuple[Exact, Certificate] | None:
    intervals = stable_intervals(at(start), float(start) / 1000, float(start) * 20)
    chosen = interval_of(intervals, start) or (intervals[0] if intervals else None)
    if chosen is None:
        return None
    if sigma == 0:
        certificate = analyse(at(chosen.high), 0)
        return None if certificate is None else (chosen.high, certificate)
    return _largest(lambda T: analyse(at(T), 0, sigma), lambda T: analyse(at(T), 0, sigma), start, 3)


def _longest_aperiodic(
    at: Callable[[Exact], HybridInclusion], start: Exact, effort: int, sigma: Fraction
) -> tuple[Exact, Certificate] | None:
    """A walk by factors from `start`, then bisection: the laws [T_min, T] grow with T."""
    from cdobs_cli.certify.bracket import largest_proved, short_period

    def prove_at(T: Exact) -> Certificate | None:
        return analyse_linear(at(T), effort, sigma)

    low, floor = float(start), float(at(start).sampling.T_min)
    found, steps = prove_at(start), 0
    while found is None and steps < 24:
        low, steps = floor + (low - floor) / 1.6, steps + 1
        found = prove_at(short_period(low))
    if found is None:
        return None
    high = low * 1.6
    while steps == 0 and high < 1e3 * float(start) and prove_at(short_period(high)) is not None:
        low, high = high, high * 1.6
    lowest = start if low == float(start) else short_period(low)
    return largest_proved(prove_at, lowest, short_period(high), _LINEAR_TOLERANCE[_level(effort)])


def largest_period_design(
    at: Callable[[Exact], HybridInclusion], start: Exact, effort: int, sigma: Fraction = Fraction(0)
) -> tuple[Exact, tuple[NDArray[np.float64], Certificate]] | None:
    """The largest period found for which `design_impulsive` has a gain, with the gain and its certificate.

    Args:
        at: the open loop with its sampling law at a given period (or largest period).
        start: where to look first.
    """
    cuts: Cuts = {}
    return _largest(
        lambda T: design_impulsive(at(T), effort, sigma, cuts), lambda T: design_impulsive(at(T), 0, sigma, cuts), start, effort
    )


def _largest(find: Callable[[Exact], M_ | None], cheap: Callable[[Exact], M_ | None], start: Exact, effort: int) -> tuple[Exact, M_] | None:
    """Walk from `start` with the cheap search, then bisect with the full one."""
    from cdobs_cli.certify.bracket import largest_proved, short_period

    low = float(start)
    if not 0 < low < 1e12:
        return None
    for _ in range(24):
        if cheap(short_period(low)) is not None:
            break
        low /= 1.6
    else:
        found = find(start)
        return None if found is None else (start, found)
    high = low * 1.6
    while high < 1e3 * float(start) and (cheap(short_period(high)) is not None or find(short_period(high)) is not None):
        low, high = high, high * 1.6
    return largest_proved(find, short_period(low), short_period(high), _TOLERANCE[_level(effort)])


def _level(effort: int) -> int:
    return max(0, min(effort, 3))


def shapes(inclusion: HybridInclusion, effort: int) -> Iterator[Shape]:
    """The schedule of shapes for this inclusion, coarse to fine."""
    if inclusion.sampling.is_updated:
        return
    T_min, T_max = float(inclusion.sampling.T_min), float(inclusion.sampling.T_max)
    if not 0 < T_max < 1e12 or len(inclusion.entries) > MAX_CORNER_ENTRIES:
        return
    N = inclusion.floats.base.shape[0]
    level = _level(effort)
    for (d, D, pieces), largest in zip(_SCHEDULE, _LARGEST[level], strict=True):
        if (pieces * d + 1) * N * (N + 1) // 2 > largest:
            return
        if inclusion.sampling.is_periodic:
            yield Shape(d, D, pieces, 0)
        elif T_min == 0:
            yield Shape(d, D, 0, pieces)
        else:
            before = max(1, min(pieces - 1, round(pieces * T_min / T_max)))
            yield Shape(d, D, before, pieces - before)


def propose(inclusion: HybridInclusion, shape: Shape, sigma: Fraction, cuts: Cuts) -> Certificate | None:
    """What the solver proposes for this gain and shape: not proved.

    `cuts` as in `analyse`.
    """
    from cdobs_cli.certify.clock_search import Search

    found = _search(Search, inclusion, shape, sigma, cuts, None)
    if found is None:
        return None
    solution, S = found
    data = {
        "degree": str(shape.d), "elevated": str(shape.D), "pieces": [str(shape.before), str(shape.after)],
        "sigma": fraction_text(sigma), "basis": [[fraction_text(value) for value in row] for row in S],
        "P": [_upper_texts(P) for P in solution.P],
    }  # fmt: skip
    return Certificate(METHOD, inclusion.sampling, data)


def propose_gain(open_loop: HybridInclusion, shape: Shape, sigma: Fraction, cuts: Cuts) -> NDArray[np.float64] | None:
    """The gain K = P(0)^-1 W that the solver proposes for this shape."""
    import numpy as np

    from cdobs_cli.certify.clock_search import Search

    found = _search(Search, open_loop, shape, sigma, cuts, np.array(open_loop.plant.C.floats))
    if found is None:
        return None
    solution, S = found
    assert solution.W is not None
    try:
        K = np.array(S, dtype=float) @ np.linalg.solve(solution.P[0], solution.W)
    except np.linalg.LinAlgError:
        return None
    return K if np.all(np.isfinite(K)) else None


def _search(
    search: Any, inclusion: HybridInclusion, shape: Shape, sigma: Fraction, cuts: Cuts, C: Any
) -> tuple[Any, list[list[Fraction]]] | None:
    import numpy as np

    law = inclusion.sampling
    from_zero = law.from_zero
    S = split_basis(inclusion) if from_zero and C is None else basis(inclusion)
    if S is None or (from_zero and C is not None):
        return None
    change = np.array(S, dtype=float)
    maps = in_basis(inclusion.floats, change, np.linalg.inv(change))
    T = float(law.T_max)
    jump = maps.jump
    if from_zero:  # its zeros and ones exactly so
        exact = Matrix.from_rows(S)
        jump = (exact.inverse() @ inclusion.balls.jump @ exact).floats
    unit = ErrorMaps(maps.base * T, tuple(column * T for column in maps.left), maps.right, maps.lower, maps.upper, jump)
    if not all(np.all(np.isfinite(part)) for part in (unit.base, unit.jump, *unit.left, *unit.right)):
        return None
    problem = search(shape, float(law.T_min) / T, maps.base.shape[0], None if C is None else C @ change, from_zero)
    problem.cuts = cuts.setdefault((shape, C is None), set())
    solution = problem.solve(unit, float(sigma) * T)
    cuts[shape, C is None] = problem.cuts
    if solution is None or not solution.margin > 0:
        return None
    return solution, S


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
        entries = [Fraction(int(value.p), int(value.q)) for value in column]
        size = max((abs(entry / unit) for entry, unit in zip(entries, units, strict=True)), default=Fraction(1))
        columns.append([entry / Fraction(2) ** _exponent(float(size)) for entry in entries])
    return [list(row) for row in zip(*columns, strict=True)]


def basis(inclusion: HybridInclusion) -> list[list[Fraction]]:
    """Columns of S in e = S z, powers of 2: each state in units of what it adds to the outputs' Taylor terms
    over T_max (for a chain of integrators T^(i-1)); further states, held innovations, in the outputs' units."""
    import numpy as np

    plant, T = inclusion.plant, float(inclusion.sampling.T_max)
    n, N = plant.n, inclusion.floats.base.shape[0]
    term = np.abs(plant.C.floats)
    A = np.abs(plant.A.floats) * T
    size = term.max(axis=0)
    with np.errstate(all="ignore"):
        for _ in range(n - 1):
            term = term @ A
            # A state that the outputs feel directly keeps that unit.
            size = np.where(size > 0, size, term.max(axis=0))
    scale = [Fraction(2) ** -_exponent(value) for value in size]
    rows = np.abs(plant.C.floats) @ np.diag([float(s) for s in scale])
    for i in range(N - n):
        scale.append(Fraction(2) ** _exponent(rows[i % plant.p].max()))
    return [[s if i == j else Fraction(0) for j in range(N)] for i, s in enumerate(scale)]


def _exponent(value: float) -> int:
    import math

    return max(-200, min(200, round(math.log2(value)))) if 0 < value < math.inf else 0


def _upper_texts(P: NDArray[np.float64]) -> list[list[str]]:
    from cdobs_cli.exact.numbers import decimal_text

    return [[decimal_text(float(P[i, j]), 12) for j in range(i, P.shape[0])] for i in range(P.shape[0])]
