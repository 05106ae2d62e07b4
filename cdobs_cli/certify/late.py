r"""How much worse an estimate is while measurements are under way, from bounds of what it is without delay.

Samples are taken at t_k and arrive at t_k + d, d in [lo_i, hi_i] of their sensor i, in any order; on arrival the jumps
from their stamp on are made anew (`cdobs_cli.simulate.late`). At t let s be the first stamp of which a sample is
missing. Up to s the estimate is that of an observer without delays: just before s its error is bounded by what is
proved of that one. From s on

    e(t) = Phi(t, s_m) J_m .. Phi(s_2, s_1) J_1 e(s-) + noise and disturbance,    t <= s + hi of what is missing at s,

J_j the jump by those samples of s_j that are there (I where none is). Every such word is followed, with its missing and
arrived samples as the intervals of the delays allow; where samples keep their order the word is one flow. What an
estimate passes on arrival, computed again from the stamp on, is covered too.

Flow: edot = V(t) e, |V - A_c| <= R entrywise, M the Metzler majorant of A_c (its diagonal, |.| elsewhere). With
variation of constants, |exp(A_c r)| <= exp(M r), entrywise

    |Phi(r) - exp(A_c r)| <= E(r) = exp((M + R) r) - exp(M r),    integral of |Phi| over r <= Q(r),

E and Q blocks of exponentials of [[M, R], [0, M + R]] and [[M + R, I], [0, 0]]. In mean square, with norms
|x|_i = E(x_i^2)^(1/2) in place of |x_i|, the same holds by Minkowski's inequality, white d adds w with w_i^2 the
integral of (exp(A_c r) Q_d exp(A_c' r))_ii and by the resolvent Q(r) R w; delays do not depend on noise then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any, Literal

from flint import arb

from cdobs_cli.delays import Delay, longest
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, NoiseMaps, PlantView
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

MAX_FLOWS, MAX_WORK = 1500, 4_000_000  # from one stamp to the next, of all words; the same times N^3
CELLS = 24  # of the longest delay, over which an error is followed
Norm = Literal["size", "mean square"]
LateMaps = Callable[[PlantView[Any]], tuple[ErrorMaps[Any], NoiseMaps[Any]]]
TOO_MANY = "more samples than are followed are under way at a time"
UNBOUNDED = "the error grows beyond what balls enclose while samples are under way"


class NoBoundError(ValueError):
    """Why nothing is proved of a late estimate, in a sentence."""


@dataclass(frozen=True)
class Stop:
    """One stamp of the pattern: the sensors that are read there, and how long after it the next stamp comes."""

    sensors: tuple[int, ...]
    gap: tuple[Exact, Exact]


@dataclass(frozen=True)
class Jump:
    """The jump by some of the sensors: J (N, N), and how the noise enters, G (N, p)."""

    J: Matrix
    G: Matrix


@dataclass(frozen=True)
class Reach:
    """An error somewhere on a word: at most |X| b + |G_1| v + .. + D, with b that of before the word; X (N, N) and G
    (N, p) balls, D (N, 1) upper ends."""

    X: Matrix
    kicks: tuple[Matrix, ...]
    D: Matrix


@dataclass(frozen=True)
class Late:
    """The error system while samples are under way.

    center, radius, majorant: A_c, R, M (N, N). jumps: by phase and the sensors whose samples are there. n: the first
    states of N are the error; what follows is held from sample to sample. noise, disturbance (columns): how large v and
    d are, in the norm; intensity: of a white d in the error system, where that is the norm.
    """

    n: int
    center: Matrix
    radius: Matrix
    stops: tuple[Stop, ...]
    jumps: Callable[[int, tuple[int, ...]], Jump]
    delays: tuple[Delay, ...]
    noise: Matrix
    disturbance: Matrix
    intensity: Matrix | None = None

    @property
    def N(self) -> int:
        return self.center.shape[0]

    @property
    def majorant(self) -> Matrix:
        A = self.center.tolist()
        return Matrix.from_rows(
            [[arb(A[i][j]) if i == j else abs(arb(A[i][j])) for j in range(self.N)] for i in range(self.N)]
        )

    @property
    def quiet(self) -> Late:
        """Without disturbance and noise."""
        return replace(self, noise=self.noise * 0, disturbance=self.disturbance * 0, intensity=None)

    def errors(self, before: Sequence[arb]) -> tuple[arb, ...]:
        """Upper ends of the error at every time, from upper ends b of the error without delay, n components, in the
        norm. Raises: NoBoundError."""
        b = self._start(before)
        most = [one.upper() for one in before]
        for reach in self._reaches:
            size = reach.X @ b + reach.D
            for G in reach.kicks:
                size = size + G @ self.noise
            most = [one.max(arb(size[i, 0]).upper()) for i, one in enumerate(most)]
        if not all(one.is_finite() for one in most):
            raise NoBoundError(UNBOUNDED)
        return tuple(most)

    def _start(self, before: Sequence[arb]) -> Matrix:
        """b with what is held: of the last sample, |J| b + |G| v in those rows."""
        e = _column([one.upper() for one in before])
        if self.n == self.N:
            return e
        every = tuple(range(len(self.delays)))
        last, held = self.jumps(0, every), list(range(self.n, self.N))
        below = _sizes(last.J[held, list(range(self.n))]) @ e + _sizes(last.G)[held, :] @ self.noise
        return _column([*(arb(e[i, 0]) for i in range(self.n)), *(arb(one[0]).upper() for one in below.tolist())])

    @property
    def growth(self) -> arb:
        """g with |e(t)| <= g |e(s-)| (Euclidean) without disturbance and noise; of what is held the largest |e| of the
        last sample too. Raises: NoBoundError."""
        free, most = list(range(self.n)), arb(1)
        held = None
        if self.n < self.N:
            held = self.jumps(0, tuple(range(len(self.delays)))).J[list(range(self.n, self.N)), free]
        for reach in self._reaches:
            size = _norm(reach.X[free, free])
            if held is not None:
                size = size + _norm(reach.X[free, list(range(self.n, self.N))] @ _sizes(held))
            most = most.max(size.upper())
        if not most.is_finite():
            raise NoBoundError(UNBOUNDED)
        return most.upper()

    @cached_property
    def _reaches(self) -> list[Reach]:
        """Of every word, every cell of its flow: X and G as the largest sizes there. Raises: NoBoundError."""
        return list(self._followed())

    def _followed(self) -> Iterator[Reach]:
        flow, count, most = _Flow(self), 0, min(MAX_FLOWS, MAX_WORK // self.N**3)

        def counted(word: _Word) -> _Word:
            nonlocal count
            count += 1
            if count > most:
                raise NoBoundError(TOO_MANY)
            return word

        soonest = min((one.lower for one in self.delays), key=float)
        for q, stop in enumerate(self.stops):
            stack = [(q, EXACT_ZERO, counted(one)) for one in self._first(q, stop)]
            while stack:
                phase, g, word = stack.pop()
                gap = self.stops[phase].gap
                reach = flow.start if word.reach is None else word.reach
                reach = self._after(reach, self.jumps(phase, word.there))
                then, ends = g + gap[0], g + gap[1]
                if _is_above(then + soonest, word.latest):  # nothing further is there in time
                    yield from flow.along(reach, word.latest - g)
                    continue
                yield from flow.along(reach, gap[1] if ends.is_at_most(word.latest) else word.latest - g)
                following, arrived = (phase + 1) % len(self.stops), flow.over(reach, gap)
                for there, earliest, latest in self._choices(following, then, word.earliest, word.latest):
                    stack.append((following, then, counted(_Word(there, earliest, latest, arrived))))

    def _first(self, q: int, stop: Stop) -> Iterator[_Word]:
        """The words that begin at a stamp: something is missing there."""
        far = longest(self.delays)
        for there, earliest, latest in self._choices(q, EXACT_ZERO, EXACT_ZERO, far):
            missing = [i for i in stop.sensors if i not in there]
            if missing:  # and will arrive, so that what arrives last ends the word
                ends = min((self.delays[i].upper for i in missing), key=float)
                end = ends if ends.is_at_most(latest) else latest
                if end.sign() != 0 and not _is_above(earliest, end):
                    yield _Word(there, earliest, end, None)

    def _choices(
        self, q: int, g: Exact, earliest: Exact, latest: Exact
    ) -> Iterator[tuple[tuple[int, ...], Exact, Exact]]:
        """Which samples of a stamp g after the word's first one may be there, and between which times then. One that is
        lost never comes, but then the first one, which does, ends the word sooner: only a sensor alone loses any."""
        sensors = self.stops[q].sensors
        for which in product((True, False), repeat=len(sensors)):
            there = tuple(i for i, is_there in zip(sensors, which, strict=True) if is_there)
            low, high = earliest, latest
            for i, is_there in zip(sensors, which, strict=True):
                if is_there and not (at := g + self.delays[i].lower).is_at_most(low):
                    low = at
                elif not is_there and not high.is_at_most(end := g + self.delays[i].upper):
                    high = end
            if not _is_above(low, high):
                yield there, low, high

    def _after(self, reach: Reach, jump: Jump) -> Reach:
        kicks = tuple(jump.J @ G for G in reach.kicks)
        own = () if all(value == 0 for row in jump.G.tolist() for value in row) else (jump.G,)
        return Reach(jump.J @ reach.X, (*kicks, *own), _upper(_sizes(jump.J) @ reach.D))


@dataclass(frozen=True)
class _Word:
    """What of the present stamp is there, the times after the first one that allow for the choices so far, and where
    the error is just before the stamp (None: at the beginning)."""

    there: tuple[int, ...]
    earliest: Exact
    latest: Exact
    reach: Reach | None


class _Flow:
    """The error between stamps, in balls."""

    def __init__(self, late: Late) -> None:
        self.late, N = late, late.N
        A, M, R = late.center, late.majorant, late.radius
        self.A, none, eye = A, Matrix.zeros(N, N), Matrix.identity(N)
        self.W, self.S = block([[M, R], [none, M + R]]), block([[M + R, eye], [none, none]])
        self.start = Reach(eye.balls(), (), Matrix.zeros(N, 1).balls())
        self.h = longest(late.delays).ball() / CELLS
        self.first, self.last = list(range(N)), list(range(N, 2 * N))
        # exp(A_c rho) for |rho| <= h/2 is at most exp(|A_c| h/2), and so is that of W.
        half = self.h / 2
        self.near, self.near_W = (_upper(_sizes(one).exp(half)) for one in (A, self.W))
        self.cells: dict[int, tuple[Matrix, Matrix, Matrix]] = {}

    def _cell(self, k: int) -> tuple[Matrix, Matrix, Matrix]:
        """exp(A_c r) in the middle of cell k, E all over it, and what disturbance adds until its end."""
        if k not in self.cells:
            r = self.h * (2 * k + 1) / 2
            E = _upper((_sizes(self.W.exp(r)) @ self.near_W)[self.first, self.last])
            self.cells[k] = self.A.exp(r), E, self._driven(self.h * (k + 1))
        return self.cells[k]

    def _driven(self, r: arb) -> Matrix:
        """What the disturbance adds over [0, r], upper ends (N, 1)."""
        late = self.late
        Q = _upper(self.S.exp(r)[self.first, self.last])
        total = Q @ late.disturbance
        if late.intensity is not None:
            white = _white(self.A, late.intensity, r)
            total = total + white + Q @ late.radius @ white
        return _upper(total)

    def along(self, reach: Reach, length: Exact) -> Iterator[Reach]:
        """All over a flow of this length, cell by cell."""
        end, k = length.ball().upper(), 0
        while k == 0 or not self.h * k >= end:
            Phi, E, D = self._cell(k)
            columns = (self._near(Phi, E, one) for one in (reach.X, *reach.kicks))
            X, *kicks = columns
            size = _upper(self.near @ _sizes(Phi) + E)
            yield Reach(X, tuple(kicks), _upper(size @ reach.D + D))
            k += 1

    def _near(self, Phi: Matrix, E: Matrix, X: Matrix) -> Matrix:
        """Sizes of Phi(r) X all over a cell."""
        return _upper(self.near @ _sizes(Phi @ X) + E @ _sizes(X))

    def over(self, reach: Reach, gap: tuple[Exact, Exact]) -> Reach:
        """At the end of a flow whose length lies in this interval."""
        low, high = (one.ball() for one in gap)
        r = low if gap[0] == gap[1] else low.union(high)
        Phi, E = self.A.exp(r), _upper(_sizes(self.W.exp(r))[self.first, self.last])
        X, *kicks = (_widened(Phi @ one, E @ _sizes(one)) for one in (reach.X, *reach.kicks))
        return Reach(X, tuple(kicks), _upper((_sizes(Phi) + E) @ reach.D + self._driven(high.upper())))


def _white(A: Matrix, Q: Matrix, r: arb) -> Matrix:
    """Roots of the diagonal of the integral of exp(A s) Q exp(A' s) over [0, r], by Van Loan's block exponential."""
    N = A.shape[0]
    F = block([[A * -1, Q], [Matrix.zeros(N, N), A.T]]).exp(r)
    first, last = list(range(N)), list(range(N, 2 * N))
    total = F[last, last].T @ F[first, last]
    return _column([arb(total[i, i]).max(arb(0)).upper().sqrt().upper() for i in range(N)])


def _sizes(M: Matrix) -> Matrix:
    """|.| of every entry, upper ends."""
    return Matrix.from_rows([[abs(arb(value)).upper() for value in row] for row in M.tolist()])


def _upper(M: Matrix) -> Matrix:
    """Upper ends of entries that are not negative."""
    return Matrix.from_rows([[arb(value).upper() for value in row] for row in M.tolist()])


def _widened(M: Matrix, by: Matrix) -> Matrix:
    """Balls that hold every matrix so near to M."""
    rows = zip(M.tolist(), by.tolist(), strict=True)
    return Matrix.from_rows([[arb(a) + arb(0, arb(b).upper()) for a, b in zip(*pair, strict=True)] for pair in rows])


def _column(values: Sequence[arb]) -> Matrix:
    return Matrix.from_rows([[value] for value in values]).balls()


def _norm(M: Matrix) -> arb:
    """An upper end of the spectral norm: the root of the largest row sum times the largest column sum."""
    rows = _sizes(M).tolist()
    sums = [[sum(line, arb(0)) for line in lines] for lines in (rows, zip(*rows, strict=True))]
    by_rows, by_columns = (max((arb(one).upper() for one in line), key=float) for line in sums)
    return (by_rows * by_columns).sqrt().upper()


def _is_above(a: Exact, b: Exact) -> bool:
    """Whether a > b for certain."""
    return (a - b).sign() == 1


def late_error(inclusion: HybridInclusion, maps: LateMaps, norm: Norm = "size") -> Late:
    """The error of an inclusion whose plant's measurements arrive late. maps: error and noise over states of which a
    sample that has not arrived changes none, as of a family with a constant gain."""
    plant, law = inclusion.plant, inclusion.sampling
    view = PlantView.balls(plant, {})
    gains = inclusion.phase_gains if law.is_multirate else [dict(inclusion.gain)]
    known: dict[tuple[int, tuple[int, ...]], Jump] = {}

    def jump(q: int, there: tuple[int, ...]) -> Jump:
        if (q, there) not in known:
            known[q, there] = _jump(plant, view, gains[q], there, maps)
        return known[q, there]

    flow = maps(replace(view, gain={name: _columns_of(K, None).balls() for name, K in gains[0].items()}))
    errors, acting = flow
    center, radius = errors.base.balls(), errors.base.balls() * 0
    for part, low, high in zip(errors.parts, errors.lower, errors.upper, strict=True):
        center = center + part * (arb(low) / 2 + arb(high) / 2)
        radius = radius + _sizes(part) * (arb(high) - arb(low)).upper() / 2
    B = acting.drive.balls()
    return Late(
        plant.n, center, _upper(radius), _stops(plant, law), jump, plant.delays,
        _noise_sizes(plant, norm), _upper(_sizes(B) @ _column(_sizes_of(plant.disturbance, plant.n))),
        None if plant.intensity is None or norm == "size" else B @ plant.intensity.balls() @ B.T,
    )  # fmt: skip


def _jump(
    plant: Plant, view: PlantView[Any], gain: dict[str, ExactMatrix], there: tuple[int, ...], maps: LateMaps
) -> Jump:
    """By the samples of some sensors; by none the identity."""
    outputs = frozenset(k for i in there for k in plant.delays[i].outputs)
    own = {name: _columns_of(K, outputs).balls() for name, K in gain.items()}
    errors, acting = maps(replace(view, gain=own))
    if not there:
        return Jump(Matrix.identity(errors.base.shape[0]).balls(), acting.kick.balls() * 0)
    J = errors.jump.balls()
    for part, low, high in zip(errors.jump_parts, errors.jump_lower, errors.jump_upper, strict=True):
        J = _widened(J, _sizes(part) * ((arb(high) - arb(low)) / 2).upper())
    return Jump(J, acting.kick.balls())


def _columns_of(K: ExactMatrix, outputs: frozenset[int] | None) -> ExactMatrix:
    """A gain with 0 in the columns of the other outputs; None: as it is."""
    if outputs is None:
        return K
    return ExactMatrix([[value if k in outputs else EXACT_ZERO for k, value in enumerate(row)] for row in K.rows])


def _stops(plant: Plant, law: SamplingLaw) -> tuple[Stop, ...]:
    numbers = {one.name: i for i, one in enumerate(plant.delays)}
    if law.is_multirate:
        pairs = zip(law.phases, law.gaps, strict=True)
        return tuple(Stop(tuple(numbers[one.name] for one in phase.sensors), (gap, gap)) for phase, gap in pairs)
    # Samples that may be lost: every period one that is there, missing or lost.
    high = law.T_min if law.is_lossy else law.T_max
    return (Stop(tuple(range(len(plant.delays))), (law.T_min, high)),)


def _sizes_of(box: Box | None, count: int) -> list[arb]:
    return [arb(0)] * count if box is None else [arb(one).upper() for one in box.sizes]


def _noise_sizes(plant: Plant, norm: Norm) -> Matrix:
    """How large each component of v is in the norm: at most, or the root of its mean square."""
    sizes = _sizes_of(plant.noise, plant.p)
    if plant.covariance is not None and norm == "mean square":
        sizes = [plant.covariance[k, k].ball().max(arb(0)).sqrt().upper() for k in range(plant.p)]
    return _column(sizes)
