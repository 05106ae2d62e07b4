"""Checks proof.json, beside this file, with fractions and the standard library alone: python check_proof.py [FILE]

The error e = x_hat - x of the observer obeys, for every plant whose slopes stay in the intervals of the file,

    edot = (A + sum_k v_k(t) part_k) e - d,  v_k(t) in [lower_k, upper_k];    e+ = (I - K H) e + K v    at samples

("corrected": a copy corrected at samples), with H = C + sum_m w_m part_m; or, with the innovation held between samples
("held"), over (e, w), w = C (e - e(t_k)) + v_k,

    d/dt (e, w) = [[F, L], [C F, C L]] (e, w) - [d; C d],  F = A + sum_k v_k part_k - L C;    (e, w)+ = (e, v).

That phi has these slopes is taken from the file; everything else is shown here. Certificates hold functions e'P(tau)e
of the time tau since the last sample, P piecewise polynomial, by Bernstein coefficients on each piece: a polynomial
whose coefficients are positive definite is positive definite.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import product
from math import lcm
from pathlib import Path
from typing import Any


class RefusedError(Exception):
    """What is wrong with a proof."""


def require(holds: object, what: str) -> None:
    if not holds:
        raise RefusedError(what)


def number(text: Any) -> Fraction:
    """Of p or p/q."""
    require(
        isinstance(text, str) and len(text) < 5000 and re.fullmatch(r"-?[0-9]+(/[1-9][0-9]*)?", text), "no fraction"
    )
    return Fraction(text)


def count(value: Any, least: int = 0) -> int:
    require(type(value) is int and least <= value <= 1000, "no number of pieces or degrees")
    return int(value)


def listed(value: Any, size: int | None = None) -> list[Any]:
    require(isinstance(value, list) and (size is None or len(value) == size), "a list of another length")
    return list(value)


class Matrix:
    """Rows of fractions; of no columns too."""

    def __init__(self, rows: Iterable[Iterable[Fraction]]) -> None:
        self.rows = [list(row) for row in rows]

    @staticmethod
    def read(rows: Any, n: int, m: int) -> Matrix:
        return Matrix([number(text) for text in listed(row, m)] for row in listed(rows, n))

    @staticmethod
    def symmetric(rows: Any, n: int) -> Matrix:
        """From the upper triangle, each row from the diagonal on."""
        upper = [[number(text) for text in listed(row, n - i)] for i, row in enumerate(listed(rows, n))]
        return Matrix([upper[min(i, j)][abs(i - j)] for j in range(n)] for i in range(n))

    @staticmethod
    def diagonal(values: Sequence[Fraction]) -> Matrix:
        return Matrix([value if i == j else Fraction(0) for j in range(len(values))] for i, value in enumerate(values))

    @staticmethod
    def zeros(n: int, m: int) -> Matrix:
        return Matrix([Fraction(0)] * m for _ in range(n))

    @staticmethod
    def block(grid: list[list[Matrix]]) -> Matrix:
        return Matrix([x for part in row for x in part.rows[i]] for row in grid for i in range(len(row[0].rows)))

    @property
    def T(self) -> Matrix:
        return Matrix(zip(*self.rows, strict=True))

    def __add__(self, other: Matrix) -> Matrix:
        pairs = zip(self.rows, other.rows, strict=True)
        return Matrix([a + b for a, b in zip(row, more, strict=True)] for row, more in pairs)

    def __mul__(self, factor: Fraction | int) -> Matrix:
        return Matrix([factor * x for x in row] for row in self.rows)

    def __neg__(self) -> Matrix:
        return self * -1

    def __sub__(self, other: Matrix) -> Matrix:
        return self + -other

    def __matmul__(self, other: Matrix) -> Matrix:
        columns = list(zip(*other.rows, strict=True))
        rows = [[(k, x) for k, x in enumerate(row) if x] for row in self.rows]
        return Matrix([sum((x * column[k] for k, x in row), Fraction(0)) for column in columns] for row in rows)

    def part(self, places: Sequence[int]) -> Matrix:
        return Matrix([self.rows[i][j] for j in places] for i in places)

    def trace(self) -> Fraction:
        return sum((row[i] for i, row in enumerate(self.rows)), Fraction(0))

    def inverse(self) -> Matrix:
        """Gauss and Jordan."""
        n = len(self.rows)
        rows = [[*row, *(Fraction(i == j) for j in range(n))] for i, row in enumerate(self.rows)]
        for k in range(n):
            pivot = next((i for i in range(k, n) if rows[i][k]), None)
            require(pivot is not None, "a basis that is none")
            rows[k], rows[pivot or k] = rows[pivot or k], rows[k]
            rows[k] = [x / rows[k][k] for x in rows[k]]
            for i in range(n):
                if i != k and rows[i][k]:
                    rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k], strict=True)]
        return Matrix(row[n:] for row in rows)

    def require_definite(self, what: str) -> None:
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
    while len(p) - 1 < D:
        d = len(p)
        inner = [p[i - 1] * Fraction(i, d) + p[i] * (1 - Fraction(i, d)) for i in range(1, d)]
        p = [p[0], *inner, p[-1]]
    return p


class System:
    """The error: corners of flow and jump, how disturbance (B) and noise (G) enter it, and how large they are."""

    def __init__(self, plant: Any, gain: Any, kind: Any) -> None:
        n, p = len(listed(plant["states"])), len(listed(plant["C"]))
        self.n, eye, C, K = (
            n,
            Matrix.diagonal([Fraction(1)] * n),
            Matrix.read(plant["C"], p, n),
            Matrix.read(gain, n, p),
        )
        flows = corners(Matrix.read(plant["A"], n, n), plant["slopes"], n, n)
        H = corners(C, plant["outputs"], p, n)
        require(kind in ("corrected", "held"), "an observer of another kind")
        if kind == "corrected":
            self.flows, self.jumps = flows, [eye - K @ one for one in H]
            drive, kick = -eye, K
        else:
            require(len(H) == 1, "outputs whose slopes vary, with a held innovation")
            F = [one - K @ C for one in flows]
            self.flows = [Matrix.block([[one, K], [C @ one, C @ K]]) for one in F]
            self.jumps = [Matrix.diagonal([Fraction(i < n) for i in range(n + p)])]
            unit = Matrix.diagonal([Fraction(1)] * p)
            drive, kick = -Matrix.block([[eye], [C]]), Matrix.block([[Matrix.zeros(n, p)], [unit]])
        self.N = len(self.flows[0].rows)
        self.B, self.d0 = driven(drive, plant["disturbance"], n)
        self.G, self.v0 = driven(kick, plant["noise"], p)
        self.drift, self.spread = spread(drive, plant["intensity"], n), spread(kick, plant["covariance"], p)
        self.white = plant["intensity"] is not None or plant["covariance"] is not None
        self.bounded = plant["disturbance"] is not None or plant["noise"] is not None


def corners(middle: Matrix, varying: Any, n: int, m: int) -> list[Matrix]:
    """At all ends of what varies; `middle` is without it."""
    made, parts = [middle], listed(varying)
    require(len(parts) <= 10, "too much that varies")
    for one in parts:
        part, low, high = Matrix.read(one["part"], n, m), number(one["lower"]), number(one["upper"])
        require(low <= high, "an interval whose ends are exchanged")
        made = [M + part * value for M in made for value in (low, high)]
    return made


def driven(through: Matrix, texts: Any, length: int) -> tuple[Matrix, list[Fraction]]:
    """The columns of bounded signals that are not 0, and how large these are."""
    sizes = [Fraction(0)] * length if texts is None else [number(text) for text in listed(texts, length)]
    require(all(size >= 0 for size in sizes), "a size below 0")
    kept = [k for k, size in enumerate(sizes) if size]
    return Matrix([row[k] for k in kept] for row in through.rows), [sizes[k] for k in kept]


def spread(through: Matrix, rows: Any, length: int) -> Matrix:
    """M Q M'. Q need not be shown to be a covariance: of one that is none nothing is claimed."""
    Q = Matrix.zeros(length, length) if rows is None else Matrix.read(rows, length, length)
    require(Q.rows == Q.T.rows, "a covariance that is not symmetric")
    return through @ Q @ through.T


class Law:
    """t_(k+1) - t_k: one number, any in [T_min, T_max], or multiples of T_min; each sample lost with probability p."""

    def __init__(self, told: Any) -> None:
        self.low, self.high, self.lost = number(told["T_min"]), number(told["T_max"]), count(told["lost"])
        self.p = number(told["probability"])
        require(0 <= self.low <= self.high and self.high > 0 and 0 <= self.p < 1, "no law of samples")
        require(not self.lost or self.high == (self.lost + 1) * self.low, "lost samples of another law")
        require(not self.p or (self.low == self.high and not self.lost), "probabilities of another law")
        self.is_plain = self.low > 0 and not self.lost and not self.p


class Pieces:
    """P(tau) with pieces of equal length on [0, a] and on [a, b]."""

    def __init__(self, degrees: Any, pieces: Any, ends: tuple[Fraction, Fraction], P: Any, N: int) -> None:
        (self.d, self.D), (self.before, after) = (count(one, 1) for one in degrees), map(count, pieces)
        start, end = ends
        require(self.d <= self.D <= 64 and 0 <= start <= end and end > 0, "no pieces")
        require((self.before == 0) == (start == 0) and (after == 0) == (start == end), "pieces leave a gap")
        self.lengths = [start / self.before] * self.before if self.before else []
        self.lengths += [(end - start) / after] * after if after else []
        self.P = [Matrix.symmetric(one, N) for one in listed(P, len(self.lengths) * self.d + 1)]

    @property
    def tail(self) -> list[Matrix]:
        """The coefficients on [a, b]."""
        return self.P[self.before * self.d :]

    def slopes(self) -> Iterator[tuple[int, Matrix, Matrix]]:
        """(number of the piece, Pdot, P) at each coefficient of degree D."""
        for j, h in enumerate(self.lengths):
            p = self.P[j * self.d : (j + 1) * self.d + 1]
            rise = [(p[k + 1] - p[k]) * (self.d / h) for k in range(self.d)]
            for slope, value in zip(elevated(rise, self.D), elevated(p, self.D), strict=True):
                yield j, slope, value

    def require_fall(
        self, flows: list[Matrix], add: Matrix, sigma: Fraction, B: Matrix, mu: list[Matrix] | None = None
    ) -> None:
        """-(Pdot + P A + A'P + 2 sigma P + add) > 0 at all corners; with mu of each piece [[that, -P B], [., mu]]."""
        for j, slope, P in self.slopes():
            for A in flows:
                gap = -(slope + P @ A + (P @ A).T + P * (2 * sigma) + add)
                if mu is not None and mu[j].rows:
                    gap = Matrix.block([[gap, -(P @ B)], [-(P @ B).T, mu[j]]])
                gap.require_definite("what e'Pe falls by along a flow")


def clock(system: System, law: Law, data: Any) -> str:
    """e'P(tau)e exp(2 sigma t) falls along flows and does not rise at samples (in the mean, where some are lost)."""
    sigma, S = number(data["sigma"]), Matrix.read(data["basis"], system.N, system.N)
    require(sigma >= 0, "a rate below 0")
    P = Pieces(data["degrees"], data["pieces"], (law.low, law.high), data["P"], system.N)
    step, back, P_0 = P.before * P.d, S.inverse(), P.P[0]
    require(not law.lost or len(P.lengths) == (law.lost + 1) * P.before, "pieces that do not end at samples")
    flows, jumps = ([back @ M @ S for M in maps] for maps in (system.flows, system.jumps))
    P_0.part(range(system.N) if law.p else range_of(jumps)).require_definite("P(0)")
    single = law.low == law.high or law.lost
    for k in [step * k for k in range(1, law.lost + 2)] if single else range(step, len(P.P)):
        for J in jumps:
            if k:
                gap = P.P[k] - J.T @ P_0 @ J * (1 - law.p) - P_0 * law.p
                gap.require_definite("what e'Pe falls by at a sample")
            else:
                require_fall_at_once(P_0, J)
    P.require_fall(flows, Matrix.zeros(system.N, system.N), sigma, system.B)
    return f"the error decays{' in mean square' if law.p else ''}{f' at rate {float(sigma):.6g}' if sigma else ''}"


def kept_by(J: Matrix) -> list[int]:
    """The states that J keeps and does not couple with others."""
    N = len(J.rows)
    return [i for i in range(N) if all(J.rows[i][j] == J.rows[j][i] == (i == j) for j in range(N))]


def range_of(jumps: list[Matrix]) -> Sequence[int]:
    """All states; or those that the one jump keeps, where it sets the others to 0."""
    N, kept = len(jumps[0].rows), kept_by(jumps[0])
    lost = [i for i in range(N) if i not in kept]
    return kept if len(jumps) == 1 and kept and not any(map(any, jumps[0].part(lost).rows)) else range(N)


def require_fall_at_once(P_0: Matrix, J: Matrix) -> None:
    """At tau = 0: J = diag(I, j), P(0) = diag(P_11, Q) and Q - j'Q j > 0, so P(0) - J'P(0)J = diag(0, > 0)."""
    kept = kept_by(J)
    lost = [i for i in range(len(J.rows)) if i not in kept]
    require(not any(P_0.rows[i][j] for i in kept for j in lost), "P(0) couples what a sample keeps and what it changes")
    if lost:
        j, Q = J.part(lost), P_0.part(lost)
        (Q - j.T @ Q @ j).require_definite("what e'Pe falls by at a sample at once")


def mean_square(system: System, law: Law, data: Any) -> str:
    """e'Pe pays for |e|^2, and white signals add gamma per time: the time average of E|e|^2 is at most gamma."""
    require(law.is_plain and system.white and not system.bounded, "signals or a law that this is not about")
    units, n = [number(text) for text in listed(data["units"], system.N)], system.n
    require(all(one > 0 for one in units), "a unit that is not positive")
    S, back = Matrix.diagonal(units), Matrix.diagonal([1 / one for one in units])
    P = Pieces(data["degrees"], data["pieces"], (law.low, law.high), data["P"], system.N)
    P.P[0].require_definite("P(0)")
    for J in (back @ J @ S for J in system.jumps):
        for M in P.tail:
            (M - J.T @ P.P[0] @ J).require_definite("what e'Pe falls by at a sample")
    Z = Matrix.diagonal([unit**2 if i < n else Fraction(0) for i, unit in enumerate(units)])
    P.require_fall([back @ A @ S for A in system.flows], Z, Fraction(0), system.B)
    added, drift = (P.P[0] @ (back @ system.spread @ back)).trace(), back @ system.drift @ back
    # Bernstein coefficients of tau and of int_0^tau tr(P drift), of degree d + 1; those on [T_min, T_max] count.
    times, grown = [Fraction(0)], [Fraction(0)]
    for j, h in enumerate(P.lengths):
        for k in range(P.d + 1):
            grown.append(grown[-1] + (P.P[j * P.d + k] @ drift).trace() * h / (P.d + 1))
            times.append(times[-1] + h / (P.d + 1))
    first, bound = P.before * (P.d + 1), number(data["bound"])
    gamma = max((added + more) / t for t, more in zip(times[first:], grown[first:], strict=True))
    require(bound > 0 and gamma <= bound**2, "the mean square may be larger than the bound")
    return f"the root mean square of the error over time is at most {float(bound):.6g}"


def peak(system: System, law: Law, data: Any) -> str:
    """Chains of functions, one for each window of the time since the last sample, bound the error of one state."""
    require(law.is_plain and system.bounded and not system.white, "signals or a law that this is not about")
    state, bound, n = count(data["state"]), number(data["bound"]), system.n
    require(state < n and bound > 0, "no state or no bound")
    first, largest, reached = None, Fraction(0), Fraction(0)
    if data["start"] is not None:
        box = [[number(text) for text in listed(ends, 2)] for ends in listed(data["start"], n)]
        require(all(low <= high for low, high in box), "an interval whose ends are exchanged")
        require(not any(x for J in system.jumps for row in J.rows for x in row[n:]), "a state that outlives a sample")
        largest, pad = max(abs(end) for end in box[state]) ** 2, [Fraction(0)] * (system.N - n)
        kicks = [
            [sum(map(Fraction.__mul__, row, v)) for row in system.G.rows]
            for v in product(*((-s, s) for s in system.v0))
        ]
        errors = [J @ Matrix([[x] for x in (*e, *pad)]) for J in system.jumps for e in product(*box)]
        first = [e + Matrix([[Fraction(x)] for x in kick]) for e in errors for kick in kicks]
    windows = [(*(number(text) for text in listed(one["window"], 2)), one) for one in listed(data["chains"])]
    for low, high, one in sorted(windows, key=lambda entry: entry[0]):
        require(0 <= low <= reached and low < high <= 1, "windows leave a gap")
        reached, largest = max(reached, high), max(largest, chain(system, law, one, state, (low, high), first))
    require(reached == 1, "windows leave a gap")
    require(largest <= bound**2, "the error may be larger than the bound")
    told = "finally" if first is None else "from a box of errors before the first sample, always"
    return f"{told} the error of state {state + 1} is at most {float(bound):.6g}"


def chain(
    system: System, law: Law, data: Any, state: int, window: tuple[Fraction, Fraction], first: list[Matrix] | None
) -> Fraction:
    """The largest e_i^2 in a window: V_0 there is at most V_k k samples before and what signals add on the way; the
    last one shrinks by rho^2 from sample to sample."""
    rho, lags, N = number(data["rho"]), len(listed(data["P"])), system.N
    require(lags >= 2 and 0 < rho < 1, "no chain")
    own, others = listed(data["pieces"], 2)
    P = [Pieces(data["degrees"], own, (window[0] * law.high, window[1] * law.high), data["P"][0], N)]
    P += [Pieces(data["degrees"], others, (law.low, law.high), rows, N) for rows in data["P"][1:]]
    mu = [
        [[number(text) for text in listed(row, len(system.d0))] for row in listed(lag, len(one.lengths))]
        for lag, one in zip(listed(data["mu"], lags), P, strict=True)
    ]
    nu = [[number(text) for text in listed(row, len(system.v0))] for row in listed(data["nu"], lags)]
    target = Matrix.diagonal([Fraction(i == state) for i in range(N)])
    for M in P[0].tail:
        (M - target).require_definite("P - z z'")
    for k in range(1, lags + 1):
        new, G = P[k - 1].P[0], system.G
        for M in P[k].tail if k < lags else [M * rho**2 for M in P[-1].tail]:
            for J in system.jumps:
                gap = M - J.T @ new @ J
                if system.v0:
                    side = -(J.T @ new @ G)
                    gap = Matrix.block([[gap, side], [side.T, Matrix.diagonal(nu[k - 1]) - G.T @ new @ G]])
                gap.require_definite("what e'Pe falls by at a sample")
    for one, weights in zip(P, mu, strict=True):
        priced = [Matrix.diagonal(row) for row in weights]
        one.require_fall(system.flows, Matrix.zeros(N, N), Fraction(0), system.B, priced)
    fed = [
        sum(dot(w, system.d0) * h for w, h in zip(row, one.lengths, strict=True))
        for row, one in zip(mu, P, strict=True)
    ]
    kicked = [dot(row, system.v0) for row in nu]
    largest = (rho**2 * fed[-1] + kicked[-1]) / (1 - rho**2) + sum(fed) + sum(kicked[:-1])
    for k in range(lags) if first is not None else ():
        begun = max((e.T @ P[k].P[0] @ e).rows[0][0] for e in first or ())
        largest = max(largest, begun + sum(fed[: k + 1]) + sum(kicked[:k]))
    return Fraction(largest)


def dot(weights: list[Fraction], sizes: list[Fraction]) -> Fraction:
    return sum((weight * size**2 for weight, size in zip(weights, sizes, strict=True)), Fraction(0))


METHODS = {"clock": clock, "mean_square": mean_square, "peak": peak}


def check(document: Any) -> list[str]:
    """What each certificate shows. Raises: RefusedError."""
    try:
        require(document["schema_version"] == 1, "another version")
        system, told = System(document["plant"], document["gain"], document["observer"]), []
        for one in listed(document["certificates"]):
            require(one["method"] in METHODS, "a method that is not known here")
            law = Law(one["law"])
            shown = METHODS[one["method"]](system, law, one["data"])
            lost = (
                f", at most {law.lost} in a row lost"
                if law.lost
                else f", lost with probability {law.p}"
                if law.p
                else ""
            )
            told.append(f"{one['method']}: {shown}; samples {float(law.low):.9g} to {float(law.high):.9g} apart{lost}")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise RefusedError(f"not a proof ({type(error).__name__}: {error})") from error
    require(told, "no certificate")
    return told


def main() -> int:
    """Exit code 0 where everything holds, 1 where something does not."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("proof.json")
    try:
        told = check(json.loads(path.read_text(encoding="utf-8")))
    except (RefusedError, ValueError) as error:
        print(f"REFUSED  {error}")
        return 1
    print("\n".join(f"holds  {one}" for one in told))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
