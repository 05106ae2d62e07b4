"""Search for S and L in floats: S = [C; T] with T from the Sylvester equation, L = S^-1 [diag(q); 0].

What is searched over: the rates lambda_i < 0 of T, for p > 1 also the directions g_i, and how much of the
largest admissible injection q_j each output uses. With N1 = -diag(q) the columns of E(s) decouple, so the
largest q_j for a period is known in closed form: q_j(Tbar) = min over s <= Tbar of exp(M s)_jj / Gamma(s)_jj.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certify import search
from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.sylvester import residual, sylvester_rows
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval.hurwitz import final_width
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import Coordinates, coordinates, error_flow, width_matrix
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

S_DIGITS, L_DIGITS = 7, (9, 12, 15)  # of L the fewest that keep the structure of Assumption 3
_STRUCTURE = 1e-7
_PHASES, _WIDTH = 32, Fraction(1, 40000)
_TRIALS = 500  # of one climb, at effort 0
_LARGEST_CONDITION = 1e7
# Under `max_period`: the share of the largest injection that must still make Mtot Hurwitz, and the share used.
# At the limit itself the width would take for ever to settle, at a value without bound.
RESERVE, USED = 0.98, 0.995


@dataclass(frozen=True)
class Shape:
    """One choice of coordinates: rates and directions of T, and S = [C; T] with R = S^-1."""

    rates: Array
    directions: Array
    S: Array
    R: Array

    def injected(self, A: Array, C: Array, q: Array) -> Coordinates:
        """The coordinates with L = S^-1 [diag(q); 0]."""
        return coordinates(A, C, self.S, self.R, self.R[:, : len(q)] * q)


@dataclass(frozen=True)
class Search:
    """The plant in floats, and the widths that `min_width` weighs (unit disturbances where none are declared)."""

    A: Array
    C: Array
    disturbance: Array
    noise: Array

    @staticmethod
    def of(plant: Plant) -> Search:
        disturbance, noise = (width.floats for width in System(plant, {}).widths)
        if not disturbance.any() and not noise.any():
            disturbance = np.ones((plant.n, 1))
        return Search(np.array(plant.A.floats), np.array(plant.C.floats), disturbance, noise)

    @property
    def scale(self) -> float:
        """A rate typical of A, 1 for A = 0."""
        return float(np.linalg.norm(self.A, 2)) or 1.0

    def shape(self, parameters: Array) -> Shape | None:
        """From (log of -lambda_i, entries of g_i for p > 1)."""
        n, p = len(self.A), len(self.C)
        count = n - p
        rates = -np.exp(np.clip(parameters[:count], -60, 60))
        directions = np.ones((count, 1)) if p == 1 else parameters[count : count + count * p].reshape(count, p)
        T = sylvester_rows(self.A, self.C, rates, directions) if count else np.zeros((0, n))
        if T is None:
            return None
        S = np.vstack([self.C, T])
        if not np.all(np.isfinite(S)) or np.linalg.cond(S) > _LARGEST_CONDITION:
            return None
        return Shape(rates, directions, S, np.linalg.inv(S))

    def largest_injection(self, shape: Shape, Tbar: float) -> Array | None:
        """q_j(Tbar) for each output."""
        p = len(self.C)
        M = error_flow(shape.S @ self.A @ shape.R)
        size = len(M)
        # exp([M T, I; 0, 0] r) holds exp(M T r) and Gamma(T r)/T; its powers are the phases.
        flow = np.block([[M * Tbar, np.eye(size)], [np.zeros((size, 2 * size))]])
        if not np.all(np.isfinite(flow)) or np.abs(flow).sum(axis=1).max() > 200:
            return None
        step = exponentials(flow[None] / _PHASES)[0]
        index = np.arange(p)
        state, q = step[:, :], np.full(p, np.inf)
        with np.errstate(all="ignore"):
            for _ in range(_PHASES):
                q = np.minimum(q, state[index, index] / (state[index, size + index] * Tbar))
                state = state @ step
        return q if np.all(np.isfinite(q)) and np.all(q > 0) else None

    def abscissa(self, shape: Shape, q: Array) -> float:
        """The largest real part of the eigenvalues of Mtot."""
        z = shape.injected(self.A, self.C, q)
        return float(np.linalg.eigvals(width_matrix(z.Q0, z.Q1)).real.max())

    def width(self, shape: Shape, q: Array) -> float:
        """Sum of the final widths of x; Mtot is Hurwitz."""
        z = shape.injected(self.A, self.C, q)
        return float(np.sum(final_width(z, width_matrix(z.Q0, z.Q1), self.disturbance, self.noise)))

    def longest(self, shape: Shape) -> float:
        """The largest Tbar at which the reserve of the injection keeps Mtot Hurwitz, nearly."""

        def holds(T: Exact) -> bool | None:
            q = self.largest_injection(shape, float(T))
            return True if q is not None and self.abscissa(shape, RESERVE * q) < 0 else None

        met = search.largest(holds, search.short(0.01 / self.scale), _WIDTH)
        return 0.0 if met is None else float(met[0])

    def starts(self) -> list[Array]:
        """Where the climbs begin: rates around the scale of A, a factor apart; directions one output after another."""
        p = len(self.C)
        count = len(self.A) - p
        directions = np.where(np.arange(count)[:, None] % p == np.arange(p), 1.0, 0.2).ravel() if p > 1 else np.zeros(0)
        rates = [np.log(factor * self.scale * 1.6 ** np.arange(count)) for factor in (0.4, 1.0, 3.0)]
        return [np.concatenate([logarithms, directions]) for logarithms in rates]

    def longest_design(self, effort: int) -> tuple[Shape, Array] | None:
        """Shape and injection with the largest period found."""

        def value(parameters: Array) -> float:
            shape = self.shape(parameters)
            return self.longest(shape) if shape is not None else -np.inf

        parameters, T = climb(value, self.starts(), 0.5, effort)
        shape = self.shape(parameters) if T > 0 else None
        q = self.largest_injection(shape, T) if shape is not None else None
        return None if shape is None or q is None else (shape, USED * q)

    def design_at(self, Tbar: float, cost: Callable[[Shape, Array], float], effort: int) -> tuple[Shape, Array] | None:
        """Shape and injection of least cost among those positive up to Tbar with Mtot Hurwitz."""
        p = len(self.C)

        def split(parameters: Array) -> tuple[Shape, Array] | None:
            shape = self.shape(parameters[:-p])
            q = self.largest_injection(shape, Tbar) if shape is not None else None
            share = 0.9995 / (1 + np.exp(-np.clip(parameters[-p:], -30, 30)))
            return None if shape is None or q is None else (shape, share * q)

        def value(parameters: Array) -> float:
            pair = split(parameters)
            if pair is None:
                return -np.inf
            abscissa = self.abscissa(*pair)
            return -1e30 * (1 + abscissa / self.scale) if abscissa >= 0 else -cost(*pair)

        starts = [np.concatenate([start, np.full(p, 3.0)]) for start in self.starts()]
        parameters, best = climb(value, starts, 0.5, effort)
        return split(parameters) if best > -1e30 else None

    def width_design(self, Tbar: float, effort: int) -> tuple[Shape, Array] | None:
        """Least sum of final widths."""
        return self.design_at(Tbar, self.width, effort)

    def decay_design(self, Tbar: float, effort: int) -> tuple[Shape, Array] | None:
        """Fastest decay of the width."""
        return self.design_at(Tbar, self.abscissa, effort)


def climb(value: Callable[[Array], float], starts: list[Array], step: float, effort: int) -> tuple[Array, float]:
    """Coordinate ascent from the best start, steps growing while they help and shrinking when none does:
    deterministic, no gradient."""
    values = [value(start) for start in starts]
    best = int(np.argmax(values))
    point, top = starts[best], values[best]
    steps = np.full(len(point), step)
    trials = 0
    for _ in range(20 + 15 * effort):
        moved = False
        if trials > _TRIALS * (1 + effort):
            break
        for k in range(len(point)):
            for sign in (1.0, -1.0):
                trial = point.copy()
                trial[k] += sign * steps[k]
                found, trials = value(trial), trials + 1
                if found > top:
                    point, top, moved = trial, found, True
                    steps[k] *= 2 * sign
                    break
            else:
                steps[k] /= 3
        if not moved and np.abs(steps).max(initial=0.0) < 1e-4:
            break
    return point, top


def printed(plant: Plant, shape: Shape, q: Array) -> dict[str, ExactMatrix]:
    """S and L in short decimals: the rows of C as typed, T rounded, L solved again for the rounded S."""
    p = plant.p
    T = ExactMatrix.from_floats(shape.S[p:], S_DIGITS).rows if len(shape.S) > p else ()
    S = ExactMatrix([*plant.C.rows, *T])
    wanted = np.vstack([np.diag(q), np.zeros((plant.n - p, p))])
    solved: Array = np.linalg.solve(S.floats, wanted).astype(np.float64)
    for digits in L_DIGITS:
        L = clean(ExactMatrix.from_floats(solved, digits), solved)
        if float(np.abs(S.floats @ L.floats - wanted).max()) <= _STRUCTURE * float(q.max()):
            break
    return {"S": S, "L": L}


def clean(exact: ExactMatrix, floats: Array) -> ExactMatrix:
    """Entries that are rounding noise of the largest become 0."""
    noise = 1e-13 * (float(np.abs(floats).max()) or 1.0)
    return ExactMatrix([[0 if abs(float(entry)) < noise else entry for entry in row] for row in exact.rows])


def residuals(system: System, rates: Array, directions: Array) -> tuple[float, float]:
    """How well the printed T solves its equation, and the printed L its own, S L = [diag(q); 0]: both relative."""
    p, plant, Q1 = system.plant.p, system.plant, system.floats.Q1
    wanted = np.zeros_like(Q1)
    wanted[:p, :p] = np.diag(np.diag(Q1)[:p])
    solved = residual(plant.A.floats, plant.C.floats, system.gain["S"].floats[p:], rates, directions)
    return solved, float(np.abs(Q1 - wanted).max()) / (float(np.abs(Q1).max()) or 1.0)
