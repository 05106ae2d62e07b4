"""A box that holds every transition matrix of edot = (A + V(t)) e, V in its box, for any structure.

Column j of Phi_V starts from a_j. Its ends m- <= Phi_V a_j <= m+ solve, component by component,

    dm+_k/dt = max{u m+_k} + sum_(l != k) max{v m : v in U_kl, m in [m-_l, m+_l]},    u in U_kk,
    dm-_k/dt = min{u m-_k} + sum_(l != k) min{v m : v in U_kl, m in [m-_l, m+_l]},

with U = A + [lower, upper]: Mueller's comparison theorem (the right hand sides are Lipschitz, and component k
is taken at its own end). For upper triangular A and V this is the iteration of Lemma III.1, from the last
state up, with two functions per entry.

The right hand side is linear between the instants where a minimum or maximum changes its branch. A step
whose branches are all decided is a linear equation with constant coefficients; the others are as short as
allowed, and enclosed for every branch. All in balls.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

from flint import arb

from cdobs_cli.exact.functions import fraction_ball, hull
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.records import dataclass

TERMS = 24
SHORTEST = Fraction(1, 2**28)  # of the longest step
MAX_STEPS = 500
PASSES = 4
EXPANDED = 8
NEGLIGIBLE = arb(2) ** -46

Difference = Callable[[arb, int, arb, int], arb]


@dataclass(frozen=True)
class Entry:
    """U_kl = [low, up]; `centred` where low = -up exactly."""

    low: arb
    up: arb
    centred: bool


@dataclass(frozen=True)
class Bounds:
    """The bounding system of one column, for the components that its start reaches.

    X stacks m- and m+. `even` are the components with m- = -m+ for ever, by the pattern of U alone.
    """

    entries: dict[tuple[int, int], Entry]
    components: tuple[int, ...]
    even: frozenset[int]

    @property
    def constant(self) -> bool:
        """Whether no entry varies: m- = m+."""
        return all(entry.low is entry.up for entry in self.entries.values())

    def lipschitz(self) -> arb:
        """A Lipschitz constant of the right hand side, in the maximum norm."""
        largest = arb(0)
        for k in self.components:
            row = arb(0)
            for i in self.components:
                if (k, i) in self.entries:
                    row += self.entries[k, i].low.abs_upper().max(self.entries[k, i].up.abs_upper())
            largest = largest.max(row.upper())
        return (largest * (1 + arb(2) ** -60)).upper()

    def slope(self, piece: list[arb], difference: Difference, negligible: arb) -> tuple[Matrix, arb, bool]:
        """G and f with |dX/dt - G X| <= f wherever X stays in `piece`, and whether every branch that matters
        is decided. `difference(p, x, q, y)` encloses p X_x - q X_y there."""
        size = len(self.components)
        G = [[arb(0) for _ in range(2 * size)] for _ in range(2 * size)]
        forcing = [arb(0)] * (2 * size)
        decided = True

        def choose(row: int, test: arb, first: tuple[int, arb], second: tuple[int, arb]) -> bool:
            """Add factor * X_index of the first pair where test >= 0, of the second where test <= 0."""
            if test >= 0 or (first[0] == second[0] and first[1] is second[1]):
                G[row][first[0]] += first[1]
            elif test <= 0:
                G[row][second[0]] += second[1]
            else:
                if first[0] == second[0]:
                    G[row][first[0]] += hull(first[1], second[1])
                else:
                    G[row][first[0]] += first[1]
                    forcing[row] += test.abs_upper()
                return bool(test.abs_upper() <= negligible)
            return True

        for a, k in enumerate(self.components):
            for b, i in enumerate(self.components):
                entry = self.entries.get((k, i))
                if entry is None:
                    continue
                low, up, minus, plus = entry.low, entry.up, b, size + b
                m_low, m_up = piece[minus], piece[plus]
                if k == i or low >= 0:
                    decided &= choose(size + a, m_up, (plus, up), (plus, low))
                    decided &= choose(a, m_low, (minus, low), (minus, up))
                elif up <= 0:
                    decided &= choose(size + a, m_low, (minus, up), (minus, low))
                    decided &= choose(a, m_up, (plus, low), (plus, up))
                else:
                    # max{up m+, low m-} and min{low m+, up m-}; both products agree where all is even.
                    tie = entry.centred and i in self.even
                    decided &= choose(
                        size + a, arb(0) if tie else difference(up, plus, low, minus), (plus, up), (minus, low)
                    )
                    decided &= choose(a, arb(0) if tie else difference(up, minus, low, plus), (plus, low), (minus, up))
        return Matrix.from_rows(G), max(forcing, key=float).upper(), decided


def lemma_3_1(plant: Plant, delta: arb) -> IntervalMatrix | None:
    """The box that holds every Phi_V(delta); None where it could not be enclosed.

    Source: Dinh2014, Lemma III.1, Theorem III.1
    Deviates: the printed Gamma* fixes u^1 and u^2 along s; the inclusion (12) is then false where (v'M)_j
    changes its sign (A = [[0, 1, 0.3], [0, 0, -1], [0, 0, 0]], c_11 = 1, delta = 1). Here the extreme u is
    taken at each instant; any structure is allowed.
    """
    n = plant.n
    columns = columns_of(plant.A, plant.slopes)
    zero = arb(0)
    lower = [[zero] * n for _ in range(n)]
    upper = [list(row) for row in lower]
    for j, column in enumerate(columns or ()):
        X = column.at(delta)
        if X is None:
            return None
        size = len(column.bounds.components)
        for a, k in enumerate(column.bounds.components):
            lower[k][j] = X[a]
            upper[k][j] = X[a] if column.bounds.constant else X[size + a]
    return IntervalMatrix.between(lower, upper) if columns is not None else None


@lru_cache(maxsize=4)
def columns_of(A: ExactMatrix, slopes: Slopes) -> tuple[Column, ...] | None:
    """The columns of the bounding system, kept for the next period; None where the sign of an end is open."""
    entries = bounds_of_entries(A, slopes)
    if entries is None:
        return None
    return tuple(Column(_bounds(entries, j), j) for j in range(A.shape[0]))


def bounds_of_entries(A: ExactMatrix, slopes: Slopes) -> dict[tuple[int, int], Entry] | None:
    """U_kl = A_kl + [lower_kl, upper_kl] where it is not the number 0; None where the sign of an end is open."""
    entries = {}
    n = A.shape[0]
    for k in range(n):
        for i in range(n):
            low = A[k, i] + slopes.lower[k, i]
            up = A[k, i] + slopes.upper[k, i]
            if low == up == EXACT_ZERO:
                continue
            if low.sign() is None or up.sign() is None:
                return None
            ball = low.ball()
            entries[k, i] = Entry(ball, ball if low == up else up.ball(), _opposite(low, up))
    return entries


def _opposite(low: Exact, up: Exact) -> bool:
    return low.rational is not None and up.rational is not None and low.rational == -up.rational


def _bounds(entries: dict[tuple[int, int], Entry], start: int) -> Bounds:
    reached = {start}
    while more := {k for k, i in entries if i in reached} - reached:
        reached |= more
    even = reached - {start}
    while odd := {k for k in even if any(
        not entries[k, i].centred and i not in even for i in reached if i != k and (k, i) in entries
    )}:  # fmt: skip
        even -= odd
    return Bounds(
        {pair: entry for pair, entry in entries.items() if set(pair) <= reached},
        tuple(sorted(reached)),
        frozenset(even),
    )


class Column:
    """X along time from the unit vector of one state, by steps as long as the branches stay decided.

    Steps are kept: a later question continues from the last one before it."""

    def __init__(self, bounds: Bounds, start: int) -> None:
        self.bounds = bounds
        self.L = bounds.lipschitz()
        unit = [arb(int(k == start)) for k in bounds.components]
        self.times = [Fraction(0)]
        self.states = [unit + list(unit)]
        size = float(self.L) if self.L.is_finite() else 0.0
        self.longest = Fraction(1) if size == 0.0 else 1 / (2 * Fraction(size) * (1 + Fraction(1, 10**6)))
        self.shortest = self.longest * SHORTEST
        self.length = self.shortest

    def at(self, delta: arb) -> list[arb] | None:
        """X(delta), enclosed; None where that takes too many steps."""
        if not (self.L.is_finite() and delta.is_finite() and self.L * delta < MAX_STEPS / 2):
            return None
        while len(self.times) < MAX_STEPS:
            length = min(self.length, self.longest)
            if not fraction_ball(self.times[-1] + length) <= delta:
                break
            X, decided = self._step(self.states[-1], fraction_ball(length))
            if not decided and length > self.shortest:
                self.length = max(length / 2, self.shortest)
                continue
            self.times.append(self.times[-1] + length)
            self.states.append(X)
            self.length = length * 2
        if len(self.times) >= MAX_STEPS and fraction_ball(self.times[-1] + self.longest) < delta:
            return None
        last = max(k for k, time in enumerate(self.times) if k == 0 or fraction_ball(time) <= delta)
        return self._finish(self.states[last], delta - fraction_ball(self.times[last]))

    def _finish(self, X: list[arb], rest: arb) -> list[arb] | None:
        """What is left after the last kept step."""
        done, length = Fraction(0), self.longest
        for _ in range(MAX_STEPS):
            whole = not fraction_ball(done + length) < rest
            after, decided = self._step(X, rest - fraction_ball(done) if whole else fraction_ball(length))
            if not decided and length > self.shortest:
                length = max(length / 2, self.shortest)
            elif whole:
                return after if all(value.is_finite() for value in after) else None
            else:
                X, done, length = after, done + length, length * 2
        return None

    def _step(self, X: list[arb], h: arb) -> tuple[list[arb], bool]:
        """X after h, and whether every branch that matters was decided."""
        bounds, L = self.bounds, self.L
        size_X = max((value.abs_upper() for value in X), key=float)
        # Whatever the branches are, X moves by at most (exp(L h) - 1) |X|; then by the series of every branch.
        drift = ((L * h).exp() - 1).upper() * size_X
        piece = [value + hull(-drift, drift) for value in X]
        negligible = NEGLIGIBLE * size_X
        G, forcing, decided = bounds.slope(piece, lambda p, x, q, y: p * piece[x] - q * piece[y], negligible)
        elapsed = hull(arb(0), h.upper())
        # Each round gains a power of h: small components need some to show their sign.
        for _ in range(PASSES):
            piece = _series(G, X, elapsed, L, h, size_X, forcing)
            G, forcing, decided = bounds.slope(
                piece, _expansion(G, X, piece, elapsed, ((L * h).exp() * h * forcing).upper()), negligible
            )
            if decided:
                break
        after = _series(G, X, h, L, h, size_X, forcing)
        for a, k in enumerate(bounds.components):
            if k in bounds.even:
                after[a] = -after[len(bounds.components) + a]
        return after, decided


def _expansion(G: Matrix, X: list[arb], piece: list[arb], elapsed: arb, slack: arb) -> Difference:
    """p X_x - q X_y over the step: row vectors g G^k first, so that what cancels does, at X, and the last on
    `piece`. `slack` is what the forcing adds to a component."""
    matrix = G.arb
    start, later = (Matrix.from_rows([[value] for value in values]).arb for values in (X, piece))
    size = len(X)

    def difference(p: arb, x: int, q: arb, y: int) -> arb:
        g = Matrix.from_rows([[(p if i == x else arb(0)) - (q if i == y else arb(0)) for i in range(size)]]).arb
        total = hull(-slack, slack) * (abs(p) + abs(q))
        power = arb(1)
        for k in range(EXPANDED):
            total = total + (g * start)[0, 0] * power
            g, power = g * matrix, power * elapsed / (k + 1)
        return total + (g * later)[0, 0] * power

    return difference


def _series(G: Matrix, X: list[arb], s: arb, L: arb, h: arb, size: arb, forcing: arb) -> list[arb]:
    """X after s in [0, h] for |dX/dt - G(t) X| <= forcing, G(t) anywhere in the ball matrix: the iterated
    integrals, whose k-th term lies in G^k X s^k / k!, the tail of the series, and what the forcing adds."""
    matrix = G.arb
    term = Matrix.from_rows([[value] for value in X]).arb
    total = term
    for k in range(1, TERMS + 1):
        term = matrix * term * (s / k)
        total = total + term
    Lh = (L * h).upper()
    tail = (Lh.exp() * (Lh ** (TERMS + 1) / arb(TERMS + 1).gamma() * size + forcing * h)).upper()
    slack = hull(-tail, tail)
    return [total[i, 0] + slack for i in range(len(X))]
