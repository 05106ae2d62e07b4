"""The exact period bound of a planar error system whose jump clears the measured error.

    edot_1 = e_2,   edot_2 = v_1 e_1 + v_2 e_2,   v_j(t) in [lo_j, hi_j];      e+ = (0, e_2 - K_2 e_1)

After a jump e = (0, e_2), so the error map is a number: e_2+ = g e_2 with g = (e_2 - K_2 e_1)(delta) from
e(0) = (0, 1). While e_1 > 0 the slope m = e_2 / e_1 obeys m' = v_1 + v_2 m - m^2, (ln e_1)' = m, and any m lies
pointwise below the steepest curve from the start and below the curve that falls fastest into its own end
point. Their minimum is itself admissible: climb for a time s, then fall. So among all V(.) that end at the
same slope it makes e_1(delta) largest, and

    sup |g| < 1    exactly if    -1 < g(s) < 1 for every s in [0, delta],

g(s) the map of `climb` (v_1 = hi_1, v_2 e_2 largest) for s and `fall` (v_1 = lo_1, v_2 e_2 smallest) for delta - s.
The condition is proved in balls, cell by cell in s; its failure is a counterexample with at most three switches.

Source: Dinh2014, Section IV (the class of plants); the bound is exact where the paper's is sufficient.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self, TypeVar

from flint import arb, fmpq

from cdobs_cli.certify.cover import covered
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question
from cdobs_cli.certify.methods.planar.floats import FloatSweep
from cdobs_cli.certify.search import rounded_down
from cdobs_cli.certify.texts import rate_of
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, fraction_text
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass

# Limits are looked for from a thousandth of these multiples of the asked period: from half of it, else far below.
_REACH = (500, 5)
T_ = TypeVar("T_")

_MAX_CELLS = 20_000
_START = Matrix.from_rows([[0], [1]])
_NARROW = Fraction(1, 10**14)


@dataclass(frozen=True)
class Planar(Method):
    """It holds the rate only: the proof is the sweep itself. Loads no solver."""

    sigma: str

    name: ClassVar[str] = "planar"
    rung: ClassVar[str] = "planar"
    source: ClassVar[str] = "extremals of the planar class, exact"
    how: ClassVar[str] = "switching times enclosed in balls"
    exact: ClassVar[bool] = True
    statement: ClassVar[str] = "No slope history makes |e_2| after a jump as large as after the jump before"

    @classmethod
    def applies(cls, question: Question) -> bool:
        """A planar class, a jump with K_1 = 1, a rational constant period."""
        return super().applies(question) and question.law.is_periodic and cleared_gain(question.inclusion) is not None

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        sweep = cls(question.law, fraction_text(question.rate))
        return sweep if question.law.is_periodic and sweep.prove(question).holds else None

    def _prove(self, question: Question) -> Proof:
        """|g| < exp(-sigma delta) for every V(.), at the constant period delta."""
        planar, K_2, sigma = planar_class(question.inclusion), cleared_gain(question.inclusion), rate_of(self.sigma)
        delta = self.law.T_max.rational
        if planar is None or K_2 is None or delta is None or delta <= 0 or not self.law.is_periodic:
            return NOTHING
        family, b = planar
        extremals = sweep(family, delta)
        limit = (fraction_ball(sigma * delta) * -1).exp()
        return Proof.of(extremals is not None and extremals.proves(K_2 * b, limit), sigma)

    def lost_by_every_gain(self, question: Question) -> Method | None:
        from cdobs_cli.certify.methods.planar.every_gain import CellsOfGains

        return CellsOfGains.just_above(question.under(self.law))

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """At the first period at which some extremal reaches |g| = 1, rounded down."""
        planar, K_2 = planar_class(question.inclusion), cleared_gain(question.inclusion)
        if planar is None or K_2 is None:
            return None
        family, b = planar
        scaled = float(arb(K_2 * b).mid())
        return last_proved(
            lambda below: limit_of_gain(family, scaled, below),
            lambda T: cls.propose(question.at(T)),
            question.law.T_max,
        )


@dataclass(frozen=True)
class PlanarClass:
    """The slope ends lo, hi (two each), rationals or balls."""

    lo: tuple[Any, Any]
    hi: tuple[Any, Any]

    @cached_property
    def climb(self) -> tuple[Matrix, Matrix]:
        """Flow matrices of the steepest slope: while e_2 > 0, and while e_2 < 0 (e_1 > 0)."""
        return _companion(self.hi[0], self.hi[1]), _companion(self.hi[0], self.lo[1])

    @cached_property
    def fall(self) -> tuple[Matrix, Matrix]:
        """Flow matrices of the least slope: while e_2 > 0, and while e_2 < 0 (e_1 > 0)."""
        return _companion(self.lo[0], self.lo[1]), _companion(self.lo[0], self.hi[1])

    def floats(self, delta: float) -> FloatSweep:
        """The family of extremals up to delta in floats."""
        lo, hi = ((float(arb(ends[0]).mid()), float(arb(ends[1]).mid())) for ends in (self.lo, self.hi))
        return FloatSweep(lo, hi, delta)


def _companion(v_1: Any, v_2: Any) -> Matrix:
    return Matrix.from_rows([[0, 1], [v_1, v_2]])


def planar_class(inclusion: HybridInclusion) -> tuple[PlanarClass, Any] | None:
    """The planar class of an inclusion with flow matrix [[0, b], [., .]], b != 0, slopes in its last row, and
    the rational b (in the states (e_1, b e_2)); None for any other inclusion."""
    maps = inclusion.balls
    if (
        maps.base.shape != (2, 2)
        or maps.base[0, 0] != 0
        or not isinstance(maps.base[0, 1], fmpq)
        or maps.base[0, 1] == 0
    ):
        return None
    b = maps.base[0, 1]
    lo = [maps.base[1, 0], maps.base[1, 1]]
    hi = list(lo)
    for rho, low, high in zip(inclusion.quantities, maps.lower, maps.upper, strict=True):
        i, j = rho.entry
        if i != 1 or j > 1 or not rho.is_entry:
            return None
        lo[j], hi[j] = lo[j] + _exact(low), hi[j] + _exact(high)
    ends = (lo[0] * b, hi[0] * b) if b > 0 else (hi[0] * b, lo[0] * b)
    return PlanarClass((ends[0], lo[1]), (ends[1], hi[1])), b


def _exact(value: Any) -> Any:
    return Matrix.from_rows([[value]])[0, 0]


def cleared_gain(inclusion: HybridInclusion) -> Any | None:
    """K_2 where the jump is exactly [[0, 0], [-K_2, 1]]; else None."""
    J = inclusion.balls.jump
    # `==` is certain for balls, `!=` is not its opposite.
    if J.shape != (2, 2) or not (J[0, 0] == 0 and J[0, 1] == 0 and J[1, 1] == 1):
        return None
    return -J[1, 0]


@dataclass(frozen=True)
class Branch:
    """The reference solution from (0, 1) of `climb` or `fall`, in balls: one matrix while e_2 > 0, another after.

    `crossing` encloses the time at which e_2 = 0, None if that is not before the horizon."""

    first: Matrix
    second: Matrix
    crossing: arb | None

    def at(self, t: arb) -> Matrix:
        """(2, 1): the solution at every time of the ball t."""
        if self.crossing is None or t <= self.crossing:
            return self.first.exp(t) @ _START
        after = t - self.crossing
        if after >= 0:
            return self.second.exp(after) @ self._turned
        before = _hull(t.lower(), t.upper() if t.upper() < self.crossing.upper() else self.crossing.upper())
        late = _hull(arb(0), after.upper() if after.upper() > 0 else arb(0))
        left = self.first.exp(before) @ _START
        right = self.second.exp(late) @ self._turned
        return Matrix.from_rows([[left[i, 0].union(right[i, 0])] for i in range(2)])

    @cached_property
    def _turned(self) -> Matrix:
        """(2, 1): the solution at its crossing."""
        assert self.crossing is not None
        return self.first.exp(self.crossing) @ _START

    def transition(self, begin: arb, duration: arb) -> Matrix:
        """(2, 2): the derivative of the flow along the reference solution from time `begin`, after `duration`."""
        if self.crossing is None or begin + duration <= self.crossing:
            return self.first.exp(duration)
        if begin >= self.crossing:
            return self.second.exp(duration)
        ahead = _within(self.crossing - begin, duration)
        after = _within(begin + duration - self.crossing, duration)
        return self.second.exp(after) @ self.first.exp(ahead)


def _within(part: arb, whole: arb) -> arb:
    """The part of the ball in [0, whole]."""
    low = part.lower() if part.lower() > 0 else arb(0)
    high = part.upper() if part.upper() < whole.upper() else whole.upper()
    return _hull(low, high) if high >= low else low


def _hull(low: arb, high: arb) -> arb:
    return low.union(high)


def branch(matrices: tuple[Matrix, Matrix], horizon: Fraction) -> Branch | None:
    """The reference solution up to `horizon`, with e_1 > 0 on (0, horizon] proved; None where it is not.

    e_2 leaves the positive side only through e_2' = v_1 e_1 < 0, so while e_1 > 0 it does so once at most;
    and e_1 grows as long as e_2 > 0.
    """
    first, second = matrices

    def e_2(t: arb) -> Any:
        return (first.exp(t) @ _START)[1, 0]

    turn = FloatSweep.crossing((float(arb(first[1, 0]).mid()), float(arb(first[1, 1]).mid())))
    if turn > float(horizon):
        made = Branch(first, second, None)
        return made if _positive_on(e_2, Fraction(0), horizon) else None
    for width in (1e-14, 1e-12, 1e-10):
        low, high = Fraction(turn * (1 - width)), Fraction(turn * (1 + width))
        if e_2(fraction_ball(low)) > 0 and e_2(fraction_ball(high)) < 0:
            break
    else:
        return None
    made = Branch(first, second, _hull(fraction_ball(low), fraction_ball(high)))
    if not _positive_on(e_2, Fraction(0), low) or not _positive_on(
        lambda t: made.at(t)[0, 0], low, horizon if horizon > low else low
    ):
        return None
    return made


def _positive_on(function: Any, low: Fraction, high: Fraction) -> bool:
    """function > 0 on [low, high], by adaptive cells."""

    def holds(a: Fraction, b: Fraction) -> bool:
        return bool(function(_hull(fraction_ball(a), fraction_ball(b))) > 0)

    return covered(holds, low, high, pieces=2000, narrowest=Fraction(1, 10**22))


@dataclass(frozen=True)
class Sweep:
    """e(delta; s) from e(0) = (0, 1): climb for s, then fall, for s in [0, delta]; spread = hi - lo."""

    climb: Branch
    fall: Branch
    spread: tuple[Any, Any]
    delta: Fraction
    floats: FloatSweep

    def meeting(self, s: Fraction) -> tuple[arb, arb]:
        """(theta, r): e(s) = r d(theta), d the falling reference solution; theta <= s increases with s.

        A float proposes theta; the sign of the cross product on either side proves it."""
        e = self.climb.at(fraction_ball(s))
        if s == 0:
            return arb(0), arb(1)

        def cross(theta: arb) -> Any:
            d = self.fall.at(theta)
            return e[0, 0] * d[1, 0] - e[1, 0] * d[0, 0]

        low, high = Fraction(0), s
        guess = self.floats.meeting(float(s))
        for width in (1e-13, 1e-11, 1e-9):
            left, right = Fraction(guess * (1 - width)), Fraction(guess * (1 + width))
            if left > 0 and right < s and cross(fraction_ball(left)) > 0 and cross(fraction_ball(right)) < 0:
                low, high = left, right
                break
        theta = _hull(fraction_ball(low), fraction_ball(high))
        d = self.fall.at(theta)
        r = e[1, 0] / d[1, 0] if e[1, 0] > e[0, 0] else e[0, 0] / d[0, 0]
        return theta, r

    def end(self, s: Fraction, theta: arb, r: arb) -> Matrix:
        """(2, 1): e(delta; s) from where it meets, tightly."""
        end: Matrix = self.fall.at(theta + fraction_ball(self.delta - s)) * r
        return end

    def derivative(self, low: Fraction, high: Fraction, theta: arb) -> Matrix:
        """(2, 1): d e(delta; s) / ds over s in [low, high]: the transition of the difference of the two flows."""
        s = _hull(fraction_ball(low), fraction_ball(high))
        e = self.climb.at(s)
        jolt = e[0, 0] * self.spread[0] + abs(e[1, 0]) * self.spread[1]
        column: Matrix = self.fall.transition(theta, fraction_ball(self.delta) - s)[:, 1]
        slope: Matrix = column * jolt
        return slope

    def proves(self, K_2: Any, limit: arb) -> bool:
        """Whether |e_2 - K_2 e_1| < limit is proved for every s in [0, delta], cell by cell."""

        def g(e: Matrix) -> arb:
            return arb(e[1, 0] - e[0, 0] * K_2)

        count = 16
        points = [self.delta * k / count for k in range(count + 1)]
        thetas = [self.meeting(point)[0] for point in points]
        stack = [(points[k], points[k + 1], thetas[k], thetas[k + 1]) for k in range(count)]
        for _ in range(_MAX_CELLS):
            if not stack:
                return True
            low, high, theta_low, theta_high = stack.pop()
            middle = (low + high) / 2
            theta, r = self.meeting(middle)
            at_middle = g(self.end(middle, theta, r))
            if abs(at_middle) >= limit or not at_middle.is_finite():
                return False
            slope = g(self.derivative(low, high, theta_low.union(theta_high)))
            reach = at_middle + slope * _hull(-fraction_ball((high - low) / 2), fraction_ball((high - low) / 2))
            if not abs(reach) < limit:
                if high - low < self.delta * _NARROW:
                    return False
                stack += [(low, middle, theta_low, theta), (middle, high, theta, theta_high)]
        return False


def sweep(family: PlanarClass, delta: Fraction) -> Sweep | None:
    """The family of extremals up to delta; None where e_1 > 0 is not proved on (0, delta]."""
    climb, fall = branch(family.climb, delta), branch(family.fall, delta)
    if climb is None or fall is None:
        return None
    spread = (family.hi[0] - family.lo[0], family.hi[1] - family.lo[1])
    return Sweep(climb, fall, spread, delta, family.floats(float(delta)))


def best_gain(open_loop: HybridInclusion) -> Fraction | None:
    """K_2 in the middle of the gains that no extremal defeats, in floats; None where there are none."""
    planar = planar_class(open_loop)
    if planar is None or not open_loop.sampling.is_periodic:
        return None
    family, b = planar
    least, most, _, _ = family.floats(float(open_loop.sampling.T_max)).gains()
    return Fraction((least + most) / 2 / float(b)) if least < most else None


def limit_any_gain(family: PlanarClass, below: float) -> float:
    """The constant period, in floats, at which no K_2 is left (at most `below`)."""

    def left(delta: float) -> float:
        least, most, _, _ = family.floats(delta).gains()
        return (most - least) * delta

    return _first_loss(left, below)


def limit_of_gain(family: PlanarClass, K_2: float, below: float) -> float:
    """The first constant period, in floats, at which some extremal reaches |g| = 1 (at most `below`)."""

    def left(delta: float) -> float:
        least, most, _, _ = family.floats(delta).gains()
        return min(most - K_2, K_2 - least) * delta

    return _first_loss(left, below)


def _first_loss(left: Callable[[float], float], below: float) -> float:
    """Where `left` first fails to be positive: growing steps, then bisection; 0 where it fails at once."""
    low, high = 0.0, below * 1e-3
    while left(high) > 0:
        low, high = high, high * 1.3
        if low >= below:
            return below
    while low > 0.0 and high - low > 1e-11 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if left(middle) > 0 else (low, middle)
    return low


def switching(family: PlanarClass, b: Any, s: Fraction, delta: Fraction) -> list[tuple[Fraction, tuple[Any, Any]]]:
    """Arcs (length, (slope ends in the typed states: index 0 lower, 1 upper)) of climb for s, then fall."""
    floats = family.floats(float(delta))
    theta = float(floats.meeting(float(s)))
    up, down = floats.crossing(floats.hi), floats.crossing(floats.lo)
    flip = b < 0
    cuts = [Fraction(0), s, delta]
    if up < float(s):
        cuts.append(Fraction(up).limit_denominator(10**9))
    turn = float(s) + down - theta
    if float(s) < turn < float(delta):
        cuts.append(Fraction(turn).limit_denominator(10**9))
    cuts = sorted(set(cuts))
    arcs = []
    for begin, end in pairwise(cuts):
        climbing = end <= s
        time = float(begin + end) / 2
        positive = time < up if climbing else time - float(s) + theta < down
        v_1 = climbing != flip
        v_2 = climbing if positive else not climbing
        arcs.append((end - begin, (int(v_1), int(v_2))))
    return arcs


def last_proved(limit_below: Callable[[float], float], prove: Callable[[Exact], T_ | None], T: Exact) -> T_ | None:
    """The proof at a limit found in floats, rounded down; a little below it where balls cannot tell."""
    limit = next((value for value in (limit_below(reach * float(T)) for reach in _REACH) if value > 0), 0.0)
    for backed_off in (Fraction(0), Fraction(1, 10**5), Fraction(1, 10**4)):
        period = rounded_down(Fraction(limit) * (1 - backed_off), 6)
        proof = prove(period) if period.sign() == 1 else None
        if proof is not None:
            return proof
    return None
