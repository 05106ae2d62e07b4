"""The search for P, mu, nu and gamma of sensors that send on change: convex for each rate, and the rate by a scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from functools import cached_property, partial
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cdobs_cli import progress
from cdobs_cli.certify import search
from cdobs_cli.certify.bernstein import derivative, elevation
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.form import GraphShape, lyapunov
from cdobs_cli.certify.methods.on_change.form import flow_gap, silent_gap, weighted_outputs
from cdobs_cli.certify.methods.on_change.scaled import Family, Scaled, admissible
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import decimal_text, fraction_text
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array
    from cdobs_cli.certify.lmi import Affine

    Values = Mapping[str, Array]

M_ = TypeVar("M_", bound=Method)

_DIGITS, _RATE_DIGITS = 12, 6
_STRICT = 1e-6  # by which inequalities are to hold, in scaled units
_LARGEST = 1e6  # of P: where no error is left in the long run the least level has none
_AT_ONCE = 16  # messages at one instant, in the long run, where a gain is looked for
_SCAN = tuple(2.0**k for k in range(-8, 4))  # rates, over the fastest of the plant
_STEPS = (3, 5, 8, 12)  # halvings of the scan's step round its best rate, by effort
_SHAPES = (GraphShape(2, 3, ((1,),)), GraphShape(3, 4, ((1,),)), GraphShape(3, 4, ((2,),)), GraphShape(3, 5, ((4,),)))


@dataclass(frozen=True)
class Aim:
    """What is to be small: the error of one state, or a weighted sum of the squares of all."""

    state: int | None = None
    weights: tuple[float, ...] | None = None

    @staticmethod
    def of_state(state: int) -> Aim:
        return Aim(state)

    @staticmethod
    def weighted(question: Question) -> Aim:
        """By the card's weights, else what the outputs show of each state."""
        typed = getattr(question.card, "weights", None)
        if typed is None:
            return Aim()
        return Aim(None, tuple(float(typed.get(name, 0)) for name in question.plant.states))


@dataclass(frozen=True)
class Found:
    """A solution in scaled units at a rate: what it makes of the aim, P by its coefficients, and the multipliers.

    P: P(h), or P; x: of a given gain in its family. steps: (P_k - P(h)) / h of the other coefficients. N: coefficients.
    """

    merit: float
    sigma: Fraction
    shape: GraphShape
    P: Array
    x: Array | None
    steps: list[Array]
    N: list[Array]
    mu: Array
    nu: Array
    gamma: Array
    gamma_N: Array


def shape_of(question: Question) -> GraphShape:
    """Of P: constant where outputs are compared all the time."""
    return _SHAPES[question.level] if question.law.is_checked else GraphShape(0, 0, ((1,),))


class Search:
    """The programs of one aim, at any rate: all inequalities but that of the level are affine in the rate, and read at
    two rates only. family None: the gain is free."""

    def __init__(self, scaled: Scaled, family: Family | None, aim: Aim, shape: GraphShape) -> None:
        from cdobs_cli.certify.lmi import Program, diagonal, full, symmetric

        self.scaled, self.family, self.aim, self.shape = scaled, family, aim, shape
        self.n, (self.p, self.q), count = scaled.n, (len(scaled.C), scaled.E.shape[1]), shape.count - 1
        P: dict[str, Any] = {"P": symmetric(self.n)} if family is None else {"x": full(1, len(family.basis))}
        between = {f"{letter}{k}": symmetric(self.n) for letter in "DF" for k in range(count)}
        self.unknowns = P | between | {"N": symmetric(self.n), "mu": diagonal(self.p), "nu": diagonal(self.p)}
        if self.q:
            self.unknowns |= {"gamma": diagonal(self.q), "gamma_N": diagonal(self.q)}
        if aim.state is None:
            self.unknowns["X"] = symmetric(self.n)
        program = Program(self.unknowns)
        ends = ([program.read(one) for one in self._inequalities(rate)] for rate in (0.0, 1.0))
        self._parts = [(o, o_1 - o, c, c_1 - c) for (o, c), (o_1, c_1) in zip(*ends, strict=True)]

    @property
    def is_checked(self) -> bool:
        return self.shape.d > 0

    def at(self, sigma: Fraction) -> Found | None:
        """The least of the aim at a rate, per time unit of the plant. Uses the solver."""
        from cdobs_cli.certify.lmi import Program

        program, rate = Program(self.unknowns), float(sigma) / self.scaled.omega
        for offset, more, coefficients, more_of_each in self._parts:
            program.require_read(offset + rate * more, coefficients + rate * more_of_each)
        level = partial(self._level, rate)
        if self.aim.state is None:
            program.require(lambda x: np.atleast_2d(1 - level(x)))
            program.maximise(lambda x: np.atleast_2d(-(self._weights * np.diag(x["X"])).sum()))
        else:
            program.maximise(lambda x: np.atleast_2d(-level(x)))
        solution = program.solve(tolerance=1e-9, iterations=100)
        values = solution.values
        known = all(np.all(np.isfinite(one)) for one in values.values())
        if not known or solution.record.status not in ("Solved", "AlmostSolved"):
            return None
        steps = [values[f"D{k}"] for k in range(self.shape.count - 1)]
        x = None if self.family is None else values["x"][0]
        of = (np.diag(values.get(name, np.zeros((0, 0)))) for name in ("mu", "nu", "gamma", "gamma_N"))
        return Found(
            -solution.objective, sigma, self.shape, self._end(values), x, steps, self._enlarged(values), *of
        )  # fmt: skip

    @cached_property
    def _weights(self) -> Array:
        typed = self.aim.weights
        weights = np.ones(self.n) if typed is None else np.array(typed) * self.scaled.S**2
        floored: Array = np.maximum(weights / weights.max(), 1e-6)
        return floored

    def _end(self, x: Values) -> Array:
        """P, or P(h)."""
        P: Array = x["P"] if self.family is None else np.tensordot(x["x"][0], self.family.floats, axes=1)
        return P

    def _coefficients(self, x: Values) -> list[Array]:
        end = self._end(x)
        return [end + x[f"D{k}"] * self.scaled.h for k in range(self.shape.count - 1)] + [end]

    def _enlarged(self, x: Values) -> list[Array]:
        """The coefficients of N."""
        return [x["N"] + x[f"F{k}"] * self.scaled.h for k in range(self.shape.count - 1)] + [x["N"]]

    def _gamma(self, x: Values, name: str) -> Array:
        return x[name] if self.q else np.zeros((0, 0))

    def _outputs(self, x: Values, name: str) -> Array:
        Q: Array = weighted_outputs(self.scaled.C, x[name])
        return Q

    def _level(self, rate: float, x: Values) -> float:
        """What e'N e is at most; where outputs are compared every h, mu counts in units of h."""
        mu, nu = (float(np.trace(x[name])) for name in ("mu", "nu"))
        gamma, between = (float(np.trace(self._gamma(x, name))) for name in ("gamma", "gamma_N"))
        if not self.is_checked:
            return (mu + gamma) / (2 * rate) + nu
        h = self.scaled.h
        return h * mu / -float(np.expm1(-2 * rate * h)) + gamma / (2 * rate) + nu + h * between

    def _inequalities(self, rate: float) -> Iterator[Affine]:
        """Everything that is >= 0."""
        strict, largest = np.eye(self.n) * _STRICT, np.eye(self.n) * _LARGEST
        for name in ("mu", "nu", *(("gamma", "gamma_N") if self.q else ())):
            yield itemgetter(name)
        for k in range(self.shape.count):
            yield partial(lambda k, x: self._coefficients(x)[k] - strict, k)
        yield lambda x: largest - self._end(x)
        if self.family is None and self.p > 1:  # of one sensor a message leaves nothing to send
            yield from (partial(self._takes, C) for C in self.scaled.C)
        yield lambda x: silent_gap(self._enlarged(x)[0], self._coefficients(x)[0], self._outputs(x, "nu")) - strict
        if self.is_checked:
            yield lambda x: self._outputs(x, "mu") - x["D0"] - strict
            yield from self._between(self._coefficients, rate, "gamma")
            yield from self._between(self._enlarged, 0.0, "gamma_N")
        else:
            yield from (partial(self._flow, rate, A) for A in self.scaled.corners)
        for k in range(self.shape.count):
            yield partial(self._aimed, k)

    def _takes(self, C: Array, x: Values) -> Array:
        """P - C_i'C_i / m: each message takes so much of the final level that m at once are the most. Without, a P of
        little but one rank may be best, of whose gains each sensor undoes what the other did."""
        rest: Array = self._end(x) - np.outer(C, C) / _AT_ONCE
        return rest

    def _aimed(self, k: int, x: Values) -> Array:
        """N - e_j e_j', or X >= N^-1."""
        N, identity = self._enlarged(x)[k], np.eye(self.n)
        if self.aim.state is not None:
            return N - np.outer(identity[self.aim.state], identity[self.aim.state]) - identity * _STRICT
        return block([[x["X"], identity], [identity, N]])

    def _flow(self, rate: float, A: Array, x: Values) -> Array:
        P = self._end(x)
        gap = flow_gap(lyapunov(P, A, rate), self._outputs(x, "mu"), P @ self.scaled.E, self._gamma(x, "gamma"))
        result: Array = gap - np.eye(self.n + self.q) * _STRICT
        return result

    def _between(self, coefficients: Callable[[Values], list[Array]], rate: float, gamma: str) -> Iterator[Affine]:
        """Coefficient by coefficient of the inequality on [0, h]."""
        d, D = self.shape.d, self.shape.D
        length, strict = self.scaled.h / self.shape.pieces, np.eye(self.n + self.q) * _STRICT
        G, E = (np.array(rows, dtype=float) for rows in (derivative(d, D), elevation(d, D)))

        def gap(first: int, place: int, A: Array, x: Values) -> Array:
            local = np.array(coefficients(x)[first : first + d + 1])
            value = np.tensordot(E[place], local, axes=1)
            S = np.tensordot(G[place] / length, local, axes=1) + lyapunov(value, A, rate)
            result: Array = flow_gap(S, S * 0, value @ self.scaled.E, self._gamma(x, gamma)) - strict
            return result

        for first, place, A in product(self.shape.firsts, range(D + 1), self.scaled.corners):
            yield partial(gap, first, place, A)


def scan(question: Question, programs: Search) -> list[Found]:
    """What is found at some rates, the best first: a scan, then halved steps round the best."""
    met: dict[float, Found] = {}
    least = float(question.rate)

    def at(rate: float) -> Found | None:
        sigma = search.short(max(rate * programs.scaled.omega, least), _RATE_DIGITS).rational or Fraction(0)
        sigma = max(sigma, question.rate)
        found = programs.at(sigma) if sigma > 0 else None
        if found is not None:
            met[rate] = found
        return found

    for rate in _SCAN:
        at(rate)
        if progress.is_late():
            break
    step = 2.0**0.5
    for _ in range(_STEPS[question.level]):
        if not met or progress.is_late():
            break
        best = min(met, key=lambda rate: met[rate].merit)
        for rate in (best / step, best * step):
            at(rate)
        step = step**0.5
    return sorted(met.values(), key=lambda one: one.merit)


def best_of_rates(question: Question, aim: Aim, made: Callable[[Question, dict[str, Any], Aim], M_]) -> M_ | None:
    """The first that is proved, of what a scan of rates finds for the question's gain. Uses the solver."""
    with np.errstate(all="ignore"):
        scaled = Scaled.of(question)
        family = None if scaled is None else admissible(question, scaled)
        if scaled is None or family is None:
            return None
        found = scan(question, Search(scaled, family, aim, shape_of(question)))
    for one in found[:4]:
        data = texts(one, scaled, family)
        method = None if data is None else made(question, data, aim)
        if method is not None and method.prove(question).holds:
            return method
    return None


def texts(found: Found, scaled: Scaled, family: Family) -> dict[str, Any] | None:
    """A solution as design.json holds it, rounded; P(h) stays in the family of the gain exactly."""
    assert found.x is not None
    x = [Fraction(decimal_text(float(value), _DIGITS)) for value in found.x]
    end = family.at(x)
    coefficients = [end + _rounded(step * scaled.h) for step in found.steps] + [end]
    back = Matrix.diagonal([1 / size for size in scaled.exact_scale])
    factor = scaled.h if found.shape.d else scaled.omega  # of mu: a comparison adds, or time does
    N = [_rounded(one) for one in found.N]
    mu, nu, gamma, gamma_N = (
        [_text(float(a) * unit / float(b) ** 2) for a, b in zip(values, sizes, strict=True)]
        for values, unit, sizes in (
            (found.mu, factor, scaled.reach),
            (found.nu, 1.0, scaled.reach),
            (found.gamma, scaled.omega, scaled.d0),
            (found.gamma_N, scaled.omega, scaled.d0),
        )
    )
    shape = found.shape
    return {
        "sigma": fraction_text(found.sigma), "shape": [str(shape.d), str(shape.D), str(shape.pieces)],
        "P": [_upper(back @ one @ back) for one in coefficients], "mu": mu, "gamma": gamma,
        "nu": nu, "N": [_upper(back @ one @ back) for one in N], "gamma_N": gamma_N,
    }  # fmt: skip


def _rounded(M: Array) -> Matrix:
    upper = [[Fraction(decimal_text(float(value), _DIGITS)) for value in row] for row in (M + M.T) / 2]
    size = len(upper)
    return Matrix.from_rows([[upper[min(i, j)][max(i, j)] for j in range(size)] for i in range(size)])


def _text(value: float) -> str:
    return decimal_text(max(value, 0.0), _DIGITS)


def _upper(P: Matrix) -> list[list[str]]:
    rows = P.tolist()
    return [[_exact_text(rows[i][j]) for j in range(i, len(rows))] for i in range(len(rows))]


def _exact_text(value: Any) -> str:
    return fraction_text(Fraction(int(value.p), int(value.q)))
