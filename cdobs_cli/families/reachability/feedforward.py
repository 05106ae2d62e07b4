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

from dataclasses import dataclass
from fractions import Fraction

from flint import arb

from cdobs_cli.exact.functions import hull
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.plant import Plant

TERMS = 24
SHORTEST = Fraction(1, 2**36)
MAX_STEPS = 3000
NEGLIGIBLE = arb(2) ** -46


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

    def lipschitz(self) -> arb:
        """A Lipschitz constant of the right hand side, in the maximum norm."""
        largest = arb(0)
        for k in self.components:
            row = arb(0)
            for i in self.components:
                if (k, i) in self.entries:
                    row += self.entries[k, i].low.abs_upper().max(self.entries[k, i].up.abs_upper())
            largest = largest.max(row.upper())
        return largest

    def slope(self, piece: list[arb], negligible: arb) -> tuple[Matrix, arb, bool]:
        """G and f with |dX/dt - G X| <= f wherever X stays in `piece`, and whether every branch that matters
        is decided."""
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
                    decided &= choose(size + a, arb(0) if tie else up * m_up - low * m_low, (plus, up), (minus, low))
                    decided &= choose(a, arb(0) if tie else up * m_low - low * m_up, (plus, low), (minus, up))
        return Matrix.from_rows(G), max(forcing, key=float).upper(), decided


def lemma_3_1(plant: Plant, delta: arb) -> IntervalMatrix | None:
    """The box that holds every Phi_V(delta); None where it could not be enclosed.

    Source: Dinh2014, Lemma III.1, Theorem III.1
    Deviates: the printed Gamma* fixes u^1 and u^2 along s; the inclusion (12) is then false where (v'M)_j
    changes its sign (A = [[0, 1, 0.3], [0, 0, -1], [0, 0, 0]], c_11 = 1, delta = 1). Here the extreme u is
    taken at each instant; any structure is allowed.
    """
    n = plant.n
    entries = bounds_of_entries(plant)
    columns = [_advance(_bounds(entries, n, j), j, delta) for j in range(n)]
    lower = [[arb(0)] * n for _ in range(n)]
    upper = [list(row) for row in lower]
    for j, column in enumerate(columns):
        if column is None:
            return None
        components, X = column
        constant = all(entries[k, i].low is entries[k, i].up for k in components for i in components if (k, i) in entries)
        for a, k in enumerate(components):
            lower[k][j] = X[a]
            upper[k][j] = X[a] if constant else X[len(components) + a]
    zero = arb(0)
    for j, column in enumerate(columns):
        for k in range(n):
            if column is not None and k not in column[0]:
                lower[k][j] = upper[k][j] = zero
    return IntervalMatrix.between(lower, upper)


def bounds_of_entries(plant: Plant) -> dict[tuple[int, int], Entry]:
    """U_kl = A_kl + [lower_kl, upper_kl] where it is not the number 0."""
    entries = {}
    for k in range(plant.n):
        for i in range(plant.n):
            low = plant.A[k, i] + plant.slopes.lower[k, i]
            up = plant.A[k, i] + plant.slopes.upper[k, i]
            if low == up == EXACT_ZERO:
                continue
            ball = low.ball()
            entries[k, i] = Entry(ball, ball if low == up else up.ball(), _opposite(low, up))
    return entries


def _opposite(low: Exact, up: Exact) -> bool:
    return low.rational is not None and up.rational is not None and low.rational == -up.rational


def _bounds(entries: dict[tuple[int, int], Entry], n: int, start: int) -> Bounds:
    reached = {start}
    while more := {k for k, i in entries if i in reached} - reached:
        reached |= more
    even = reached - {start}
    while odd := {k for k in even if any(
        not entries[k, i].centred and i not in even for i in reached if i != k and (k, i) in entries
    )}:  # fmt: skip
        even -= odd
    return Bounds({pair: entry for pair, entry in entries.items() if set(pair) <= reached}, tuple(sorted(reached)), frozenset(even))


def _advance(bounds: Bounds, start: int, delta: arb) -> tuple[tuple[int, ...], list[arb]] | None:
    """X(delta) from the unit vector, by steps as long as the branches stay decided."""
    size = len(bounds.components)
    unit = [arb(int(k == start)) for k in bounds.components]
    X = unit + list(unit)
    end = delta.upper()
    L = bounds.lipschitz()
    if not (end.is_finite() and L.is_finite()):
        return None
    if not 2 * L * end < MAX_STEPS:
        return None
    longest = 1 / (2 * Fraction(float((L * end).upper())) + 2)
    done, share = Fraction(0), SHORTEST
    for _ in range(MAX_STEPS):
        if done == 1:
            return bounds.components, X
        share = min(share, longest, 1 - done)
        h = delta * _ball(share)
        size_X = max((value.abs_upper() for value in X), key=float)
        everything = Matrix.from_rows([[hull(arb(0), h.upper())]])[0, 0]
        # Whatever the branches are, X moves by at most (exp(L h) - 1) |X|; then by the series of every branch.
        drift = ((L * h).exp() - 1).upper() * size_X
        piece = [value + hull(-drift, drift) for value in X]
        negligible = NEGLIGIBLE * size_X
        G, forcing, _ = bounds.slope(piece, negligible)
        piece = _series(G, X, everything, L, h, size_X, forcing)
        G, forcing, decided = bounds.slope(piece, negligible)
        if not decided and share > SHORTEST:
            share /= 2
            continue
        X = _series(G, X, h, L, h, size_X, forcing)
        if not all(value.is_finite() for value in X):
            return None
        for a, k in enumerate(bounds.components):
            if k in bounds.even:
                X[a] = -X[size + a]
        done += share
        share *= 2
    return None


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


def _ball(value: Fraction) -> arb:
    return arb(value.numerator) / arb(value.denominator)
