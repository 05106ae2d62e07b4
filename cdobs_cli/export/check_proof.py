"""Checks proof.json, beside this file, with fractions and the standard library alone: python check_proof.py [FILE]

The error e = x_hat - x of the observer obeys, for every plant whose slopes stay in the intervals of the file,

    edot = (A + sum_k v_k(t) part_k) e - d,  v_k(t) in [lower_k, upper_k];    e+ = (I - K H) e + K v    at samples

("corrected": a copy corrected at samples), with H = C + sum_m w_m part_m; or, with the innovation held between samples
("held"), over (e, w), w = C (e - e(t_k)) + v_k,

    d/dt (e, w) = [[F, L], [C F, C L]] (e, w) - [d; C d],  F = A + sum_k v_k part_k - L C;    (e, w)+ = (e, v).

That phi has these slopes is taken from the file; everything else is shown here. Certificates hold functions e'P(tau)e
of the time tau since the last sample, P piecewise polynomial, by Bernstein coefficients on each piece: a polynomial
whose coefficients are positive definite is. Those by method set hold one at samples; matrices that hold all transitions
over a period are found here. The exit code is 1 where something is refused.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import reduce
from itertools import product
from math import ceil, floor, lcm
from pathlib import Path
from typing import Any

FINE = 2**160  # intervals end at multiples of 1 / FINE


class RefusedError(Exception):
    """What is wrong with a proof."""


def require(holds: object, what: str) -> None:
    if not holds:
        raise RefusedError(what)


def number(text: Any) -> Fraction:
    require(isinstance(text, str) and re.fullmatch(r"-?[0-9]{1,4000}(/[1-9][0-9]{0,4000})?", text), "no fraction")
    return Fraction(text)


def numbers(value: Any, size: int) -> list[Fraction]:
    return [number(text) for text in listed(value, size)]


def count(value: Any, least: int = 0) -> int:
    require(type(value) is int and least <= value <= 1000, "no number of pieces, degrees or steps")
    return int(value)


def listed(value: Any, size: int | None = None) -> list[Any]:
    require(isinstance(value, list) and (size is None or len(value) == size), "a list of another length")
    return list(value)


def dot(row: list[Fraction], other: list[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(row, other, strict=True)), Fraction(0))


class Matrix:
    """Rows of fractions, or of intervals; of no columns too."""

    def __init__(self, rows: Iterable[Iterable[Any]]) -> None:
        self.rows = [list(row) for row in rows]

    @staticmethod
    def read(rows: Any, n: int, m: int) -> Matrix:
        return Matrix(numbers(row, m) for row in listed(rows, n))

    @staticmethod
    def symmetric(rows: Any, n: int) -> Matrix:
        """From the upper triangle, each row from the diagonal on."""
        upper = [numbers(row, n - i) for i, row in enumerate(listed(rows, n))]
        return Matrix([upper[min(i, j)][abs(i - j)] for j in range(n)] for i in range(n))

    @staticmethod
    def diagonal(values: Sequence[Fraction | int]) -> Matrix:
        return Matrix([Fraction(value * (i == j)) for j in range(len(values))] for i, value in enumerate(values))

    @staticmethod
    def block(grid: list[list[Matrix]]) -> Matrix:
        return Matrix([x for part in row for x in part.rows[i]] for row in grid for i in range(len(row[0].rows)))

    @property
    def T(self) -> Matrix:
        return Matrix(zip(*self.rows, strict=True))

    def each(self, change: Callable[[Any], Any]) -> Matrix:
        return Matrix(map(change, row) for row in self.rows)

    def __add__(self, other: Matrix) -> Matrix:
        pairs = zip(self.rows, other.rows, strict=True)
        return Matrix([a + b for a, b in zip(row, more, strict=True)] for row, more in pairs)

    def __mul__(self, factor: Any) -> Matrix:
        return self.each(lambda x: x * factor)

    def __sub__(self, other: Matrix) -> Matrix:
        return self + other * -1

    def __matmul__(self, other: Matrix) -> Matrix:
        columns = list(zip(*other.rows, strict=True))
        rows = [[(k, x) for k, x in enumerate(row) if x] for row in self.rows]
        return Matrix([sum((x * column[k] for k, x in row), Fraction(0)) for column in columns] for row in rows)

    def columns(self, places: Sequence[int]) -> Matrix:
        return Matrix([row[j] for j in places] for row in self.rows)

    def part(self, places: Sequence[int]) -> Matrix:
        return self.columns(places).T.columns(places).T

    def require_definite(self, what: str = "what e'Pe falls by at a sample") -> None:
        """Every leading minor is positive: integers, eliminated without fractions (Bareiss)."""
        n, scale = len(self.rows), lcm(*(x.denominator for row in self.rows for x in row))
        rows, before = [[int(x * scale) for x in row] for row in self.rows], 1
        require(all(rows[i][j] == rows[j][i] for i in range(n) for j in range(i)), "a form that is not symmetric")
        for k in range(n):
            require(rows[k][k] > 0, f"{what} is not positive definite")
            for i in range(k + 1, n):
                for j in range(k + 1, n):
                    rows[i][j] = (rows[i][j] * rows[k][k] - rows[i][k] * rows[k][j]) // before
            before = rows[k][k]


def elevated(p: list[Matrix], D: int) -> list[Matrix]:
    """The Bernstein coefficients of the same polynomial in degree D."""
    while (d := len(p)) <= D:
        p = [p[0], *(p[i - 1] * Fraction(i, d) + p[i] * (1 - Fraction(i, d)) for i in range(1, d)), p[-1]]
    return p


class System:
    """The error: corners of flow and jump, how disturbance (B) and noise (G) enter it, and how large they are."""

    def __init__(self, plant: Any, gain: Any, kind: Any) -> None:
        n, p = len(listed(plant["states"])), len(listed(plant["C"]))
        eye, C, K = Matrix.diagonal([1] * n), Matrix.read(plant["C"], p, n), Matrix.read(gain, n, p)
        flows, H = corners(Matrix.read(plant["A"], n, n), plant["slopes"]), corners(C, plant["outputs"])
        require(kind == "corrected" or (kind == "held" and len(H) == 1), "an observer of another kind")
        if kind == "corrected":
            self.flows, self.jumps, drive, kick = flows, [eye - K @ one for one in H], eye, K
        else:
            self.flows = [Matrix.block([[F, K], [C @ F, C @ K]]) for F in (one - K @ C for one in flows)]
            self.jumps = [Matrix.diagonal([i < n for i in range(n + p)])]
            drive, kick = Matrix.block([[eye], [C]]), Matrix.diagonal([1] * (n + p)).columns(range(n, n + p))
        self.n, self.N = n, len(self.flows[0].rows)
        self.B, self.d0, self.d2 = driven(drive * -1, plant["disturbance"])
        self.G, self.v0, self.v2 = driven(kick, plant["noise"])
        self.drift = drive @ Matrix.symmetric(plant["intensity"], n) @ drive.T
        self.spread = kick @ Matrix.symmetric(plant["covariance"], p) @ kick.T


def corners(middle: Matrix, varying: Any) -> list[Matrix]:
    """At all ends of what varies; `middle` is without it."""
    made, n, m = [middle], len(middle.rows), len(middle.rows[0])
    require(len(listed(varying)) <= 10, "too much that varies")
    for one in varying:
        part, low, high = Matrix.read(one["part"], n, m), number(one["lower"]), number(one["upper"])
        require(low <= high, "an interval whose ends are exchanged")
        made = [M + part * value for M in made for value in (low, high)]
    return made


def driven(through: Matrix, texts: Any) -> tuple[Matrix, list[Fraction], list[Fraction]]:
    """The columns of bounded signals that are not 0, how large these are, and the squares of that."""
    sizes = numbers(texts, len(through.rows[0]))
    require(min(sizes) >= 0, "a size below 0")
    kept = [k for k, size in enumerate(sizes) if size]
    return through.columns(kept), [sizes[k] for k in kept], [sizes[k] ** 2 for k in kept]


class Law:
    """t_(k+1) - t_k: one number, any in [T_min, T_max], or multiples of T_min; each sample lost with probability p."""

    def __init__(self, told: Any) -> None:
        self.low, self.high, self.lost = number(told["T_min"]), number(told["T_max"]), count(told["lost"])
        self.p = number(told["probability"])
        require(0 <= self.low <= self.high > 0 and 0 <= self.p < 1 and not self.lost * self.p, "no law of samples")
        require(self.high == (self.lost + 1) * self.low or not (self.lost or self.p), "losses of another law")
        self.is_plain = self.low > 0 and not self.lost and not self.p
        lost = f", at most {self.lost} in a row lost" * bool(self.lost) + f", lost with probability {self.p}" * bool(
            self.p
        )
        self.told = f"samples {float(self.low):.9g} to {float(self.high):.9g} apart{lost}"


class Pieces:
    """P(tau) with pieces of equal length on [0, a] and on [a, b]; `tail` are the coefficients on [a, b]."""

    def __init__(self, degrees: Any, pieces: Any, start: Fraction, end: Fraction, P: Any, N: int) -> None:
        (self.d, self.D), (self.before, after) = (count(one, 1) for one in degrees), map(count, pieces)
        require(self.d <= self.D <= 64 and 0 <= start <= end and end > 0, "no pieces")
        require((self.before == 0) == (start == 0) and (after == 0) == (start == end), "pieces leave a gap")
        self.lengths = [start / max(self.before, 1)] * self.before + [(end - start) / max(after, 1)] * after
        self.P = [Matrix.symmetric(one, N) for one in listed(P, len(self.lengths) * self.d + 1)]
        self.tail = self.P[self.before * self.d :]

    def require_fall(self, flows: list[Matrix], add: Matrix, B: Matrix, mu: Sequence[list[Fraction]] = ()) -> None:
        """-(Pdot + P A + A'P + add) > 0 at all corners; with mu of each piece [[that, -P B], [., diag(mu)]]."""
        for j, h in enumerate(self.lengths):
            p = self.P[j * self.d : (j + 1) * self.d + 1]
            rise = elevated([(p[k + 1] - p[k]) * (self.d / h) for k in range(self.d)], self.D)
            for (slope, P), A in product(zip(rise, elevated(p, self.D), strict=True), flows):
                gap = (slope + P @ A + (P @ A).T + add) * -1
                if mu and mu[j]:
                    gap = Matrix.block([[gap, P @ B * -1], [(P @ B).T * -1, Matrix.diagonal(mu[j])]])
                gap.require_definite("what e'Pe falls by along a flow")


def clock(system: System, law: Law, data: Any) -> str:
    """e'P(tau)e exp(2 sigma t) falls along flows and does not rise at samples (in the mean, where some are lost)."""
    sigma, N, eye = number(data["sigma"]), system.N, Matrix.diagonal([1] * system.N)
    S, back = (Matrix.read(data[name], N, N) for name in ("basis", "inverse"))
    require(sigma >= 0 and (back @ S).rows == eye.rows, "a rate below 0, or a basis that is none")
    P = Pieces(data["degrees"], data["pieces"], law.low, law.high, data["P"], N)
    step, P_0, are_told = P.before * P.d, P.P[0], law.low == law.high or law.lost
    require(not law.lost or len(P.lengths) == (law.lost + 1) * P.before, "pieces that do not end at samples")
    jumps = [back @ J @ S for J in system.jumps]
    changed = [i for i in range(N) if law.p or any(any(J.rows[i]) for J in jumps)]  # the others are 0 after samples
    P_0.part(changed).require_definite("P(0)")
    for k in range(step, len(P.P), step if are_told else 1):
        for gap in (P.P[k] - J.T @ P_0 @ J * (1 - law.p) - P_0 * law.p for J in jumps):
            gap.part([i for i in range(N) if any(gap.rows[i])]).require_definite()
    P.require_fall([back @ A @ S + eye * sigma for A in system.flows], eye * 0, system.B)
    return f"the error decays{' in mean square' if law.p else ''}{f' at rate {float(sigma):.6g}' if sigma else ''}"


def mean_square(system: System, law: Law, data: Any) -> str:
    """e'Pe pays for |e|^2, and white signals add gamma per time: the time average of E|e|^2 is at most gamma."""
    require(law.is_plain and not system.d0 and not system.v0, "signals or a law that this is not about")
    P = Pieces(data["degrees"], data["pieces"], law.low, law.high, data["P"], system.N)
    P.P[0].require_definite("P(0)")
    for J, M in product(system.jumps, P.tail):
        (M - J.T @ P.P[0] @ J).require_definite()
    P.require_fall(system.flows, Matrix.diagonal([i < system.n for i in range(system.N)]), system.B)
    # Bernstein coefficients of tau and of int_0^tau tr(P drift), of degree d + 1; those on [T_min, T_max] count.
    grown = [sum(map(dot, P.P[0].rows, system.spread.rows), Fraction(0))]
    times, d, bound = [Fraction(0)], P.d, number(data["bound"])
    for (j, h), k in product(enumerate(P.lengths), range(d + 1)):
        grown.append(grown[-1] + sum(map(dot, P.P[j * d + k].rows, system.drift.rows)) * h / (d + 1))
        times.append(times[-1] + h / (d + 1))
    gamma = max(more / t for t, more in list(zip(times, grown, strict=True))[P.before * (d + 1) :])
    require(bound > 0 and gamma <= bound**2, "the mean square may be larger than the bound")
    return f"the root mean square of the error over time is at most {float(bound):.6g}"


def peak(system: System, law: Law, data: Any) -> str:
    """Chains of functions, one for each window of the time since the last sample, bound the error of one state."""
    state, bound, n = count(data["state"]), number(data["bound"]), system.n
    is_white = any(map(any, system.drift.rows + system.spread.rows))
    require(law.is_plain and not is_white and state < n and bound > 0, "signals, law or state that this is not about")
    first, largest, reached = list[Matrix](), Fraction(0), Fraction(0)
    if data["start"] is not None:
        box = [numbers(ends, 2) for ends in listed(data["start"], n)]
        lasting = any(x for J in system.jumps for row in J.rows for x in row[n:])
        require(all(low <= high for low, high in box) and not lasting, "no box, or a state that outlives samples")
        largest, rest = max(abs(end) for end in box[state]) ** 2, [[Fraction(0)]] * (system.N - n)
        errors = [Matrix([x] for x in e) for e in product(*box, *rest, *((-s, s) for s in system.v0))]
        first = [Matrix.block([[J, system.G]]) @ e for J in system.jumps for e in errors]
    windows = [(*numbers(one["window"], 2), one) for one in listed(data["chains"])]
    for low, high, one in sorted(windows, key=lambda entry: entry[0]):
        require(0 <= low <= reached and low < high <= 1, "windows leave a gap")
        reached, largest = max(reached, high), max(largest, chain(system, law, one, state, (low, high), first))
    require(reached == 1 and largest <= bound**2, "windows leave a gap, or the error may be larger than the bound")
    told = "from a box of errors before the first sample, always" if first else "finally"
    return f"{told} the error of state {state + 1} is at most {float(bound):.6g}"


def chain(system: System, law: Law, data: Any, state: int, window: Sequence[Fraction], first: list[Matrix]) -> Fraction:
    """The largest e_i^2 in a window: V_0 there is at most V_k k samples before and what signals add on the way; the
    last one shrinks by rho^2 from sample to sample."""
    rho, lags, N, G = number(data["rho"]), len(listed(data["P"])), system.N, system.G
    require(lags >= 2 and 0 < rho < 1, "no chain")
    ends = [(window[0] * law.high, window[1] * law.high), *([(law.low, law.high)] * (lags - 1))]
    P = [Pieces(data["degrees"], data["pieces"][k > 0], *ends[k], rows, N) for k, rows in enumerate(data["P"])]
    mu = [[numbers(row, len(system.d0)) for row in listed(lag)] for lag in listed(data["mu"], lags)]
    zero = Matrix([Fraction(0)] * len(system.v0) for _ in range(N))
    nu = [numbers(row, len(system.v0)) for row in listed(data["nu"], lags)]
    for M in P[0].tail:
        (M - Matrix.diagonal([i == state for i in range(N)])).require_definite("P - z z'")
    for k in range(1, lags + 1):
        for M, J in product(P[k].tail if k < lags else [M * rho**2 for M in P[-1].tail], system.jumps):
            before, JG = Matrix.block([[M, zero], [zero.T, Matrix.diagonal(nu[k - 1])]]), Matrix.block([[J, G]])
            (before - JG.T @ P[k - 1].P[0] @ JG).require_definite()
    fed, kicked = list[Fraction](), [dot(row, system.v2) for row in nu]
    for one, prices in zip(P, mu, strict=True):
        one.require_fall(system.flows, Matrix.diagonal([0] * N), system.B, prices)
        fed.append(dot([dot(row, system.d2) for row in prices], one.lengths))
    largest = (rho**2 * fed[-1] + kicked[-1]) / (1 - rho**2) + sum(fed) + sum(kicked[:-1])
    for k in range(lags) if first else ():
        begun = max((e.T @ P[k].P[0] @ e).rows[0][0] for e in first)
        largest = max(largest, begun + sum(fed[: k + 1]) + sum(kicked[:k]))
    return largest


class Interval:
    """From low to high, rounded outwards: sums and products hold those of all numbers in them."""

    def __init__(self, low: Fraction, high: Fraction | None = None) -> None:
        self.low = Fraction(floor(low * FINE), FINE)
        self.high = Fraction(ceil((low if high is None else high) * FINE), FINE)

    def __add__(self, other: Interval) -> Interval:
        return Interval(self.low + other.low, self.high + other.high)

    def __radd__(self, zero: Fraction) -> Interval:
        return self

    def __mul__(self, other: Interval) -> Interval:
        ends = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(min(ends), max(ends))


def series(U: Matrix) -> list[Matrix]:
    """The k-fold integrals of U(t_1) .. U(t_k) over 1 > t_1 > .. > t_k > 0, k = 0, 1, .., for all U(t) in U: means of
    products, in U^k / k!, and at most size^k / k!. So all further ones are less than the last, which holds them."""
    size, left = max(sum(max(-x.low, x.high) for x in row) for row in U.rows), Fraction(1)
    require(size <= 300, "a period that is too long for its flow")
    terms = [Matrix.diagonal([1] * len(U.rows)).each(Interval)]
    while left * FINE > 1 or len(terms) < 2 * size:
        left = Interval(left * size / len(terms)).high
        terms.append(U @ terms[-1] * Interval(Fraction(1, len(terms))))
    return [*terms[:-1], terms[-1].each(lambda x: x + Interval(-left, left))]


def chain_box(flows: list[Matrix], n: int) -> Matrix:
    """Transitions over time 1 of edot_i = e_(i+1), edot_n = v(t)'e, lo <= v <= hi, lo <= 0 <= hi. A solution f_j begins
    at the unit vector a_j with v = w_j = (lo_1 .. lo_j, hi_(j+1) ..). Its component j is shown to stay >= 0: so do
    those before it (its integrals), those behind are <= 0. For last columns D(t, s) of transitions from s to t, D(t, s)
    = f_n(t - s) + int_s^t D(t, r) (v - lo)'f_n(r - s) dr with a factor >= 0: a Volterra series, D >= f_n >= 0. So exp
    with v = hi, which is >= 0, is above all transitions (the difference is int D (hi - v)'exp), and their columns j are
    above f_j (the difference is int D (v - w_j)'f_j)."""
    require(all(A.rows[i][j] == (j == i + 1) for A in flows for i in range(n - 1) for j in range(n)), "no integrators")
    ends = [[A.rows[-1][j] for A in flows] + [Fraction(0)] for j in range(n)]
    rows = [[*map(min, ends[: j + 1]), *map(max, ends[j + 1 :])] for j in range(-1, n)]
    high, *low = (reduce(Matrix.__add__, series(Matrix([*flows[0].rows[:-1], row]).each(Interval))) for row in rows)
    for j, row in enumerate(rows[1:]):
        F = Matrix([*flows[0].rows[:-1], row]) - Matrix.diagonal([min(row[-1], 0)] * n)  # f_j times an exponential
        terms, parts = series(F.each(Interval))[::-1], [Interval(Fraction(0), Fraction(1))]
        for s in parts:
            value = Interval(Fraction(0))
            for M in terms:
                value = value * s + M.rows[j][j]
            require(value.high >= 0 and len(parts) < 9999, "the period is longer than a chain of integrators allows")
            middle = (s.low + s.high) / 2
            parts += [Interval(s.low, middle), Interval(middle, s.high)] if value.low < 0 else []
    return Matrix([Interval(low[j].rows[i][j].low, high.rows[i][j].high) for j in range(n)] for i in range(n))


def reachable(system: System, law: Law, data: Any) -> str:
    """e = S z after samples, jumps e+ = S T e, and z'Q z falls by rho^2 over a period for all M of a box that holds all
    transitions (of a chain, or by `steps` equal steps): z+ = T M S z. For x = S z, M x runs over center x + diag(eps)
    radius |x|, |eps_i| <= 1; convex functions are largest at signs; |x| = diag(sigma) x. One sign of all is free."""
    steps, rho_squared, n, r = count(data["steps"]), number(data["rho_squared"]), system.N, len(listed(data["Q"]))
    require(law.is_plain and law.low == law.high and n <= 8, "a law or an observer that this is not about")
    S, T, Q = Matrix.read(data["S"], n, r), Matrix.read(data["T"], r, n), Matrix.symmetric(data["Q"], r)
    require(r and 0 <= rho_squared < 1 and all((S @ T).rows == J.rows for J in system.jumps), "no map from S z to S z")
    Q.require_definite("Q")
    units = Matrix.diagonal([law.high ** (0 if steps else i) for i in range(n)])  # chains: e_i T^(i-1) over t / T
    back = units.each(lambda x: 1 / x if x else x)
    flows = [units @ A @ back * (law.high / max(steps, 1)) for A in system.flows]
    entries = [list(zip(*rows, strict=True)) for rows in zip(*(A.rows for A in flows), strict=True)]
    U = Matrix([Interval(min(ends), max(ends)) for ends in row] for row in entries)
    box = reduce(Matrix.__matmul__, [reduce(Matrix.__add__, series(U))] * steps if steps else [chain_box(flows, n)])
    center, radius = box.each(lambda x: (x.high + x.low) / 2), box.each(lambda x: (x.high - x.low) / 2)
    for signs in product((1, -1), repeat=2 * n - 1):
        M = center + Matrix.diagonal([1, *signs[n:]]) @ radius @ Matrix.diagonal(signs[:n])
        F = T @ back @ M @ units @ S
        (Q * rho_squared - F.T @ Q @ F).require_definite("what z'Q z falls by over a period")
    return f"the error decays, a quadratic function of it to {float(rho_squared):.9g} of itself from sample to sample"


def check(document: Any) -> list[str]:
    """What each certificate shows. Raises: RefusedError."""
    try:
        require(document["schema_version"] == 1, "another version")
        methods = {"clock": clock, "mean_square": mean_square, "peak": peak, "set": reachable}
        system, told = System(document["plant"], document["gain"], document["observer"]), []
        for one in listed(document["certificates"]):
            law = Law(one["law"])
            told.append(f"{one['method']}: {methods[one['method']](system, law, one['data'])}; {law.told}")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise RefusedError(f"not a proof ({type(error).__name__}: {error})") from error
    require(told, "no certificate")
    return told


if __name__ == "__main__":
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("proof.json")
    try:
        print("\n".join(f"holds  {one}" for one in check(json.loads(path.read_text(encoding="utf-8")))))
    except (RefusedError, ValueError) as error:
        print(f"REFUSED  {error}")
        sys.exit(1)
